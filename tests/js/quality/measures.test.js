import assert from "node:assert/strict";
import { test } from "node:test";

import { answersIn, bandQuery, bandText, cellQuery, intervalText, kappaText, planText, refusalText, shareOf, shareText } from "../../../static/js/quality/measures.js";
import { worthTrying } from "../../../static/js/tuning/config.js";

const CONFUSION = { kept_keep: 6, kept_reject: 1, rejected_keep: 1, rejected_reject: 2 };

test("answersIn adds up all four fields of the confusion matrix, and shareOf gives one field's share", () => {
  assert.equal(answersIn(CONFUSION), 10);
  assert.equal(shareOf(CONFUSION, "kept_keep"), 0.6);
  assert.equal(shareOf({ kept_keep: 0, kept_reject: 0, rejected_keep: 0, rejected_reject: 0 }, "kept_keep"), 0);
});

test("a field of the confusion matrix becomes the filter that lists its boxes", () => {
  assert.deepEqual(cellQuery("rejected", "keep"), { by_filter: "rejected", review: "keep" });
});

test("an unknown share is shown as a dash, and an unknown interval in words", () => {
  assert.deepEqual([0.9471, 1, 0, null, undefined].map(shareText), ["94.7 %", "100 %", "0 %", "–", "–"]);
  assert.equal(intervalText({ value: 0.5, low: 0.402, high: 0.598 }), "40.2–59.8 %");
  assert.equal(intervalText(null), "cannot be told");
});

test("why there are no scores depends on whether some answers are random, and the plan is rounded up", () => {
  assert.match(refusalText(100, 0), /^These 100 answers were on boxes that were not chosen at random/);
  assert.match(refusalText(100, 40), /^40 random answers are too few/);
  assert.equal(planText({ boxes: 200, half_width: 0.081 }, 0), "Answer 200 random boxes to know it to about ± 9 %.");
  assert.equal(planText({ boxes: 200, half_width: 0.081 }, 40), "With 200 random boxes it is known to about ± 9 %.");
  assert.equal(planText({ boxes: 5, half_width: 0 }, 0), "Answer 5 random boxes to know it exactly.");
});

test("kappa has words from poor to almost perfect", () => {
  assert.deepEqual([null, -0.1, 0.1, 0.5, 0.8, 0.81].map(kappaText), ["not known", "poor", "slight", "moderate", "substantial", "almost perfect"]);
});

test("bands of distance are written in metres and become filters, except for the unknown one", () => {
  assert.deepEqual(["0-50", ">200", "unknown"].map(bandText), ["0–50 m", "> 200 m", "unknown"]);
  assert.deepEqual(["0-50", ">200", "unknown"].map(bandQuery), [{ distance_min: "0", distance_max: "50" }, { distance_min: "200" }, null]);
});

test("a suggested threshold is offered only if it has a better F1 or, with recall as the goal, if it differs", () => {
  const same = { current: 10, suggested: 10, f1_current: 0.9, f1_suggested: 0.9 };
  const better = { current: 10, suggested: 4, f1_current: 0.9, f1_suggested: 0.95 };
  const asGood = { current: 10, suggested: 4, f1_current: 0.9, f1_suggested: 0.9 };
  assert.deepEqual(worthTrying([same, better, asGood]), [better]);
  assert.deepEqual(worthTrying([same, better, asGood], "recall"), [better, asGood]);
});
