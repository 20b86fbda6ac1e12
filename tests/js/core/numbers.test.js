import assert from "node:assert/strict";
import { test } from "node:test";

import { agoText, countOf, percentText, sizeText, tookText } from "../../../static/js/core/numbers.js";

test("percentages are rounded, but not to 0 or 100", () => {
  const shown = [0, 0.004, 0.04, 0.5, 0.96, 4.08, 10, 71.25, 99.97, 100, null].map((percent) => percentText(percent));
  assert.deepEqual(shown, ["0 %", "0.004 %", "0.04 %", "0.5 %", "0.96 %", "4.1 %", "10 %", "71.3 %", "99.97 %", "100 %", "–"]);
});

test("counts have groups of digits, and the singular or the plural", () => {
  assert.deepEqual([countOf(1, "box", "boxes"), countOf(12345, "box", "boxes")], ["1 box", "12\u2009345 boxes"]);
});

test("recent times are given as their age, older ones as a date", () => {
  const now = Date.parse("2026-01-01T12:00:00Z");
  assert.equal(agoText("2026-01-01T11:59:50Z", now), "just now");
  assert.equal(agoText("2026-01-01T11:30:00Z", now), "30 min ago");
  assert.equal(agoText("2026-01-01T09:00:00Z", now), "3 h ago");
  assert.equal(agoText("2025-12-24T09:00:00Z", now), "Dec 24, 2025");
});

test("sizes and durations are written short", () => {
  assert.deepEqual([null, 999, 1200, 62092203, 4.2e9].map(sizeText), ["–", "999 B", "1.2 kB", "62 MB", "4.2 GB"]);
  const at = (/** @type {number} */ seconds) => tookText("2026-01-01T00:00:00Z", new Date(Date.UTC(2026, 0, 1, 0, 0, seconds)).toISOString());
  assert.deepEqual([0, 3, 42, 200].map(at), ["under 0.1 s", "3.0 s", "42 s", "3 min 20 s"]);
  assert.equal(tookText("2026-01-01T00:00:00Z", null), "");
});
