import assert from "node:assert/strict";
import { once } from "node:events";
import { createServer } from "node:http";
import { test } from "node:test";

import { setSession } from "../../../static/js/core/api.js";
import { EventStream } from "../../../static/js/jobs/job.js";

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

test("events are told with their names, however they are cut", async () => {
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

test("what is refused is not asked for again", async () => {
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
