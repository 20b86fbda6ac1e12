import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { createFrameActions } from "../../../static/js/review/frame.js";
import { decision } from "../../support/page/builders.js";
import { reviewPage } from "../../support/page/review_page.js";

/** @type {any} */
let app;
/** @type {import("../../../static/js/review/frame.js").FrameActions} */
let actions;
/** @type {string[]} */
let said;
/** @type {any} */
let stage;

beforeEach(() => {
  ({ app, said } = reviewPage());
  stage = { lookedMs: () => 1000 };
  const frame = /** @type {any} */ ({ id: 10, dataset: "d", previous_id: null, next_id: 11 });
  actions = createFrameActions(app, frame, [1, 2, 3], { stage: () => stage, openComment: () => said.push("comment") });
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

test("a step back from the first frame says that there are no more frames", () => {
  actions.byName.previousFrame();
  assert.deepEqual(said, ["There are no more frames."]);
});

test("an answer needs a selected box", () => {
  actions.byName.keep();
  assert.deepEqual([said, answers()], [["Select a box first."], [null, null, null]]);
});

test("giving the same answer twice counts as one answer", () => {
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

test("undoing an answer on another frame takes it back, and opens that frame", () => {
  app.boxes.receive([decision({ box_id: 99, frame_id: 12 })]);
  app.answer(99, "keep");
  actions.byName.undo();
  assert.deepEqual([app.boxes.get(99)?.review, app.router.route.get().params.id, query()], [null, "12", { box: "99" }]);
});

test("the step to the next box without an answer skips boxes that have one", () => {
  actions.select(1);
  actions.byName.keep();
  actions.byName.nextUnanswered();
  assert.equal(query().box, "2");
});

test("the action of the V key shows kept boxes, then rejected ones, then all", () => {
  const seen = [1, 2, 3].map(() => (actions.byName.cycleVerdict(), query().verdict ?? "all"));
  assert.deepEqual(seen, ["kept", "rejected", "all"]);
});

test("the bracket keys change the segmentation's opacity within limits, and switch it on", () => {
  actions.byName.opacityUp();
  assert.deepEqual([app.prefs.get().mask, app.prefs.get().opacity], [true, 0.5]);
  for (let i = 0; i < 9; i++) actions.byName.opacityUp();
  assert.equal(app.prefs.get().opacity, 1);
  for (let i = 0; i < 12; i++) actions.byName.opacityDown();
  assert.equal(app.prefs.get().opacity, 0.1);
});

test("the address can name the first box, the last one, or one without an answer", () => {
  actions.select(1);
  actions.byName.keep();
  assert.deepEqual(["first", "last", "unanswered"].map(actions.resolve), [1, 3, 2]);
});
