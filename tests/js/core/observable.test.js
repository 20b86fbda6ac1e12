import assert from "node:assert/strict";
import { test } from "node:test";

import { createValue } from "../../../static/js/core/observable.js";

test("an observer may remove itself while it is notified of a change", () => {
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
