// Boxes that an address names one by one.

import assert from "node:assert/strict";
import { test } from "node:test";

import { listQuery, listedOf, withoutList } from "../../../static/js/boxes/filters.js";

test("boxes keep the order of the address; twice the same is once", () => {
  assert.deepEqual(listedOf({ boxes: "1042,7,1042" }), [1042, 7]);
  assert.deepEqual(listedOf(listQuery([1042, 7])), [1042, 7]);
});

test("what is no id is left out, and no list is an empty one", () => {
  assert.deepEqual(listedOf({ boxes: "7,x,-3,1.5,,1e99" }), [7]);
  assert.deepEqual(listedOf({}), []);
});

test("a list is never longer than one can go through", () => {
  const many = Array.from({ length: 500 }, (_, at) => at + 1);
  assert.equal(listedOf(listQuery(many)).length, 50);
  assert.equal(listedOf({ boxes: many.join(",") }).length, 50);
});

test("the whole queue keeps what else is asked for", () => {
  assert.deepEqual(withoutList({ boxes: "7", order: "random" }), { order: "random" });
});
