import assert from "node:assert/strict";
import { once } from "node:events";
import { createServer } from "node:http";
import { after, before, test } from "node:test";

import { ApiError, NoResponse, blob, createRetries, get, post, send, setSession, url, whenSignedOut } from "../../../static/js/core/api.js";

/** The Authorization header of each request, in order. @type {(string | undefined)[]} */
const shown = [];
const server = createServer((request, response) => {
  shown.push(request.headers.authorization);
  const isIn = request.headers.authorization === "Bearer us_good";
  response.writeHead(isIn ? 200 : 401, { "Content-Type": "application/problem+json", "Retry-After": "7" });
  response.end(JSON.stringify(isIn ? {} : { code: "session_expired", detail: "Sign in again." }));
});
let address = "";

before(async () => {
  server.listen(0, "127.0.0.1");
  await once(server, "listening");
  address = `http://127.0.0.1:${/** @type {import("node:net").AddressInfo} */ (server.address()).port}/`;
});

after(() => server.close());

test("an address contains its path parameters, escaped, and only the query parameters that are set", () => {
  assert.equal(
    url("/api/v1/datasets/{dataset}/frames", { path: { dataset: "a b/ü" }, query: { verdict: "kept", key: "", class: null, cursor: undefined, toss_up: false, limit: 5 } }),
    "/api/v1/datasets/a%20b%2F%C3%BC/frames?verdict=kept&toss_up=false&limit=5",
  );
  assert.equal(url("/api/v1/datasets/{dataset}/frames/{key}", { path: { dataset: "s", key: "run 1/000?" } }), "/api/v1/datasets/s/frames/run%201/000%3F");
  assert.equal(url("/api/v1/session"), "/api/v1/session");
  assert.equal(url("/api/v1/datasets/{dataset}/frames/{key}", { path: { dataset: "s", key: "..a/.b" } }), "/api/v1/datasets/s/frames/..a/.b");
});

test("a name that the browser would resolve to another address is refused", () => {
  for (const key of ["..", "a/../../tokens", "."]) {
    assert.throws(() => url("/api/v1/datasets/{dataset}/frames/{key}", { path: { dataset: "s", key } }), { name: "ApiError", status: 404 });
  }
});

test("a refusal of the page's own session is reported, and of any other session it is not", async () => {
  /** @type {(string | undefined)[]} */
  const told = [];
  whenSignedOut(({ problem }) => told.push(problem.code));

  setSession("us_good");
  await send(address);
  await assert.rejects(send(address, {}, "us_another"), ApiError);
  await assert.rejects(send(address, {}, ""), ApiError);
  assert.deepEqual(told, []);

  setSession("us_old");
  await assert.rejects(send(address), (error) => error instanceof ApiError && error.status === 401 && error.retryAfterS === 7 && error.message === "Sign in again.");
  assert.deepEqual(told, ["session_expired"]);
  assert.deepEqual(shown, ["Bearer us_good", "Bearer us_another", undefined, "Bearer us_old"]);
});

test("a refusal of a session that has been replaced meanwhile signs nobody out", async () => {
  let times = 0;
  whenSignedOut(() => void (times += 1));
  setSession("us_old");
  const asked = send(address);
  setSession("us_good");

  await assert.rejects(asked, ApiError);

  assert.equal(times, 0);
});

test("a missing response, a refusal and an aborted call are three different errors", async () => {
  await assert.rejects(send("http://127.0.0.1:1/"), NoResponse);
  const stop = new AbortController();
  stop.abort();
  await assert.rejects(send(address, { signal: stop.signal }), { name: "AbortError" });
});

/** A response that breaks off after its beginning. @param {number} status */
const cut = (status) => new Response(new ReadableStream({ pull: (body) => (body.enqueue(new TextEncoder().encode('{"box_')), body.error(new TypeError("network error"))) }), { status });

for (const [what, response] of /** @type {[string, () => Response][]} */ ([
  ["breaks off", () => cut(200)],
  ["refuses, and breaks off", () => cut(503)],
  ["is no JSON", () => new Response("<html>Sign in to this network</html>")],
])) {
  test(`a response that ${what} counts as no response`, async (t) => {
    t.mock.method(globalThis, "fetch", async () => response());
    await assert.rejects(get("/api/v1/session"), NoResponse);
  });
}

test("a file that breaks off counts as no response", async (t) => {
  t.mock.method(globalThis, "fetch", async () => cut(200));
  await assert.rejects(blob("/api/v1/frames/1/image"), NoResponse);
});

test("a call that is aborted while its response arrives does not count as no response", async (t) => {
  const stop = new AbortController();
  t.mock.method(globalThis, "fetch", async () => (stop.abort(new Error("left")), cut(200)));
  await assert.rejects(get("/api/v1/session", { signal: stop.signal }), (error) => !(error instanceof NoResponse));
});

test("the key of a request that may be repeated is sent as its Idempotency-Key", async (t) => {
  const fetched = t.mock.method(globalThis, "fetch", async () => Response.json({}));

  await post("/api/v1/boxes/{box_id}/reviews/{revision}/undo", { path: { box_id: 7, revision: 2 }, key: "once" });

  const [address, { headers }] = /** @type {any} */ (fetched.mock.calls[0]?.arguments);
  assert.equal(address, "/api/v1/boxes/7/reviews/2/undo");
  assert.equal(headers.get("Idempotency-Key"), "once");
});

test("waits for another attempt double, up to half a minute, unless the server names a time", () => {
  /** @type {number[]} */
  const waits = [];
  const retries = createRetries((_, ms) => void waits.push(ms / 1000));
  const wait = (/** @type {(number | null)[]} */ ...asked) => asked.forEach((seconds) => retries.wait(() => {}, seconds));

  wait(null, null, 7, null, null, null, null);
  retries.reset();
  wait(null);

  assert.deepEqual(waits, [1, 2, 7, 8, 16, 30, 30, 1]);
});

test("a skipped wait is none, even if the server names a time, and only the next one is skipped", () => {
  /** @type {number[]} */
  const waits = [];
  const retries = createRetries((_, ms) => void waits.push(ms / 1000));

  retries.skipNext();
  retries.wait(() => {}, 7);
  retries.wait(() => {});
  retries.skipNext();
  retries.reset();
  retries.wait(() => {});

  assert.deepEqual(waits, [0, 2, 1]);
});

test("of several waits only the last one leads to an attempt", () => {
  /** @type {(() => void)[]} */
  const ends = [];
  /** @type {string[]} */
  const tried = [];
  const retries = createRetries((run) => void ends.push(run));

  retries.wait(() => tried.push("first"));
  retries.wait(() => tried.push("second"));
  ends.forEach((end) => end());

  assert.deepEqual(tried, ["second"]);
});
