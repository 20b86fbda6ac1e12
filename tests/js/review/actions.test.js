import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { createBoxes } from "../../../static/js/boxes/store.js";
import { createPrefs } from "../../../static/js/core/prefs.js";
import { parseHash } from "../../../static/js/core/router.js";
import { createValue } from "../../../static/js/core/observable.js";
import { createAnswers } from "../../../static/js/review/answers.js";
import { createFrameActions } from "../../../static/js/review/frame.js";
import { decision, memoryStorage } from "../builders.js";

/** @type {any} */
let app;
/** @type {import("../../../static/js/review/frame.js").FrameActions} */
let actions;
/** @type {string[]} */
let said;
/** What the messages offer to do. @type {({run: () => void} | undefined)[]} */
let offers;

const BOXES = [decision({ box_id: 1 }), decision({ box_id: 2, verdict: "kept" }), decision({ box_id: 3 })];
const OTHER = decision({ box_id: 99, frame_id: 12 });

beforeEach(() => {
  said = [];
  offers = [];
  globalThis.addEventListener ??= () => {};
  const route = createValue(parseHash("#/frames/10"));
  const go = (/** @type {string} */ hash) => route.set(parseHash(hash));
  // A server that never answers: what is said waits.
  globalThis.fetch = () => new Promise(() => {});
  const core = {
    router: { route, go, replace: go },
    head: createValue({ dataset: "d" }),
    announcement: createValue(""),
    toasts: { show: (/** @type {string} */ text, /** @type {any} */ { action } = {}) => (said.push(text), offers.push(action)), dismiss: () => {} },
    prefs: createPrefs(memoryStorage()),
    isSignedIn: createValue(true),
    owner: () => "ada",
    endSession: () => {},
  };
  app = { ...core, ...createAnswers(/** @type {any} */ (core), createBoxes(), memoryStorage(), { tab: "t1", openTabs: new Set() }) };
  const ids = app.boxes.receive(BOXES);
  app.boxes.hold(ids);
  const frame = /** @type {any} */ ({ id: 10, dataset: "d", previous_id: null, next_id: 11 });
  actions = createFrameActions(app, frame, ids, { stage: () => null, openComment: () => said.push("comment") });
});

const query = () => app.router.route.get().query;
const answers = () => app.boxes.all([1, 2, 3]).map((/** @type {any} */ box) => box.review?.verdict ?? null);

test("next goes from box to box, then to the next frame's first box", () => {
  const seen = [1, 2, 3].map(() => (actions.byName.next(), query().box));
  actions.byName.next();
  assert.deepEqual(seen, ["1", "2", "3"]);
  assert.deepEqual([app.router.route.get().params.id, query().box], ["11", "first"]);
});

test("steps respect the filters in the address, and keep them", () => {
  app.router.go("#/frames/10?verdict=rejected");
  const seen = [1, 2].map(() => (actions.byName.next(), query().box));
  assert.deepEqual([seen, query().verdict], [["1", "3"], "rejected"]);
});

test("there is nothing before the first frame", () => {
  actions.byName.previousFrame();
  assert.deepEqual(said, ["There are no more frames."]);
});

test("an answer needs a selected box", () => {
  actions.byName.keep();
  assert.deepEqual([said, answers()], [["Select a box first."], [null, null, null]]);
});

test("the same answer twice is one answer", () => {
  actions.select(1);
  actions.byName.keep();
  actions.byName.keep();
  actions.byName.undo();
  actions.byName.undo();
  assert.deepEqual([answers(), said], [[null, null, null], ["Nothing to undo."]]);
});

test("undo goes back step by step and selects what it changes", () => {
  actions.select(1);
  actions.byName.keep();
  actions.byName.reject();
  actions.select(3);
  actions.byName.unsure();
  actions.byName.undo();
  assert.deepEqual([answers(), query().box], [["reject", null, null], "3"]);
  actions.byName.undo();
  assert.deepEqual([answers(), query().box], [["keep", null, null], "1"]);
  actions.byName.undo();
  actions.byName.undo();
  assert.deepEqual([answers(), said], [[null, null, null], ["Nothing to undo."]]);
});

test("undo of an answer on another frame takes it back, and goes there", () => {
  app.boxes.receive([OTHER]);
  app.answer(99, "keep");
  actions.byName.undo();
  assert.deepEqual([app.boxes.get(99)?.review, app.router.route.get().params.id, query()], [null, "12", { box: "99" }]);
});

test("the next undecided skips what has an answer", () => {
  actions.select(1);
  actions.byName.keep();
  actions.byName.nextUndecided();
  assert.equal(query().box, "2");
});

