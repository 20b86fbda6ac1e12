import assert from "node:assert/strict";
import { test } from "node:test";

import { depthText, objectText } from "../../../static/js/queue/question.js";
import { seenText } from "../../../static/js/queue/track.js";

/** @type {any} */
const BOX = { class: "car", id: "218", xyxy: [10, 10, 22, 16], distance: 53, distance_range: null };
/** @type {any} */
const HIDER = { where: "inside", box: { class: "car", id: "214", distance: 31, distance_range: null } };

test("the object of a question has its size, its distance and what it is inside or behind of, as far as they are known", () => {
  assert.equal(objectText(BOX, HIDER), "12 × 6 px, 53 m away, inside car 214 at 31 m");
  assert.equal(objectText({ ...BOX, distance: null }, null), "12 × 6 px");
  const behindWall = { ...BOX, hidden_by: [{ name: "Building", percent: 71.2 }] };
  assert.equal(objectText(behindWall, null), "12 × 6 px, 53 m away, 71 % of it Building");
});

test("the depths say what the pixels are", () => {
  const at = (/** @type {number | null} */ median, near = 52.5, far = 53.5) => depthText({ near, far, median, bands: [] }, BOX, HIDER);
  assert.equal(at(31), "Box 53 m, pixels 31 m: a nearer car");
  assert.equal(at(20), "Box 53 m, pixels 20 m: something nearer");
  assert.equal(at(53), "Box 53 m, pixels 53 m: where the box is");
  assert.equal(at(80, 51, 55), "Box 51 to 55 m, pixels 80 m: what is behind it");
  assert.equal(at(null), "Box 53 m, no pixels but sky");
});

test("a track says in which frames nearest to the asked one the object is visible", () => {
  /** @param {Record<number, boolean>} seen @returns {any} */
  const places = (seen) => [-2, -1, 0, 1, 2].map((offset) => ({ offset, box: { effective_verdict: seen[offset] ? "kept" : "rejected" } }));
  assert.equal(seenText(places({ [-2]: true })), "visible two frames ago");
  assert.equal(seenText(places({ [-2]: true, [-1]: true, 2: true })), "visible one frame ago, visible two frames later");
  assert.equal(seenText(places({ 0: true })), "visible in none of these frames");
});
