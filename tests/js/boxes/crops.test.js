import assert from "node:assert/strict";
import { test } from "node:test";

import { ApiError } from "../../../static/js/core/api.js";
import { createCrops } from "../../../static/js/boxes/crops.js";

/** Crops that arrive when one says so. */
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

test("no more than so many are under way, the next one when one is there", async () => {
  const { asked, fetchCrop } = source();
  const crops = createCrops(fetchCrop, { parallel: 2 });
  for (const url of ["a", "b", "c"]) crops.want(url, () => {});
  assert.deepEqual([...asked.keys()], ["a", "b"]);

  asked.get("a")?.resolve(crop("a"));
  await tick();

  assert.deepEqual([...asked.keys()], ["a", "b", "c"]);
});

test("what was scrolled away is not asked for, and what is under way is cancelled", async () => {
  const { asked, fetchCrop } = source();
  const crops = createCrops(fetchCrop, { parallel: 1 });
  const told = [];
  const letGoOfA = crops.want("a", (answer) => told.push(answer));
  const letGoOfB = crops.want("b", () => {});
  crops.want("c", () => {});

  letGoOfB();
  letGoOfA();
  await tick();

  assert.ok(asked.get("a")?.signal.aborted);
  assert.deepEqual([...asked.keys()], ["a", "c"]);
  assert.deepEqual(told, []);
});

test("what is given up in one stroke is never asked for in between", async () => {
  const { asked, fetchCrop } = source();
  const crops = createCrops(fetchCrop, { parallel: 1 });
  const letGo = ["a", "b", "c"].map((url) => crops.want(url, () => {}));
  crops.want("d", () => {});

  for (const stop of letGo) stop();
  await tick();

  assert.deepEqual([...asked.keys()], ["a", "d"]);
});

test("two who want the same get it from one request", async () => {
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

test("a crop that is cancelled and wanted again comes", async () => {
  const { asked, fetchCrop } = source();
  const crops = createCrops(fetchCrop);
  crops.want("a", () => {})();
  const told = [];
  crops.want("a", ({ state }) => told.push(state));

  asked.get("a")?.resolve(crop("a"));
  await tick();

  assert.deepEqual(told, ["shown"]);
});

test("a box without a picture is one thing, a failure another", async () => {
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

test("the oldest that nobody shows are discarded", async () => {
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
