import assert from "node:assert/strict";
import { test } from "node:test";

import { NOTHING, allBut, everything, extended, focused, isSelected, lassoed, nothing, only, sizeOf, toggled } from "../../../static/js/grid/selection.js";

/** @param {import("../../../static/js/grid/selection.js").Selection} selection */
const ids = (selection) => [...selection.ids].sort((a, b) => a - b);

test("a click selects one box and deselects the others", () => {
  const two = toggled(only(0, 10), 1, 11);

  assert.deepEqual(ids(two), [10, 11]);
  assert.deepEqual(ids(only(2, 12)), [12]);
});

test("toggling a box twice restores the selection", () => {
  assert.deepEqual(ids(toggled(toggled(only(0, 10), 1, 11), 1, 11)), [10]);
});

test("Shift selects from the anchor each time, instead of or in addition to the selection", () => {
  const first = only(2, 12);
  const down = extended(first, 4, [12, 13, 14]);
  const up = extended(down, 1, [11, 12]);

  assert.deepEqual(ids(down), [12, 13, 14]);
  assert.deepEqual(ids(up), [11, 12]);
  assert.equal(up.anchor, 2);
  assert.deepEqual(ids(extended(first, 4, [14], true)), [12, 14]);
});

test("a lasso replaces the selection, or adds to it", () => {
  const before = only(0, 10);

  assert.deepEqual(ids(lassoed(before, [11, 12], 2, false)), [11, 12]);
  assert.deepEqual(ids(lassoed(before, [11, 12], 2, true)), [10, 11, 12]);
});

test("moving the focus keeps the selection", () => {
  const moved = focused(only(0, 10), 5);

  assert.deepEqual([ids(moved), moved.focus, moved.anchor], [[10], 5, 5]);
});

test("selecting everything means all boxes of the filter, not a list of ids", () => {
  const all = everything(only(0, 10));

  assert.ok(isSelected(all, 999));
  assert.equal(sizeOf(all, 100_000), 100_000);
  assert.equal(sizeOf(nothing(all), 100_000), 0);
  assert.deepEqual(ids(allBut(all, [10, 11, 12], 1, 11)), [10, 12]);
  assert.ok(!isSelected(NOTHING, 1));
});
