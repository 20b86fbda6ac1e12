import assert from "node:assert/strict";
import { test } from "node:test";

import { brokenToFit } from "../../../static/js/stage/shapes.js";

/** A context in which each letter is ten pixels wide. */
const ctx = { measureText: (/** @type {string} */ text) => /** @type {TextMetrics} */ ({ width: 10 * text.length }) };

test("a label that fits is one line", () => {
  assert.deepEqual(brokenToFit(ctx, "4.1 % Car · hidden", 180), ["4.1 % Car · hidden"]);
});

test("a label that is too long is broken between its parts", () => {
  assert.deepEqual(brokenToFit(ctx, "4.1 % Car · hidden", 170), ["4.1 % Car", "hidden"]);
});

test("a label that is a sentence is broken between words, and no word is lost", () => {
  const lines = brokenToFit(ctx, "✕  all Car pixels here are 2.6 m nearer than the box", 180);

  assert.equal(lines.join(" "), "✕  all Car pixels here are 2.6 m nearer than the box");
  assert.ok(lines.every((line) => line.length <= 18), String(lines));
});
