import assert from "node:assert/strict";
import { test } from "node:test";

import { ApiError, NoResponse } from "../../../static/js/core/api.js";
import { percentDone, watchJob } from "../../../static/js/jobs/job.js";

/**
 * Watch a job that the server reports in these states, one for each request; `next` ends the current pause.
 * @param {(object | Error)[]} states
 */
function watched(states) {
  let asked = 0;
  /** @type {string[]} */
  const heard = [];
  /** @type {{run: () => void, delayMs: number}[]} */
  const pauses = [];
  const load = async () => {
    const state = states[asked++];
    if (state instanceof Error) throw state;
    return /** @type {any} */ (state);
  };
  const then = {
    onJob: /** @param {any} job */ (job) => heard.push(`${job.state} ${job.done}`),
    onLost: /** @param {ApiError} error */ (error) => heard.push(`lost ${error.status}`),
  };
  const stop = watchJob(load, then, (run, delayMs) => pauses.push({ run, delayMs }));
  let paused = 0;
  const next = async () => {
    pauses[paused++]?.run();
    await new Promise((done) => setTimeout(done));
  };
  return { heard, pauses, stop, next, asked: () => asked };
}

test("a job is loaded again until it has ended, less often with time", async () => {
  const states = Array.from({ length: 5 }, (_, done) => ({ state: "running", done }));
  const { heard, pauses, next, asked } = watched([...states, { state: "done", done: 5 }]);

  for (let i = 0; i < 8; i++) await next();

  assert.deepEqual(heard, ["running 0", "running 1", "running 2", "running 3", "running 4", "done 5"]);
  assert.deepEqual(pauses.map(({ delayMs }) => delayMs).slice(0, 6), [200, 400, 800, 1000, 1000, 1000]);
  assert.equal(asked(), 6);
});

test("a job is asked for again when the server does not answer or is busy", async () => {
  const { heard, next } = watched([new NoResponse(null), new ApiError(503, {}, null), { state: "cancelled", done: 2 }]);

  for (let i = 0; i < 3; i++) await next();

  assert.deepEqual(heard, ["cancelled 2"]);
});

test("a job that no longer exists (404) is reported as lost, and not asked for again", async () => {
  const { heard, next, asked } = watched([new ApiError(404, {}, null)]);

  for (let i = 0; i < 3; i++) await next();

  assert.equal(asked(), 1);
  assert.deepEqual(heard, ["lost 404"]);
});

test("a busy server is asked again after the time that it names", async () => {
  const running = { state: "running", done: 1 };
  const { pauses, next } = watched([running, new ApiError(429, {}, 7), new NoResponse(null), running]);

  for (let i = 0; i < 4; i++) await next();

  assert.deepEqual(pauses.map(({ delayMs }) => delayMs), [200, 400, 7000, 2000, 800]);
});

test("after stop, a job is neither reported nor asked for again", async () => {
  const { heard, stop, next, asked } = watched([{ state: "running", done: 1 }, { state: "running", done: 2 }]);
  await next();

  const last = next();
  stop();
  await last;
  await next();

  assert.deepEqual(heard, ["running 1"]);
  assert.equal(asked(), 2);
});

test("percentages are whole, and 100 only when the job is done", () => {
  assert.equal(percentDone({ state: "running", done: 999, total: 1000 }), 99);
  assert.equal(percentDone({ state: "queued" }), 0);
  assert.equal(percentDone({ state: "done", done: 0, total: 0 }), 100);
});
