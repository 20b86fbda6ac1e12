import assert from "node:assert/strict";
import { test } from "node:test";

import { storedImage } from "../../../static/js/stage/stored.js";

const ascii = (/** @type {string} */ text) => [...text].map((c) => c.charCodeAt(0));
const bytesOf = async (/** @type {Blob} */ file) => [...new Uint8Array(await file.arrayBuffer())];

/** @param {number} marker @param {number[]} body */
const segment = (marker, body) => [0xff, marker, 0, body.length + 2, ...body];

/** @param {string} name @param {number[]} body */
const chunk = (name, body) => [0, 0, 0, body.length, ...ascii(name), ...body, 1, 2, 3, 4];

/** @param {number} colors the type of the colours */
const header = (colors) => [0x89, ...ascii("PNG"), 13, 10, 26, 10, ...chunk("IHDR", [0, 0, 0, 1, 0, 0, 0, 1, 8, colors, 0, 0, 0])];

test("a JPEG loses its EXIF data and nothing else", async () => {
  const start = [0xff, 0xd8, ...segment(0xe0, [...ascii("JFIF"), 0])];
  const rest = [...segment(0xe1, ascii("http://ns.adobe")), ...segment(0xda, [9]), 0xff, 0xe1, 0, 8, ...ascii("Exif"), 0, 0];
  const exif = segment(0xe1, [...ascii("Exif"), 0, 0, 42]);

  const { file, mayHaveAlpha } = await storedImage(new Blob([new Uint8Array([...start, ...exif, ...rest])], { type: "image/jpeg" }));

  assert.deepEqual(await bytesOf(file), [...start, ...rest]);
  assert.deepEqual([file.type, mayHaveAlpha], ["image/jpeg", false]);
});

test("a PNG loses its EXIF data, and is looked at for transparency only where it may have any", async () => {
  const rest = [...chunk("IDAT", [7]), ...chunk("IEND", [])];
  const alpha = async (/** @type {number[]} */ bytes) => (await storedImage(new Blob([new Uint8Array(bytes)]))).mayHaveAlpha;

  const { file } = await storedImage(new Blob([new Uint8Array([...header(2), ...chunk("eXIf", [1, 2]), ...rest])]));

  assert.deepEqual(await bytesOf(file), [...header(2), ...rest]);
  assert.deepEqual(await Promise.all([0, 2, 3, 4, 6].map((colors) => alpha([...header(colors), ...rest]))), [false, false, false, true, true]);
  assert.equal(await alpha([...header(3), ...chunk("tRNS", [0]), ...rest]), true);
});

test("an ordinary file stays the object that it is, and so does one that is no image or ends early", async () => {
  for (const bytes of [[...header(2), ...chunk("IEND", [])], [0xff, 0xd8, ...segment(0xe0, [1])], [0xff, 0xd8, 0xff], ascii("picture"), [...header(2), 0, 0, 9]]) {
    const given = new Blob([new Uint8Array(bytes)]);
    assert.equal((await storedImage(given)).file, given);
  }
});
