import assert from "node:assert/strict";
import { test } from "node:test";

import { binsFor, countTicks, heightOf, movedByKey, rebinned, shortCount, together, typedPercent, valueAt } from "../../../static/js/tuning/histogram.js";

test("joining bins keeps the total number of boxes", () => {
  assert.deepEqual(rebinned([1, 2, 3, 4, 5, 6, 7, 8], 4), [3, 7, 11, 15]);
  assert.deepEqual(rebinned([1, 2, 3, 4], 1), [10]);
  assert.deepEqual(rebinned([1, 2], 2), [1, 2]);
});

test("the histograms of several classes are added bin by bin", () => {
  assert.deepEqual(together([[1, 0, 2], [3, 4, 0]]), [4, 4, 2]);
  assert.deepEqual(together([]), []);
});

test("a narrow plot has fewer bins, so that each bar can be seen", () => {
  assert.equal(binsFor(1000, 200), 200);
  assert.equal(binsFor(500, 200), 100);
  assert.equal(binsFor(240, 200), 50);
});

test("an empty bin has no height on either scale, and a bin of one box is high enough to be seen", () => {
  assert.equal(heightOf(0, true), 0);
  assert.equal(heightOf(0, false), 0);
  assert.ok(heightOf(1, true) > 0.3);
});

test("the axis begins at 0 and ends at or above the tallest bar", () => {
  assert.deepEqual(countTicks(0, true), [0, 1]);
  assert.deepEqual(countTicks(830, true), [0, 10, 100, 1000]);
  assert.deepEqual(countTicks(830, false), [0, 500, 1000]);
  assert.deepEqual(countTicks(3, false), [0, 1, 2, 3]);
  for (const tallest of [1, 2, 7, 9, 10, 99, 123456, 1000000]) {
    for (const isLog of [true, false]) {
      const ticks = countTicks(tallest, isLog);
      assert.ok((ticks.at(-1) ?? 0) >= tallest, `${tallest} ${isLog}: ${ticks}`);
      assert.ok(ticks.length <= 7, `${tallest} ${isLog}: ${ticks}`);
    }
  }
});

test("large counts on an axis are shortened", () => {
  assert.deepEqual([0, 500, 1000, 20000, 1000000].map(shortCount), ["0", "500", "1000", "20k", "1M"]);
});

/** @param {string} key */
const press = (key, shiftKey = false) => ({ key, shiftKey });

test("arrow keys move a threshold by half a percent, with Shift by five percent", () => {
  assert.equal(movedByKey(10, press("ArrowRight")), 10.5);
  assert.equal(movedByKey(10, press("ArrowUp")), 10.5);
  assert.equal(movedByKey(10, press("ArrowLeft")), 9.5);
  assert.equal(movedByKey(10, press("ArrowDown", true)), 5);
  assert.equal(movedByKey(10, press("ArrowRight", true)), 15);
});

test("PageUp and PageDown move by ten percent, Home and End to the ends, and no key beyond them", () => {
  assert.equal(movedByKey(10, press("PageUp")), 20);
  assert.equal(movedByKey(10, press("PageDown")), 0);
  assert.equal(movedByKey(4, press("PageDown")), 0);
  assert.equal(movedByKey(99.8, press("ArrowRight")), 100);
  assert.equal(movedByKey(10, press("Home")), 0);
  assert.equal(movedByKey(10, press("End")), 100);
});

test("keys without a meaning for the slider are left to others", () => {
  assert.equal(movedByKey(10, press("j")), null);
});

test("steps by keys leave no digits of floating-point errors", () => {
  assert.equal(movedByKey(10.1, press("ArrowRight")), 10.6);
  assert.equal(movedByKey(0.3, press("ArrowLeft")), 0);
});

test("a pointer sets a threshold to half percents, from 0 to 100", () => {
  assert.equal(valueAt(150, 100, 200), 25);
  assert.equal(valueAt(151, 100, 200), 25.5);
  assert.equal(valueAt(0, 100, 200), 0);
  assert.equal(valueAt(999, 100, 200), 100);
  assert.equal(valueAt(5, 0, 0), 0);
});

test("typed text is read as a percentage, and anything else is refused", () => {
  assert.equal(typedPercent("12.25"), 12.25);
  assert.equal(typedPercent("12,5 %"), 12.5);
  assert.deepEqual(["", " ", "101", "-1", "x"].map(typedPercent), [null, null, null, null, null]);
});
