import assert from "node:assert/strict";
import { test } from "node:test";

import { ApiError, NoResponse } from "../../../static/js/core/api.js";
import { percentDone, watchJob } from "../../../static/js/jobs/job.js";

/** An event source that does what the test says; `readyState` as in browsers. */
class Source extends EventTarget {
  readyState = 1;
  close() {
    this.readyState = 2;
  }

  /** @param {string} type @param {object} run */
  tell(type, run) {
    this.dispatchEvent(new MessageEvent(type, { data: JSON.stringify(run) }));
  }
}

/** @param {(id: number) => Promise<any>} [load] */
function watched(load = () => Promise.reject(new Error("asked without need"))) {
  const source = new Source();
  /** @type {string[]} */
  const heard = [];
  /** @type {string[]} */
  const urls = [];
  const stop = watchJob({ events: "/api/v1/runs/7/events", load: () => load(7) }, (run) => heard.push(`${run.state} ${run.done}`), {
    open: (url) => (urls.push(url), /** @type {any} */ (source)),
    pauseMs: 1,
  });
  return { source, heard, urls, stop };
}

test("events are told until the run is over, and then nobody listens any more", () => {
  const { source, heard, urls } = watched();

  source.tell("progress", { state: "running", done: 1 });
  source.tell("progress", { state: "done", done: 2 });
  source.tell("end", { state: "done", done: 2 });

  assert.deepEqual(urls, ["/api/v1/runs/7/events"]);
  assert.deepEqual(heard, ["running 1", "done 2"]);
  assert.equal(source.readyState, 2);
});

test("a connection that the browser opens again is waited for", () => {
  const { source, heard } = watched();
  source.readyState = 0;
  source.dispatchEvent(new Event("error"));
  source.readyState = 1;
  source.tell("end", { state: "failed", done: 0 });
  assert.deepEqual(heard, ["failed 0"]);
});

test("without events the run is asked for until it is over", async () => {
  const answers = [{ state: "running", done: 1 }, new NoResponse(null), { state: "cancelled", done: 2 }];
  const { source, heard } = watched(async () => {
    const next = answers.shift();
    if (next instanceof Error) throw next;
    return next;
  });

  source.readyState = 2;
  source.dispatchEvent(new Event("error"));
  while (answers.length > 0) await new Promise((done) => setTimeout(done, 1));
  await new Promise((done) => setTimeout(done, 5));

  assert.deepEqual(heard, ["running 1", "cancelled 2"]);
});

test("a run that is gone is not asked for again, and neither after stopping", async () => {
  let asked = 0;
  const { source, stop } = watched(async () => {
    asked++;
    throw new ApiError(404, {}, null);
  });
  source.readyState = 2;
  source.dispatchEvent(new Event("error"));
  await new Promise((done) => setTimeout(done, 10));
  assert.equal(asked, 1);
  stop();
  source.tell("progress", { state: "running", done: 1 });
});

test("percent are whole, and full only when done", () => {
  assert.equal(percentDone({ state: "running", done: 999, total: 1000 }), 99);
  assert.equal(percentDone({ state: "queued" }), 0);
  assert.equal(percentDone({ state: "done", done: 0, total: 0 }), 100);
});