test("V goes through kept, rejected and all", () => {
  const seen = [1, 2, 3].map(() => (actions.byName.cycleVerdict(), query().verdict ?? "all"));
  assert.deepEqual(seen, ["kept", "rejected", "all"]);
});

test("the brackets fade the segmentation within limits and switch it on", () => {
  actions.byName.opacityUp();
  assert.deepEqual([app.prefs.get().mask, app.prefs.get().opacity], [true, 0.5]);
  for (let i = 0; i < 9; i++) actions.byName.opacityUp();
  assert.equal(app.prefs.get().opacity, 1);
  for (let i = 0; i < 12; i++) actions.byName.opacityDown();
  assert.equal(app.prefs.get().opacity, 0.1);
});

test("the address can ask for the first, the last or an undecided box", () => {
  actions.select(1);
  actions.byName.keep();
  assert.deepEqual(["first", "last", "undecided"].map(actions.resolve), [1, 3, 2]);
});

test("what was read of a box before it was answered is older, also when it comes late", async () => {
  globalThis.fetch = async (_, { body } = {}) => {
    const { verdict, seen_revision } = JSON.parse(String(body));
    return Response.json({ box_id: 99, revision: seen_revision + 1, verdict, reviewer: "ada", comment: "", effective_verdict: "rejected" }, { status: 201 });
  };
  const giveBack = app.boxes.hold(app.boxes.receive([OTHER]));
  app.answer(99, "keep");
  giveBack();
  app.undo(() => {});
  await new Promise((resolve) => setTimeout(resolve, 20));
  assert.equal(app.sender.state.get().phase, "saved");

  app.boxes.receive([{ ...OTHER, revision: 1, review: { verdict: "keep", reviewer: "ada", revision: 1, comment: "" } }]);

  assert.deepEqual([app.boxes.get(99)?.review, app.boxes.get(99)?.revision], [null, 2]);
});

for (const [what, id, act] of /** @type {[string, number | null, () => void][]} */ ([
  ["an answer", 12, () => app.answer(99, "keep")],
  ["an act on many boxes", null, () => app.acts.answer("d", "keep", [99], new Map())],
])) {
  test(`when ${what} is stored, whoever has fetched the frame is told`, async () => {
    globalThis.fetch = async (address) =>
      Response.json(String(address).endsWith("/bulk") ? { id: 7, count: 1, skipped: [], stale: [] } : { box_id: 99, revision: 1, verdict: "keep", reviewer: "ada", comment: "", effective_verdict: "kept" }, { status: 201 });
    app.boxes.hold(app.boxes.receive([OTHER]));
    /** @type {unknown[]} */
    const told = [];
    app.changedFrame.observe((/** @type {{id: number | null}} */ changed) => told.push(changed.id));

    act();
    assert.deepEqual(told, []);
    await new Promise((resolve) => setTimeout(resolve, 20));

    assert.deepEqual(told, [id]);
  });
}

test("undo goes back over acts on many boxes and single answers in the order in which they were given", () => {
  // The first answer is on its way; what follows has not been sent.
  app.answer(3, "unsure");
  app.acts.answer("d", "keep", [1, 2], new Map());
  assert.deepEqual(answers(), ["keep", "keep", "unsure"]);
  actions.byName.undo();
  assert.deepEqual(answers(), [null, null, "unsure"]);
  actions.byName.undo();
  actions.byName.undo();
  assert.deepEqual([answers(), said], [[null, null, null], ["Nothing to undo."]]);
});

test("undo of an act that was not sent restores the boxes that were answered after it too", () => {
  app.answer(3, "unsure");
  app.acts.answer("d", "reject", [1, 2], new Map());
  app.answer(1, "keep");
  actions.byName.undo();
  assert.deepEqual(answers(), ["reject", "reject", "unsure"]);
  actions.byName.undo();
  assert.deepEqual(answers(), [null, null, "unsure"]);
});

test("the undo of an act that is on its way is shown at once", () => {
  app.acts.answer("d", "reject", [1, 2], new Map());
  actions.byName.undo();
  assert.deepEqual(answers(), [null, null, null]);
});

test("the undo of an act, asked for after a later answer, leaves that answer as it is", async () => {
  globalThis.fetch = async () => Response.json({ id: 7, count: 2, skipped: [], stale: [] }, { status: 201 });
  app.acts.answer("d", "reject", [1, 2], new Map());
  await new Promise((resolve) => setTimeout(resolve, 20));
  globalThis.fetch = () => new Promise(() => {});
  app.answer(1, "keep");
  offers.at(-1)?.run();
  assert.deepEqual([answers(), said], [["keep", null, null], ["2 boxes rejected"]]);
});
