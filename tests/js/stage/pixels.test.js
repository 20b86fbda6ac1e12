import assert from "node:assert/strict";
import { test } from "node:test";

import { extentOf, matchingPixels, outlinesOf, tagMatcher } from "../../../static/js/stage/pixels.js";

/** @type {any} */
const CAR = { tag: 14, name: "Car", rgb: [0, 0, 142] };
/** @type {any} */
const RIDER = { tag: 13, name: "Rider", rgb: [255, 0, 0] };
const RGB = { encoding: "palette", channel_order: "rgb", lossy: false };

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

test("the matching pixels are those with an accepted tag", () => {
  const rgba = new Uint8ClampedArray([0, 0, 142, 255, 70, 70, 70, 255]);
  assert.deepEqual([...matchingPixels(rgba, tagMatcher([CAR], RGB))], [1, 0]);
});

test("pixels are outlined by lines as long as they are straight, around holes too", () => {
  assert.deepEqual(outlinesOf(Uint8Array.from([0, 1, 1, 0]), 4), [[1, 0, 3, 0], [1, 1, 3, 1], [1, 0, 1, 1], [3, 0, 3, 1]]);
  const ring = Uint8Array.from([1, 1, 1, 1, 0, 1, 1, 1, 1]);
  assert.equal(outlinesOf(ring, 3).length, 8);
  assert.deepEqual(outlinesOf(new Uint8Array(9), 3), []);
});

test("the extent of an object is the rectangle around all pixels of its colour", () => {
  const colors = Uint32Array.from([0, 7, 0, 0, 0, 7, 0, 0, 9]);
  assert.deepEqual(extentOf(colors, 3, 7), [1, 0, 3, 2]);
});
