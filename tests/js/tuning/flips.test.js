import assert from "node:assert/strict";
import { test } from "node:test";

import { directionIn, directionOf } from "../../../static/js/tuning/flips.js";

/** @param {string} before @param {string} after @returns {any} */
const flip = (before, after) => ({ before: { verdict: before }, after: { verdict: after } });

test("a flip is named by its verdicts before and after", () => {
  assert.equal(directionOf(flip("kept", "rejected")), "kept_to_rejected");
  assert.equal(directionOf(flip("rejected", "kept")), "rejected_to_kept");
});

test("an address shows all flips, or those of one direction, also by the name that earlier versions wrote", () => {
  const flips = ["rejected_to_kept", "lost", "won"];
  assert.deepEqual(flips.map((name) => directionIn({ flips: name })), ["rejected_to_kept", "kept_to_rejected", "rejected_to_kept"]);
  assert.equal(directionIn({}), "");
});
