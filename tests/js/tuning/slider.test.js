import assert from "node:assert/strict";
import { test } from "node:test";

import { movedByKey, typedPercent, valueAt } from "../../../static/js/tuning/histogram.js";

/** @param {string} key */
const press = (key, shiftKey = false) => ({ key, shiftKey });

test("arrows go half a percent, with Shift five", () => {
  assert.equal(movedByKey(10, press("ArrowRight")), 10.5);
  assert.equal(movedByKey(10, press("ArrowUp")), 10.5);
  assert.equal(movedByKey(10, press("ArrowLeft")), 9.5);
  assert.equal(movedByKey(10, press("ArrowDown", true)), 5);
  assert.equal(movedByKey(10, press("ArrowRight", true)), 15);
});

test("pages go ten, Home and End all the way, and nothing goes further", () => {
  assert.equal(movedByKey(10, press("PageUp")), 20);
  assert.equal(movedByKey(10, press("PageDown")), 0);
  assert.equal(movedByKey(4, press("PageDown")), 0);
  assert.equal(movedByKey(99.8, press("ArrowRight")), 100);
  assert.equal(movedByKey(10, press("Home")), 0);
  assert.equal(movedByKey(10, press("End")), 100);
});

test("other keys are not the slider's", () => {
  assert.equal(movedByKey(10, press("j")), null);
});

test("steps leave no digits behind", () => {
  assert.equal(movedByKey(10.1, press("ArrowRight")), 10.6);
  assert.equal(movedByKey(0.3, press("ArrowLeft")), 0);
});

test("a pointer sets half percents inside of the scale", () => {
  assert.equal(valueAt(150, 100, 200), 25);
  assert.equal(valueAt(151, 100, 200), 25.5);
  assert.equal(valueAt(0, 100, 200), 0);
  assert.equal(valueAt(999, 100, 200), 100);
  assert.equal(valueAt(5, 0, 0), 0);
});

test("what is typed is a percentage or nothing", () => {
  assert.equal(typedPercent("12.25"), 12.25);
  assert.equal(typedPercent("12,5 %"), 12.5);
  assert.deepEqual(["", " ", "101", "-1", "x"].map(typedPercent), [null, null, null, null, null]);
});
