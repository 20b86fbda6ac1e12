import assert from "node:assert/strict";
import { test } from "node:test";

import { ApiError, NoResponse } from "../../../static/js/core/api.js";
import { createValue } from "../../../static/js/core/observable.js";
import { createUploader, createUploads } from "../../../static/js/upload/uploader.js";

/** @param {number} count @returns {any[]} */
const frames = (count) => Array.from({ length: count }, (_, i) => ({ key: String(i), annotation: {}, files: {} }));

const settled = () => new Promise((resolve) => setImmediate(resolve));

/** An uploader whose requests stay open until the test answers them. @param {number} count */
function sending(count) {
  /** @type {{key: string, signal: AbortSignal, resolve: (isNew: boolean, boxes?: string[]) => void, reject: (error: Error) => void}[]} */
  const calls = [];
  /** @type {{run: () => void, delayMs: number}[]} */
  const timers = [];
  const put = (/** @type {{key: string}} */ { key }, /** @type {AbortSignal} */ signal) =>
    new Promise((resolve, reject) =>
      calls.push({ key, signal, resolve: (isNew, boxes = []) => resolve({ isNew, answers: boxes.length, boxes }), reject }));
  const uploader = createUploader(frames(count), /** @type {any} */ (put), (run, delayMs) => timers.push({ run, delayMs }));
  const outline = () => {
    const { phase, stored, same, refused } = uploader.state.get();
    return [phase, stored, same, refused.map(({ key }) => key).join()];
  };
  return { uploader, calls, timers, outline };
}

test("four frames are sent at a time, and the end state counts new and known ones", async () => {
  const { uploader, calls, outline } = sending(6);
  uploader.resume();
  assert.equal(calls.length, 4);

  for (let i = 0; i < 6; i++) {
    calls[i]?.resolve(i !== 0);
    await settled();
  }

  assert.deepEqual(outline(), ["done", 5, 1, ""]);
});

test("frames whose answers were set aside are listed with the boxes", async () => {
  const { uploader, calls, outline } = sending(3);
  uploader.resume();
  calls[0]?.resolve(true);
  calls[1]?.resolve(true, ["suv", "bike"]);
  calls[2]?.resolve(false);
  await settled();

  assert.deepEqual(outline(), ["done", 2, 1, ""]);
  assert.deepEqual(uploader.state.get().setAside, [{ key: "1", answers: 2, boxes: ["suv", "bike"] }]);
});

test("a refused frame is listed with the server's message, and can be sent again", async () => {
  const { uploader, calls, outline } = sending(2);
  uploader.resume();
  const errors = [{ pointer: "/boxes/0", detail: "no geometry" }, { pointer: "/boxes/1", detail: "no class" }];
  calls[0]?.reject(new ApiError(422, { detail: "many faults", errors, more_errors: 7 }, null));
  calls[1]?.resolve(true);
  await settled();
  assert.deepEqual(outline(), ["done", 1, 0, "0"]);
  assert.deepEqual(uploader.state.get().refused, [{ key: "0", why: "many faults", more: ["/boxes/0: no geometry", "/boxes/1: no class", "and 7 more"] }]);

  uploader.retry();
  calls[2]?.resolve(true);
  await settled();

  assert.deepEqual(outline(), ["done", 2, 0, ""]);
});

test("while the server does not answer, an upload waits longer each time, and loses no frame", async () => {
  const { uploader, calls, timers, outline } = sending(1);
  uploader.resume();
  for (const i of [0, 1]) {
    calls[i]?.reject(new NoResponse(null));
    await settled();
    assert.equal(outline()[0], "offline");
    timers[i]?.run();
  }
  calls[2]?.resolve(true);
  await settled();

  assert.deepEqual(timers.map(({ delayMs }) => delayMs), [1000, 2000]);
  assert.deepEqual(outline(), ["done", 1, 0, ""]);
});

test("an upload waits as long as a busy server says, and when signed out until somebody resumes it", async () => {
  const { uploader, calls, timers, outline } = sending(1);
  uploader.resume();
  calls[0]?.reject(new ApiError(503, {}, 7));
  await settled();
  assert.deepEqual([outline()[0], timers[0]?.delayMs], ["busy", 7000]);

  timers[0]?.run();
  calls[1]?.reject(new ApiError(401, {}, null));
  await settled();
  assert.deepEqual([outline()[0], timers.length], ["signed-out", 1]);

  uploader.resume();
  calls[2]?.resolve(true);
  await settled();
  assert.equal(outline()[0], "done");
});

