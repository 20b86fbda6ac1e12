import assert from "node:assert/strict";
import { test } from "node:test";

import { binsFor, countTicks, heightOf, rebinned, shortCount, together } from "../../../static/js/tuning/histogram.js";

test("bins are joined without losing a box", () => {
  assert.deepEqual(rebinned([1, 2, 3, 4, 5, 6, 7, 8], 4), [3, 7, 11, 15]);
  assert.deepEqual(rebinned([1, 2, 3, 4], 1), [10]);
  assert.deepEqual(rebinned([1, 2], 2), [1, 2]);
});

test("classes are added bin by bin", () => {
  assert.deepEqual(together([[1, 0, 2], [3, 4, 0]]), [4, 4, 2]);
  assert.deepEqual(together([]), []);
});

test("a bar is never thinner than one can see", () => {
  assert.equal(binsFor(1000, 200), 200);
  assert.equal(binsFor(500, 200), 100);
  assert.equal(binsFor(240, 200), 50);
});

test("an empty bin has no height on either scale, and one box can be seen", () => {
  assert.equal(heightOf(0, true), 0);
  assert.equal(heightOf(0, false), 0);
  assert.ok(heightOf(1, true) > 0.3);
});

test("the axis begins at nothing and ends above the tallest bar", () => {
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

test("axes say large counts shortly", () => {
  assert.deepEqual([0, 500, 1000, 20000, 1000000].map(shortCount), ["0", "500", "1000", "20k", "1M"]);
});
