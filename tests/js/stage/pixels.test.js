import assert from "node:assert/strict";
import { test } from "node:test";

import { highlightPixels, tagMatcher } from "../../../static/js/stage/pixels.js";

/** @type {any} */
const CAR = { tag: 14, name: "Car", rgb: [0, 0, 142] };
/** @type {any} */
const RIDER = { tag: 13, name: "Rider", rgb: [255, 0, 0] };
const RGB = { encoding: "palette", channel_order: "rgb", lossy: false };
const MATCHING = [1, 2, 3, 4];
const OTHERS = [9, 9, 9, 9];

test("in a palette image, only the exact colour matches", () => {
  const matches = tagMatcher([CAR, RIDER], RGB);
  assert.ok(matches(0, 0, 142) && matches(255, 0, 0));
  assert.ok(!matches(142, 0, 0) && !matches(0, 0, 141));
});

test("in a BGR image, colours match in that order", () => {
  const matches = tagMatcher([CAR], { ...RGB, channel_order: "bgr" });
  assert.ok(matches(142, 0, 0) && !matches(0, 0, 142));
});

test("in a raw image, the tag is the red channel, or the blue one in BGR order", () => {
  assert.ok(tagMatcher([CAR], { ...RGB, encoding: "raw" })(14, 0, 0));
  assert.ok(!tagMatcher([CAR], { ...RGB, encoding: "raw" })(0, 0, 14));
  assert.ok(tagMatcher([CAR], { ...RGB, encoding: "raw", channel_order: "bgr" })(0, 0, 14));
});

test("in a lossy image, colours match within the server's tolerance", () => {
  const matches = tagMatcher([CAR], { ...RGB, lossy: true });
  assert.ok(matches(32, 20, 120) && !matches(33, 0, 142));
});

test("nothing matches an empty accept set", () => {
  assert.ok(!tagMatcher([], RGB)(0, 0, 142));
});

test("highlightPixels colours matching pixels and the others differently, and gives the number of matches", () => {
  const rgba = new Uint8ClampedArray([0, 0, 142, 255, 70, 70, 70, 255]);
  assert.equal(highlightPixels(rgba, tagMatcher([CAR], RGB), MATCHING, OTHERS), 1);
  assert.deepEqual([...rgba], [...MATCHING, ...OTHERS]);
});