test("a paused upload finishes the frames that are being sent, and sends no others", async () => {
  const { uploader, calls, outline } = sending(6);
  uploader.resume();
  uploader.pause();
  calls.forEach(({ resolve }) => resolve(true));
  await settled();
  assert.deepEqual([calls.length, ...outline()], [4, "paused", 4, 0, ""]);

  uploader.resume();
  calls.slice(4).forEach(({ resolve }) => resolve(true));
  await settled();
  assert.deepEqual(outline(), ["done", 6, 0, ""]);
});

test("a cancelled upload aborts the frames that are being sent, and lists none of them as refused", async () => {
  const { uploader, calls, outline } = sending(6);
  uploader.resume();

  uploader.cancel();
  calls.forEach(({ signal, reject }) => signal.aborted && reject(new DOMException("", "AbortError")));
  await settled();

  assert.deepEqual([calls.length, ...outline()], [4, "stopped", 0, 0, ""]);
});

test("an upload by a person who may not write stops with one message", async () => {
  const { uploader, calls, outline } = sending(6);
  uploader.resume();

  calls[0]?.reject(new ApiError(403, { detail: "viewers cannot write" }, null));
  await settled();

  assert.deepEqual([calls.length, ...outline(), uploader.state.get().trouble], [4, "stopped", 0, 0, "", "viewers cannot write"]);
});

test("a frame with other people's answers is refused, and the others are sent", async () => {
  const { uploader, calls, outline } = sending(6);
  uploader.resume();

  calls[0]?.reject(new ApiError(403, { code: "others_answers", detail: "ada has answered" }, null));
  await settled();

  assert.equal(calls.length, 5);
  assert.deepEqual([...outline(), uploader.state.get().trouble], ["sending", 0, 0, "0", ""]);
});

test("an upload that is paused while its last frames are being sent is done when they have arrived", async () => {
  /** @type {((stored: import("../../../static/js/upload/uploader.js").Stored) => void)[]} */
  const arrive = [];
  const frames = ["a", "b"].map((key) => /** @type {any} */ ({ key }));
  const uploader = createUploader(frames, () => new Promise((resolve) => arrive.push(resolve)));
  uploader.resume();
  uploader.pause();

  arrive.forEach((resolve) => resolve({ isNew: true, answers: 0, boxes: [] }));
  await new Promise((resolve) => setTimeout(resolve));

  const { phase, stored } = uploader.state.get();
  assert.deepEqual([phase, stored], ["done", 2]);
});

test("files that are dropped while a new dataset is being made stay, also when its upload begins", async () => {
  globalThis.addEventListener ??= () => {};
  const made = /** @type {(() => void)[]} */ ([]);
  const calls = { createDataset: () => new Promise((resolve) => made.push(() => resolve(null))), putFrame: async () => ({ isNew: true, answers: 0, boxes: [] }) };
  const uploads = createUploads(/** @type {any} */ (calls), createValue(true));
  const [first, second] = [Promise.resolve([]), Promise.resolve([])];
  uploads.take(first);
  const started = uploads.start({ dataset: "town", isNew: true, classes: null, reading: {}, config: {}, frames: [], replace: false });

  uploads.take(second);
  made.forEach((resolve) => resolve());
  await started;

  assert.equal(uploads.dropped.get(), second);
});

test("a new dataset gets the configuration of the recording, and one that exists does not", async () => {
  /** @type {object[]} */
  const made = [];
  const calls = { createDataset: async (/** @type {object} */ dataset) => made.push(dataset) };
  const uploads = createUploads(/** @type {any} */ (calls), createValue(true));
  const config = { classes: { Auto: "car" }, depth_encoding: "carla-bgr" };
  const order = { dataset: "town", classes: null, reading: {}, frames: [], replace: false };

  await uploads.start({ ...order, isNew: true, config });
  await uploads.start({ ...order, isNew: true, config: {} });
  await uploads.start({ ...order, isNew: false, config });

  assert.deepEqual(made, [{ name: "town", config }, { name: "town" }]);
});
