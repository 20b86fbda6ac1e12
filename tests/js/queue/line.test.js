import assert from "node:assert/strict";
import { test } from "node:test";

import { EMPTY, afterAnswer, afterUndo, backToSkipped, compared, currentOf, extended, inOrder, isBlind, movedTo, nextOpen, paceOf, skippedBoxes, stepped, upcoming } from "../../../static/js/queue/line.js";
import { decision } from "../../support/page/builders.js";

const five = extended(EMPTY, [1, 2, 3, 4, 5]);

test("boxes are added at the end of the line, each once", () => {
  const longer = extended(five, [4, 6]);

  assert.deepEqual(longer.ids, [1, 2, 3, 4, 5, 6]);
  assert.equal(currentOf(longer), 1);
});

test("an answer leads to the next box without one", () => {
  const skipped = afterAnswer(stepped(five, 1), 2);

  assert.equal(currentOf(skipped), 3);
  assert.deepEqual(skippedBoxes(skipped), [1]);
  const back = stepped(stepped(skipped, -1), -1);
  assert.equal(currentOf(afterAnswer(back, 1)), 3);
});

test("after the last box there is no current one until more are added", () => {
  const done = [1, 2, 3, 4, 5].reduce(afterAnswer, five);

  assert.equal(currentOf(done), null);
  assert.equal(currentOf(stepped(done, 1)), null);
  assert.equal(currentOf(extended(done, [6])), 6);
});

test("an answer on another box keeps the current one", () => {
  assert.equal(currentOf(afterAnswer(five, 4)), 1);
});

test("a box whose answer is undone becomes the current one, even if it was not in the line", () => {
  const two = afterAnswer(afterAnswer(five, 1), 2);

  assert.equal(currentOf(afterUndo(two, 1)), 1);
  assert.deepEqual([...afterUndo(two, 1).answered], [2]);
  const strange = afterUndo(two, 99);
  assert.equal(currentOf(strange), 99);
  assert.equal(currentOf(stepped(strange, 1)), 3);
});

test("the boxes ahead leave out those that have an answer", () => {
  assert.deepEqual(upcoming(afterAnswer(five, 3), 2), [2, 4]);
});

test("boxes that were skipped can be gone through again", () => {
  const end = stepped(stepped(afterAnswer(stepped(five, 1), 2), 1), 1);
  const once = nextOpen(end);

  const anew = backToSkipped(once);

  assert.equal(currentOf(anew), 1);
  assert.deepEqual(upcoming(anew, 9), [3, 4, 5].filter((id) => skippedBoxes(once).includes(id)));
});

test("any box of the line can be made the current one, and boxes outside of it cannot", () => {
  assert.equal(currentOf(movedTo(five, 4)), 4);
  assert.equal(currentOf(movedTo(five, 99)), 1);
});

test("the pace is known after four answers, and counts only the last ones", () => {
  assert.equal(paceOf([0, 1000, 2000]), null);
  assert.equal(paceOf([0, 1000, 2000, 3000]), 60);
  const slowThenFast = [0, ...Array.from({ length: 20 }, (_, i) => 600_000 + i * 500)];
  assert.equal(paceOf(slowThenFast), 120);
});

const review = (verdict) => ({ verdict, reviewer: "bo", revision: 1, comment: "I think so" });

test("an audit hides verdicts unless the address asks for them", () => {
  assert.ok(isBlind({ order: "audit" }, { blind: false }));
  assert.ok(!isBlind({ order: "audit", blind: "off" }, { blind: true }));
  assert.ok(!isBlind({}, { blind: false }));
  assert.ok(isBlind({}, { blind: true }));
  assert.ok(isBlind({ blind: "on" }, {}));
});

test("an audit begins blind, also if the order before was not; other orders keep the choice", () => {
  assert.ok(isBlind(inOrder({ order: "doubt", blind: "off" }, "audit"), {}));
  assert.deepEqual(inOrder({ class: "car", blind: "on" }, "audit"), { class: "car", order: "audit", blind: "on" });
  assert.deepEqual(inOrder({ blind: "off" }, "random"), { order: "random", blind: "off" });
});

test("an answer is compared with the earlier answer, else with the filter's verdict", () => {
  const reviewed = decision({ review: review("keep") });

  assert.equal(compared(reviewed, "keep")?.agrees, true);
  assert.match(compared(reviewed, "reject")?.words ?? "", /bo said keep, you said reject/);
  assert.equal(compared(decision({ verdict: "rejected" }), "reject")?.agrees, true);
  assert.equal(compared(decision({ verdict: "rejected" }), "keep")?.agrees, false);
  assert.equal(compared(reviewed, "unsure"), null);
  assert.equal(compared(decision({ verdict: "unmeasured" }), "keep"), null);
});
