import assert from "node:assert/strict";
import { test } from "node:test";

import { directionOf } from "../../../static/js/tuning/flips.js";

/** @param {string} before @param {string} after @returns {any} */
const flip = (before, after) => ({ before: { verdict: before }, after: { verdict: after } });

test("a flip is named by its verdicts before and after", () => {
  assert.equal(directionOf(flip("kept", "rejected")), "kept_to_rejected");
  assert.equal(directionOf(flip("rejected", "kept")), "rejected_to_kept");
});
