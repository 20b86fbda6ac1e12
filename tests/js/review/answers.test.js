import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { createBoxes } from "../../../static/js/boxes/store.js";
import { createSteps } from "../../../static/js/review/answers.js";
import { createOutbox } from "../../../static/js/review/outbox.js";
import { decision, memoryStorage } from "../../support/page/builders.js";
import { fill, reviewPage } from "../../support/page/review_page.js";

/** @type {any} */
let app;
/** @type {string[]} */
let said;

const OTHER = decision({ box_id: 99, frame_id: 12 });

beforeEach(() => {
  ({ app, said } = reviewPage());
});

/** @param {any} app */
const answersOf = (app) => app.boxes.all([1, 2, 3]).map((/** @type {any} */ box) => box.review?.verdict ?? null);
const answers = () => answersOf(app);
const undo = () => app.undo(() => {});
const swept = () => new Promise((resolve) => setImmediate(resolve));

test("a response that is older than a stored answer does not replace it, even if it arrives later", async () => {
  globalThis.fetch = async (_, { body } = {}) => {
    // The undo has no body.
    const [verdict, revision] = body ? [JSON.parse(String(body)).verdict, 1] : ["clear", 2];
    return Response.json({ box_id: 99, revision, verdict, reviewer: "ada", comment: "", effective_verdict: "rejected" }, { status: 201 });
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

test("an answer that changes nothing is not undone, but the one before it", async () => {
  /** @type {string[]} */
  const addresses = [];
  globalThis.fetch = async (address, { body } = {}) => {
    addresses.push(String(address));
    const [verdict, revision] = body ? [JSON.parse(String(body)).verdict, 1] : ["clear", 2];
    return Response.json({ box_id: 99, revision, verdict, reviewer: "ada", comment: "", effective_verdict: "kept" });
  };
  app.boxes.hold(app.boxes.receive([OTHER]));
  app.answer(99, "keep");
  await swept();
  await swept();
  app.answer(99, "keep");
  await swept();
  await swept();

  app.undo(() => {});
  await swept();
  await swept();

  assert.deepEqual(addresses, ["/api/v1/boxes/99/reviews", "/api/v1/boxes/99/reviews", "/api/v1/boxes/99/reviews/1/undo"]);
  undo();
  assert.deepEqual(said, ["Nothing to undo."]);
});

test("if the browser's storage is full, an answer is neither given nor undone, and a message says so", () => {
  const storage = memoryStorage();
  ({ app, said } = reviewPage(storage));
  app.answer(1, "keep");
  fill(storage);

  app.answer(2, "reject");
  app.bulkAnswers.answer("d", "reject", [2, 3], new Map());

  assert.deepEqual(answers(), ["keep", null, null]);
  assert.equal(said.filter((text) => text.startsWith("Not saved: this browser has no room")).length, 2);
  undo();
  assert.equal(said.length, 3);
  assert.deepEqual(answers(), ["keep", null, null], "nor undone");
});

test("an answer that another tab has taken over is not undone, and a message says so", () => {
  const storage = memoryStorage();
  ({ app, said } = reviewPage(storage));
  app.answer(1, "keep");
  createOutbox(storage, "t2", () => "ada").takeOver(new Set());

  undo();

  assert.deepEqual([answers(), said], [["keep", null, null], ["Not undone: another tab has taken over the answer."]]);
});

test("a tab takes over the unsent answers of closed tabs, and of no others", async () => {
  const storage = memoryStorage();
  const open = new Set(["t1"]);
  const openTabs = async () => open;
  const first = reviewPage(storage, { tab: "t1", openTabs });
  open.add("t2");
  const second = reviewPage(storage, { tab: "t2", openTabs });
  globalThis.fetch = () => Promise.reject(new TypeError("offline"));
  second.app.answer(1, "keep");
  await swept();

  await first.app.resume();
  assert.equal(first.app.sender.state.get().count, 0);
  assert.equal(second.app.boxes.get(1).review.verdict, "keep");
  open.delete("t2");
  await first.app.resume();

  assert.equal(first.app.sender.state.get().count, 1);
});

test("undo takes back single and bulk answers from the newest to the oldest", () => {
  // The first answer is being sent; the following ones have not been sent.
  app.answer(3, "unsure");
  app.bulkAnswers.answer("d", "keep", [1, 2], new Map());
  assert.deepEqual(answers(), ["keep", "keep", "unsure"]);
  undo();
  assert.deepEqual(answers(), [null, null, "unsure"]);
  undo();
  undo();
  assert.deepEqual([answers(), said], [[null, null, null], ["Discarded: keep 2 boxes", "Nothing to undo."]]);
});

test("steps are undone from the newest to the oldest, and keep their boxes in the store until then", async () => {
  const boxes = createBoxes();
  const steps = createSteps(boxes);
  const view = boxes.hold(boxes.receive([decision({ box_id: 1 }), decision({ box_id: 2 })]));
  const first = { before: [{ boxId: 1, verdict: /** @type {const} */ ("clear"), comment: "" }] };
  const second = { before: [{ boxId: 2, verdict: /** @type {const} */ ("keep"), comment: "far" }] };
  steps.push(first);
  steps.push(second);
  view();
  await swept();

  assert.equal(steps.last(), second);
  steps.drop(second);
  await swept();

  assert.deepEqual([steps.last(), boxes.get(1)?.box_id, boxes.get(2)], [first, 1, undefined]);
});

test("after forget, single answers on that box cannot be undone any more, but bulk answers can", () => {
  const steps = createSteps(createBoxes());
  const before = (/** @type {number} */ boxId) => [{ boxId, verdict: /** @type {const} */ ("clear"), comment: "" }];
  for (const boxId of [1, 2, 1]) steps.push({ before: before(boxId) });
  steps.push({ before: before(1), bulkKey: "k1" });

  steps.forget(1);

  assert.equal(steps.last()?.bulkKey, "k1");
  steps.drop(/** @type {any} */ (steps.last()));
  assert.equal(steps.last()?.before[0]?.boxId, 2);
});

test("an unsent answer of another tab is shown, and its box is loaded again when that tab has stored it", async () => {
  const storage = memoryStorage();
  const item = { key: "k", person: "ada", tab: "t2", order: 1, boxId: 1, frameId: 10, verdict: "keep", comment: "", seenRevision: 0, attempted: true };
  storage.setItem("unghost.outbox.v1.k", JSON.stringify(item));
  const { app, storageChanged } = reviewPage(storage, { tab: "t1", openTabs: async () => new Set(["t1", "t2"]) });
  await app.resume();
  assert.deepEqual([answersOf(app), [...app.sender.state.get().waiting]], [["keep", null, null], [1]]);
  assert.deepEqual([app.sender.state.get().phase, app.sender.state.get().count], ["saved", 0], "it is not this tab's");

  const review = { verdict: "keep", reviewer: "ada", revision: 1, comment: "" };
  globalThis.fetch = async () => Response.json({ id: 10, boxes: [decision({ box_id: 1, revision: 1, review })] });
  storage.removeItem("unghost.outbox.v1.k");
  storageChanged("unghost.outbox.v1.k");
  await new Promise((resolve) => setTimeout(resolve, 20));

  assert.deepEqual([app.boxes.get(1).review, [...app.sender.state.get().waiting]], [review, []]);
});
