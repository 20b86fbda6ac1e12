import assert from "node:assert/strict";
import { test } from "node:test";

import { GAP_PX, HEAD_PX, cellsIn, layoutOf, moved, offsetAt, offsetToShow, rowsInSight, scrollTopFor } from "../../../static/js/grid/layout.js";

const small = layoutOf({ count: 10, width: 4 * 100 + 3 * GAP_PX, size: 100 });
const huge = layoutOf({ count: 1_000_000, width: 100, size: 100 });

test("the number of columns is the one nearest to the wanted size, and they fill the width", () => {
  assert.deepEqual([small.columns, small.cell, small.rows], [4, 100, 3]);
  assert.equal(layoutOf({ count: 10, width: 30, size: 100 }).columns, 1);
});

test("a grid of 100,000 cells is as tall as its rows, and scrolls pixel by pixel", () => {
  const tall = layoutOf({ count: 100_000, width: 1400, size: 168 });

  assert.ok(tall.full > tall.rows * tall.pitch);
  assert.equal(tall.height, tall.full);
  assert.equal(offsetAt(tall, 12_345, 800), 12_345);
});

test("a grid that is taller than a browser can scroll maps the scrollbar to its whole height", () => {
  const view = 800;

  assert.ok(huge.height < huge.full);
  assert.equal(offsetAt(huge, 0, view), 0);
  assert.equal(Math.round(offsetAt(huge, huge.height - view, view)), huge.full - view);
  for (const offset of [0, 1000, 77_000_000]) {
    assert.ok(Math.abs(offsetAt(huge, scrollTopFor(huge, offset, view), view) - offset) < 1e-3);
  }
});

test("only rows in sight and a few spare ones are drawn, at any position", () => {
  for (const offset of [0, 50_000_000, huge.full - 800]) {
    const { first, end } = rowsInSight(huge, offset, 800, 2);
    assert.ok(end - first <= Math.ceil(800 / huge.pitch) + 6, `${first} to ${end}`);
    assert.ok(first >= 0 && end <= huge.rows);
  }
  assert.deepEqual(rowsInSight(small, 0, 10_000, 2), { first: 0, end: 3 });
});

test("showing a cell scrolls no further than needed", () => {
  assert.equal(offsetToShow(small, 0, 50, 200), 0);
  assert.equal(offsetToShow(small, 1, 0, 400), 0);
  const down = offsetToShow(small, 9, 0, 200);
  const bottom = HEAD_PX + 3 * small.pitch;
  assert.ok(down + 200 >= bottom - 40 && down <= HEAD_PX + 2 * small.pitch, String(down));
});

test("a lasso selects the cells that it crosses, and none if it lies in a gap", () => {
  const { pitch } = small;

  assert.deepEqual(cellsIn(small, { x0: 0, y0: 0, x1: 10, y1: 10 }), [0]);
  assert.deepEqual(cellsIn(small, { x0: 90, y0: 5, x1: 120, y1: 5 }), [0, 1]);
  assert.deepEqual(cellsIn(small, { x0: 101, y0: 5, x1: 107, y1: 5 }), []);
  assert.deepEqual(cellsIn(small, { x0: 150, y0: pitch + 5, x1: 90, y1: 5 }), [0, 1, 4, 5]);
  assert.deepEqual(cellsIn(small, { x0: -50, y0: -50, x1: 9999, y1: 9999 }).length, 10);
  assert.deepEqual(cellsIn(small, { x0: 250, y0: 2 * pitch, x1: 300, y1: 2 * pitch + 5 }), []);
});

test("keys move by a cell, a row, a page or to the ends, and stop at the edges", () => {
  /** @param {number} from @param {import("../../../static/js/grid/layout.js").Move} move */
  const to = (from, move) => moved(small, from, move, 2);

  assert.deepEqual([to(0, "right"), to(3, "right"), to(9, "right")], [1, 4, 9]);
  assert.deepEqual([to(0, "left"), to(4, "left")], [0, 3]);
  assert.deepEqual([to(1, "down"), to(5, "down"), to(7, "down"), to(9, "down")], [5, 9, 9, 9]);
  assert.deepEqual([to(1, "up"), to(6, "up")], [1, 2]);
  assert.deepEqual([to(5, "first"), to(5, "last"), to(1, "pageDown"), to(9, "pageUp")], [0, 9, 9, 1]);
});
