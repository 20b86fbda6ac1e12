import assert from "node:assert/strict";
import { test } from "node:test";

import { withAnswer, withStored } from "../../../static/js/boxes/box.js";
import { LOCAL, REMOTE, UNDO, createStore } from "../../../static/js/boxes/store.js";
import { createValue } from "../../../static/js/core/observable.js";
import { createUndo } from "../../../static/js/review/answers.js";
import { decision } from "./builders.js";

test("a change is told with its origin, and what was before", () => {
  const box = decision();
  const store = createStore([box]);
  /** @type {any[]} */
  const seen = [];
  store.observe((change) => seen.push([change.origin, change.before.review, change.after.review?.verdict]));

  store.apply(withAnswer(box, "keep"), LOCAL);

  assert.deepEqual(seen, [["local", null, "keep"]]);
});

test("snapshots are frozen, and the same until something changes", () => {
  const store = createStore([decision({ box_id: 1 }), decision({ box_id: 2 })]);
  const before = store.all();
  assert.equal(store.all(), before);
  store.apply(withAnswer(decision({ box_id: 2 }), "keep"), LOCAL);
  assert.notEqual(store.all(), before);
  assert.deepEqual(store.all().map((box) => box.box_id), [1, 2]);
  assert.throws(() => Object.assign(store.all()[0] ?? {}, { verdict: "kept" }), TypeError);
});

test("a box of another frame is refused", () => {
  assert.throws(() => createStore([]).apply(decision(), LOCAL), RangeError);
});

test("an answer changes the effective verdict, never the filter's", () => {
  const box = decision();
  assert.deepEqual(["keep", "reject", "unsure", "clear"].map((answer) => withAnswer(box, /** @type {any} */ (answer)).effective_verdict), ["kept", "rejected", "rejected", "rejected"]);
  assert.equal(withAnswer(box, "keep").verdict, "rejected");
  assert.equal(withAnswer(box, "clear").review, null);
});

test("what the server has stored brings its revision", () => {
  const stored = /** @type {any} */ ({ box_id: 1, revision: 4, verdict: "clear", reviewer: "ada", comment: "", effective_verdict: "rejected" });
  const box = withStored(withAnswer(decision(), "keep"), stored);
  assert.deepEqual([box.review, box.revision, box.effective_verdict], [null, 4, "rejected"]);
});

test("undo remembers local changes only, the newest first", () => {
  const undo = createUndo();
  const before = decision({ review: { verdict: "reject", reviewer: "bo", revision: 2, comment: "far" } });
  undo.notice({ origin: REMOTE, before, after: before });
  undo.notice({ origin: UNDO, before, after: before });
  assert.equal(undo.peek(), null);
  undo.notice({ origin: LOCAL, before: decision({ box_id: 9 }), after: before });
  undo.notice({ origin: LOCAL, before, after: before });
  assert.deepEqual(undo.take(), { boxId: 1, frameId: 10, verdict: "reject", comment: "far" });
  assert.deepEqual(undo.take(), { boxId: 9, frameId: 10, verdict: "clear", comment: "" });
  assert.equal(undo.take(), null);
});

test("what somebody else has answered since is not ours to undo", () => {
  const undo = createUndo();
  for (const box_id of [1, 2, 1]) undo.notice({ origin: LOCAL, before: decision({ box_id }), after: decision({ box_id }) });
  undo.forget(1);
  assert.deepEqual([undo.size(), undo.peek()?.boxId], [1, 2]);
});

test("observers may leave while they are told", () => {
  const value = createValue(0);
  /** @type {number[]} */
  const seen = [];
  const stop = value.observe((n) => (seen.push(n), stop()));
  value.observe((n) => seen.push(n * 10));
  value.set(1);
  value.set(1);
  value.set(2);
  assert.deepEqual(seen, [1, 10, 20]);
});
