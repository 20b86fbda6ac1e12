import assert from "node:assert/strict";
import { test } from "node:test";

import { boxIn, createCrops, cropRequest, placed } from "../../../static/js/boxes/crops.js";
import { ApiError } from "../../../static/js/core/api.js";

/** A source of crops whose requests stay open until the test answers them. */
function source() {
  /** @type {Map<string, {resolve: (crop: any) => void, reject: (error: unknown) => void, signal: AbortSignal}>} */
  const asked = new Map();
  const fetchCrop = (url, signal) =>
    new Promise((resolve, reject) => {
      asked.set(url, { resolve, reject, signal });
      signal.addEventListener("abort", () => reject(new DOMException("aborted", "AbortError")));
    });
  return { asked, fetchCrop };
}

const crop = (src) => ({ src, width: 10, height: 10 });
const tick = () => new Promise((done) => setTimeout(done));

test("a crop that nobody wants any more is cancelled", async () => {
  const { asked, fetchCrop } = source();
  const crops = createCrops(fetchCrop);
  const told = [];
  const letGo = [1, 2].map(() => crops.want("a", (answer) => told.push(answer)));

  letGo[0]?.();
  assert.equal(asked.get("a")?.signal.aborted, false);
  letGo[1]?.();
  await tick();

  assert.equal(asked.get("a")?.signal.aborted, true);
  assert.deepEqual(told, []);
});

test("a crop that is wanted several times is requested once", async () => {
  const { asked, fetchCrop } = source();
  const crops = createCrops(fetchCrop);
  const told = [];
  crops.want("a", ({ state }) => told.push(state));
  crops.want("a", ({ state }) => told.push(state));

  asked.get("a")?.resolve(crop("a"));
  await tick();
  crops.want("a", ({ state }) => told.push(state));

  assert.deepEqual(told, ["shown", "shown", "shown"]);
  assert.equal(asked.size, 1);
});

test("a crop that was cancelled is loaded when it is wanted again", async () => {
  const { asked, fetchCrop } = source();
  const crops = createCrops(fetchCrop);
  crops.want("a", () => {})();
  const told = [];
  crops.want("a", ({ state }) => told.push(state));

  asked.get("a")?.resolve(crop("a"));
  await tick();

  assert.deepEqual(told, ["shown"]);
});

test("a box without an image (404) is told apart from a failed request", async () => {
  const { asked, fetchCrop } = source();
  const errors = [];
  const crops = createCrops(fetchCrop, { onError: (error) => errors.push(error) });
  const told = [];
  crops.want("a", ({ state }) => told.push(state));
  crops.want("b", ({ state }) => told.push(state));

  asked.get("a")?.reject(new ApiError(404, {}, null));
  asked.get("b")?.reject(new ApiError(503, {}, null));
  await tick();

  assert.deepEqual(told, ["none", "failed"]);
  assert.equal(errors.length, 2);
});

test("of more crops than are kept, the oldest that is not shown is discarded", async () => {
  const { asked, fetchCrop } = source();
  const gone = [];
  const crops = createCrops(fetchCrop, { kept: 2, discard: ({ src }) => gone.push(src) });
  crops.want("a", () => {});
  const letGo = crops.want("b", () => {});
  for (const url of ["a", "b"]) asked.get(url)?.resolve(crop(url));
  await tick();
  letGo();
  crops.want("c", () => {});
  asked.get("c")?.resolve(crop("c"));
  await tick();

  assert.deepEqual(gone, ["b"]);
  assert.equal(crops.ready("b"), null);
  assert.equal(crops.ready("a")?.src, "a");
});

/** The rectangle that the server cuts out, and the size of its picture, by the server's own rule. */
function serverCrop([x0, y0, x1, y1], { pad, height }, frame) {
  const margin = pad * Math.max(x1 - x0, y1 - y0, 1);
  const left = Math.max(0, Math.floor(x0 - margin));
  const top = Math.max(0, Math.floor(y0 - margin));
  const right = Math.min(frame.width, Math.ceil(x1 + margin));
  const bottom = Math.min(frame.height, Math.ceil(y1 + margin));
  const scale = Math.min(height / (bottom - top), 8);
  return { left, top, right, bottom, natural: { width: Math.round((right - left) * scale), height: Math.round((bottom - top) * scale) } };
}

const FRAME = { width: 640, height: 360 };
const BOXES = /** @type {import("../../../static/js/boxes/box.js").Xyxy[]} */ ([
  [300, 100, 400, 140],
  [300, 100, 320, 180],
  [0, 0, 30, 60],
  [600, 100, 640, 130],
  [200, 330, 300, 360],
  [610, 340, 640, 360],
  [100.4, 50.6, 103.2, 52.1],
]);

test("a crop covers its cell, except beyond the edges of the image", () => {
  for (const xyxy of BOXES) {
    const ask = cropRequest(xyxy, 160, 1);
    const crop = serverCrop(xyxy, ask, FRAME);
    const { picture } = placed(xyxy, ask.pad, 160, crop.natural, FRAME);

    if (crop.left > 0) assert.ok(picture.left <= 0.5, `${xyxy} left`);
    if (crop.top > 0) assert.ok(picture.top <= 0.5, `${xyxy} top`);
    if (crop.right < FRAME.width) assert.ok(picture.left + picture.width >= 159.5, `${xyxy} right`);
    if (crop.bottom < FRAME.height) assert.ok(picture.top + picture.height >= 159.5, `${xyxy} bottom`);
  }
});

test("a box is drawn on its crop at the place that it has in the image", () => {
  for (const xyxy of BOXES) {
    const ask = cropRequest(xyxy, 160, 1);
    const crop = serverCrop(xyxy, ask, FRAME);
    const { picture, box } = placed(xyxy, ask.pad, 160, crop.natural, FRAME);
    const perPixel = picture.width / (crop.right - crop.left);

    assert.ok(Math.abs(box.left - picture.left - (xyxy[0] - crop.left) * perPixel) < 0.6, `${xyxy}`);
    assert.ok(Math.abs(box.top - picture.top - (xyxy[1] - crop.top) * perPixel) < 0.6, `${xyxy}`);
    assert.ok(Math.abs(picture.height / (crop.bottom - crop.top) - perPixel) < 0.05 * perPixel, `${xyxy} keeps its shape`);
  }
});

test("a crop that the image's edge cuts off is placed by its shape if the image's size is unknown", () => {
  for (const xyxy of [BOXES[3], BOXES[4]]) {
    const ask = cropRequest(xyxy, 160, 2);
    const crop = serverCrop(xyxy, ask, FRAME);
    const known = placed(xyxy, ask.pad, 160, crop.natural, FRAME).picture;
    const guessed = placed(xyxy, ask.pad, 160, crop.natural, null).picture;

    assert.ok(Math.abs(known.width - guessed.width) < 4 && Math.abs(known.height - guessed.height) < 4, `${xyxy}`);
  }
});

test("a box without a crop is drawn in the middle of its cell, and does not fill it", () => {
  const { left, top, width, height } = boxIn([10, 20, 110, 60], 160);

  assert.ok(Math.abs(left + width / 2 - 80) < 1e-9 && Math.abs(top + height / 2 - 80) < 1e-9);
  assert.ok(width < 110 && width > 90);
  assert.ok(boxIn([10, 20, 12, 22], 160).width < 20);
});
