import assert from "node:assert/strict";
import { once } from "node:events";
import { createServer } from "node:http";
import { test } from "node:test";

import { ApiError, NoResponse, setSession } from "../../../static/js/core/api.js";
import { EventStream, percentDone, watchJob } from "../../../static/js/jobs/job.js";

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

test("events are reported until the run is over, then the stream is closed", () => {
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

test("a run that is gone, or that nobody watches any more, is not asked for again", async () => {
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

test("percentages are whole, and 100 only when the job is done", () => {
  assert.equal(percentDone({ state: "running", done: 999, total: 1000 }), 99);
  assert.equal(percentDone({ state: "queued" }), 0);
  assert.equal(percentDone({ state: "done", done: 0, total: 0 }), 100);
});

/**
 * A server on a port of its own that answers each request as the next one says.
 * @param {((request: import("node:http").IncomingMessage, response: import("node:http").ServerResponse) => void)[]} answers
 */
async function serving(answers) {
  /** @type {import("node:http").IncomingHttpHeaders[]} */
  const asked = [];
  const server = createServer((request, response) => {
    asked.push(request.headers);
    const answer = answers.shift();
    if (answer) answer(request, response);
    else response.writeHead(204).end();
  });
  server.listen(0, "127.0.0.1");
  await once(server, "listening");
  const address = /** @type {import("node:net").AddressInfo} */ (server.address());
  return { url: `http://127.0.0.1:${address.port}/events`, asked, close: () => (server.closeAllConnections(), server.close()) };
}

/** @param {import("node:http").ServerResponse} response */
const begin = (response) => response.writeHead(200, { "Content-Type": "text/event-stream" });

/** @param {EventStream} stream */
const closed = (stream) =>
  new Promise((done) => stream.addEventListener("error", () => stream.readyState === 2 && done(undefined)));

test("events keep their names, however the stream is cut into pieces", async () => {
  const { url, asked, close } = await serving([
    (_, response) => {
      begin(response);
      const bytes = Buffer.from('retry: 1\n\n: hello\n\nevent: progress\nid: 4\ndata: {"a":"ü"}\n\nevent: end\nid: 5\ndata: 1\ndata: 2\n\n');
      for (const byte of bytes) response.write(Buffer.from([byte]));
      response.end();
    },
  ]);
  setSession("us_secret");
  /** @type {string[]} */
  const heard = [];
  const stream = new EventStream(url);
  for (const name of ["progress", "end"]) {
    stream.addEventListener(name, (event) => heard.push(`${name} ${/** @type {MessageEvent} */ (event).data}`));
  }

  await closed(stream);

  assert.deepEqual(heard, ['progress {"a":"ü"}', "end 1\n2"]);
  // It was asked again after the last event that was heard, and told that there is no more.
  assert.deepEqual(asked.map((headers) => headers["last-event-id"]), [undefined, "5"]);
  assert.deepEqual(asked.map(({ authorization }) => authorization), ["Bearer us_secret", "Bearer us_secret"]);
  close();
});

test("a connection that breaks off is opened again after the last event", async () => {
  const { url, asked, close } = await serving([
    (request, response) => {
      begin(response).write("retry: 1\n\nevent: progress\nid: 7\ndata: 1\n\n", () => request.socket.destroy());
    },
    (_, response) => void begin(response).end("event: end\nid: 8\ndata: 2\n\n"),
  ]);
  const stream = new EventStream(url);
  await new Promise((done) => stream.addEventListener("end", done));
  stream.close();

  assert.deepEqual(asked.map((headers) => headers["last-event-id"]), [undefined, "7"]);
  close();
});

test("a refused stream is not opened again", async () => {
  const { url, asked, close } = await serving([(_, response) => void response.writeHead(401).end("{}")]);
  const stream = new EventStream(url);

  await closed(stream);

  assert.equal(asked.length, 1);
  close();
});

test("a stream that is closed asks for nothing more", async () => {
  const { url, close } = await serving([(_, response) => void begin(response).write("event: progress\ndata: 1\n\n")]);
  const stream = new EventStream(url);
  await new Promise((done) => stream.addEventListener("progress", done));

  stream.close();
  stream.addEventListener("error", () => assert.fail("it was told of an error"));
  await new Promise((done) => setTimeout(done, 5));

  assert.equal(stream.readyState, 2);
  close();
});
