import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { createLazy, createMedia } from "../../../static/js/stage/media.js";

const tick = () => new Promise((done) => setTimeout(done));

/** A lazy value whose requests stay open until the test answers them. */
function lazyByHand() {
  /** @type {{signal: AbortSignal, answer: (value: string) => void, fail: (error: Error) => void}[]} */
  const requests = [];
  const lazy = createLazy((signal) => new Promise((answer, fail) => requests.push({ signal, answer, fail })));
  return { lazy, requests };
}

test("several callers get their value from one request, and the value is kept", async () => {
  const { lazy, requests } = lazyByHand();
  const asked = [lazy.get(), lazy.get(new AbortController().signal)];
  assert.equal(lazy.value, undefined);

  requests[0]?.answer("here");

  assert.deepEqual(await Promise.all([...asked, lazy.get()]), ["here", "here", "here"]);
  assert.deepEqual([lazy.value, requests.length], ["here", 1]);
});

test("a request is aborted when all its callers have given up, and not before", async () => {
  const { lazy, requests } = lazyByHand();
  const [one, other] = [new AbortController(), new AbortController()];
  void lazy.get(one.signal);
  void lazy.get(other.signal);

  one.abort();
  assert.equal(requests[0]?.signal.aborted, false);
  other.abort();
  assert.equal(requests[0]?.signal.aborted, true);

  const again = lazy.get();
  requests[1]?.answer("again");
  assert.equal(await again, "again");
});

test("a value that is fetched ahead is not aborted when a view that asked for it closes", () => {
  const { lazy, requests } = lazyByHand();
  void lazy.get();
  const view = new AbortController();
  void lazy.get(view.signal);

  view.abort();

  assert.equal(requests[0]?.signal.aborted, false);
});

test("a value whose request failed is requested again", async () => {
  const { lazy, requests } = lazyByHand();
  const first = lazy.get();
  requests[0]?.fail(new Error("no network"));
  await assert.rejects(first, /no network/);

  const second = lazy.get();
  requests[1]?.answer("here");

  assert.equal(await second, "here");
});

/** The ends of the addresses that were requested. @type {string[]} */
let asked;

beforeEach(() => {
  asked = [];
  globalThis.fetch = async (address) => {
    asked.push(String(address).replace("/api/v1/frames/", ""));
    const id = Number(/\d+$/.exec(String(address))?.[0]);
    return id ? Response.json({ id, has_image: true, has_segmentation: true, files: {}, segmentation: null }) : new Response("picture");
  };
  // Stands for the browser's class; these tests do not look at decoded pictures.
  globalThis.Image = /** @type {any} */ (class { decode() {} });
});

const gone = () => new AbortController().signal;

test("a frame that was fetched ahead has its picture, and is used only once", async () => {
  const media = createMedia();
  media.fetchAhead(7);
  media.fetchAhead(7);
  await tick();
  assert.deepEqual(asked, ["7", "7/image"]);

  assert.equal((await media.frame(7, gone())).id, 7);
  assert.ok(media.of(7).picture.value);
  assert.equal(asked.length, 2);
  await media.frame(7, gone());

  assert.deepEqual(asked, ["7", "7/image", "7"]);
});

for (const [what, forgotten, isAskedAgain] of /** @type {const} */ ([
  ["its own boxes", 7, true],
  ["the boxes of any frame", null, true],
  ["another frame's boxes", 8, false],
])) {
  test(`a frame that was fetched ahead before answers on ${what} changed is ${isAskedAgain ? "asked for again" : "used"}`, async () => {
    const media = createMedia();
    media.fetchAhead(7);
    await tick();

    media.forget(forgotten);
    await media.frame(7, gone());

    assert.equal(asked.filter((address) => address === "7").length, isAskedAgain ? 2 : 1);
  });
}

test("a frame that was fetched ahead may be used for twenty seconds", async (t) => {
  let now = 1_000;
  t.mock.method(Date, "now", () => now);
  const media = createMedia();
  for (const id of [7, 8]) media.fetchAhead(id);
  await tick();

  now += 19_999;
  await media.frame(7, gone());
  now += 1;
  await media.frame(8, gone());

  assert.deepEqual(asked.filter((address) => !address.endsWith("/image")), ["7", "8", "8"]);
});

test("a picture is kept when its frame is forgotten after an answer", async () => {
  const media = createMedia();
  await media.of(7).picture.get();

  media.forget(7);

  assert.ok(media.of(7).picture.value);
});

test("the eight frames that were used last are kept", () => {
  const media = createMedia();
  const [first, second] = [media.of(1), media.of(2)];
  for (const id of [3, 4, 5, 6, 7, 8]) media.of(id);

  assert.equal(media.of(1), first);
  media.of(9);

  assert.equal(media.of(1), first);
  assert.notEqual(media.of(2), second);
});

test("the mask is loaded when it is wanted, and not before", async () => {
  const { frame, picture, mask } = createMedia().of(7);
  await frame.get();
  await picture.get();
  assert.deepEqual(asked, ["7", "7/image"]);

  await mask.get();

  assert.match(asked[2] ?? "", /^7\/overlay\?layer=segmentation/);
});
