import assert from "node:assert/strict";
import { test } from "node:test";

import { frameKey, match, suffixOf, withoutTop } from "../../../static/js/upload/matching.js";
import { entries } from "./builders.js";

for (const [path, key] of [
  ["images/7.png", "7"],
  ["train/images/7.png", "train/7"],
  ["train/labels/a.b.txt", "train/a.b"],
  ["Images/street one/7.PNG", "street one/7"],
  ["cafe\u0301/7.png", "caf\u00e9/7"],
]) {
  test(`${path} belongs to frame ${key}`, () => assert.equal(frameKey(path), key));
}

test("the suffix is the last one, and a hidden file has none", () => {
  assert.deepEqual(["a/b.c.PNG", "a.b/c", ".hidden"].map(suffixOf), [".png", "", ""]);
});

test("one folder that holds everything is what was meant; two are not", () => {
  assert.deepEqual(withoutTop(entries("town/a.png", "town/b/c.png")).map(({ path }) => path), ["a.png", "b/c.png"]);
  assert.deepEqual(withoutTop(entries("images/a.png", "seg/a.png")).map(({ path }) => path), ["images/a.png", "seg/a.png"]);
});

test("files of the same name belong together, in parallel folders or in a flat one", () => {
  const { frames, unmatched } = match(entries("labels/x/1.txt", "labels/y/2.txt"), entries("images/x/1.png", "images/y/2.png"), entries("1.png", "2.png"));

  assert.deepEqual(frames.map(({ key, image, segmentation }) => [key, image?.path, segmentation?.path]), [
    ["x/1", "images/x/1.png", "1.png"],
    ["y/2", "images/y/2.png", "2.png"],
  ]);
  assert.deepEqual(unmatched, []);
});

test("a name that occurs twice is not guessed, and whatever is left over is listed with its reason", () => {
  const { frames, unmatched } = match(entries("x/1.txt", "y/1.txt"), entries("x/1.jpg", "x/1.png", "z/9.png"), entries("1.png"));

  assert.deepEqual(frames.map(({ image, segmentation }) => [image?.path, segmentation]), [["x/1.jpg", null], [undefined, null]]);
  assert.deepEqual(unmatched, [
    { path: "x/1.png", why: "same frame as x/1.jpg, which is used" },
    { path: "z/9.png", why: "no label file for this image" },
    { path: "1.png", why: "no label file for this segmentation" },
  ]);
});
