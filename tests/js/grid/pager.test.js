import assert from "node:assert/strict";
import { test } from "node:test";

import { createBoxes } from "../../../static/js/boxes/store.js";
import { createPager, placeOf } from "../../../static/js/grid/pager.js";
import { decision } from "../../support/page/builders.js";

/** A server of `size` boxes with ids from 1 that records its requests; its cursor is the last id. */
function server(size, { total = true, without = new Set() } = {}) {
  /** @type {{limit: number, cursor: string | undefined, count: boolean}[]} */
  const asked = [];
  const state = { fails: false, asked, without };
  const load = async (request) => {
    asked.push(request);
    if (state.fails) throw new Error("no answer");
    const ids = [];
    let id = Number(request.cursor ?? 0);
    while (ids.length < request.limit && id < size) if (!state.without.has(++id)) ids.push(id);
    return { items: ids.map((box_id) => decision({ box_id })), next_cursor: id < size ? String(id) : null, ...(request.count && total ? { total: size } : {}) };
  };
  return { ...state, load, state };
}

/** Wait until no more requests are made. */
const settled = () => new Promise((done) => setTimeout(done, 5));

test("the first page gives the total, and the list has that length at once", async () => {
  const { load, asked } = server(100_000);
  const pager = createPager(createBoxes(), load);

  pager.want(0, 60);
  await settled();

  assert.deepEqual(asked, [{ limit: 200, cursor: undefined, count: true }]);
  assert.deepEqual([pager.total(), pager.count(), pager.known()], [100_000, 100_000, 200]);
  assert.equal(pager.at(59)?.box_id, 60);
  assert.equal(pager.at(5000), null);
});

test("a jump far ahead loads the way there in large pages; a jump back takes one request", async () => {
  const { load, asked } = server(20_000);
  const pager = createPager(createBoxes(), load);

  pager.want(18_000, 18_060);
  await settled();
  assert.equal(pager.at(18_059)?.box_id, 18_060);
  assert.ok(asked.length <= 20, `${asked.length} requests`);
  const before = asked.length;
  assert.equal(pager.at(100), null);

  pager.want(90, 150);
  await settled();

  assert.equal(asked.length, before + 1);
  assert.equal(pager.at(100)?.box_id, 101);
});

test("boxes far from the view are released, but their ids are kept", async () => {
  const { load } = server(30_000);
  const pager = createPager(createBoxes(), load);

  pager.want(25_000, 25_060);
  await settled();

  const held = Array.from({ length: 25_000 }, (_, i) => i).filter((i) => pager.at(i)).length;
  assert.ok(held <= 7000, `${held} boxes in memory`);
  assert.equal(pager.idAt(3), 4);
  assert.deepEqual(pager.idsBetween(7, 4), [5, 6, 7, 8]);
});

test("scrolling back stops the loading of pages on the way to a far place", async () => {
  const { load, asked } = server(100_000);
  const pager = createPager(createBoxes(), load);

  pager.want(0, 60);
  await settled();
  pager.want(90_000, 90_060);
  pager.want(0, 60);
  await settled();

  assert.ok(asked.length <= 3, `${asked.length} requests`);
});

test("revisions are given as they were shown, also for released boxes and for boxes answered here", async () => {
  const { load } = server(30_000);
  const boxes = createBoxes();
  const pager = createPager(boxes, load);
  pager.want(29_000, 29_060);
  await settled();
  boxes.receive([decision({ box_id: 29_001, revision: 3 })]);

  const revisions = pager.revisions();

  assert.equal(pager.at(100), null);
  assert.deepEqual([101, 29_001, 29_002, 30_001].map((id) => revisions.get(id)), [0, 3, 0, undefined]);
});

test("answered boxes keep their place although the filter would not find them again", async () => {
  const { load, state } = server(20_000);
  const boxes = createBoxes();
  const pager = createPager(boxes, load);
  pager.want(0, 60);
  await settled();
  boxes.layOver(new Map([[2, { verdict: /** @type {const} */ ("keep"), comment: "" }]]));
  state.without.add(2).add(3);

  pager.want(19_000, 19_060);
  await settled();
  pager.want(0, 60);
  await settled();

  assert.equal(pager.at(1)?.review?.verdict, "keep");
  assert.equal(pager.at(2), undefined);
  assert.equal(pager.at(3)?.box_id, 4);
});

test("a failed request stops the list with an error, and a retry continues", async () => {
  const { load, state } = server(1000);
  const pager = createPager(createBoxes(), load);
  state.fails = true;
  pager.want(0, 60);
  await settled();
  assert.equal(pager.error()?.message, "no answer");

  state.fails = false;
  pager.retry();
  await settled();

  assert.equal(pager.error(), null);
  assert.equal(pager.known(), 200);
});

test("without a total, the list is one longer than what is loaded, until its end is known", async () => {
  const { load } = server(450, { total: false });
  const pager = createPager(createBoxes(), load);

  pager.want(0, 60);
  await settled();
  assert.deepEqual([pager.total(), pager.count()], [null, 201]);
  pager.want(400, 460);
  await settled();

  assert.deepEqual([pager.total(), pager.count(), pager.isWhole()], [450, 450, true]);
});

test("a list that is ended while it loads aborts its request and takes no more boxes", async () => {
  const boxes = createBoxes();
  const { load } = server(100);
  /** @type {AbortSignal[]} */
  const signals = [];
  let asked = 0;
  const pager = createPager(boxes, (request, signal) => (signals.push(signal), (asked += 1), load(request)));

  pager.want(0, 60);
  pager.end();
  await settled();

  assert.deepEqual([asked, signals[0]?.aborted], [1, true]);
  assert.equal(boxes.get(5), undefined);
});

test("a list that is ended releases its boxes", async () => {
  const { load } = server(100);
  const boxes = createBoxes();
  const pager = createPager(boxes, load);
  pager.want(0, 60);
  await settled();
  assert.deepEqual([boxes.get(5)?.box_id, pager.indexOf(5), pager.indexOf(500)], [5, 4, -1]);

  pager.end();
  await settled();

  assert.equal(boxes.get(5), undefined);
});

test("the list of a closed view releases its boxes when all lists have to be loaded again", async () => {
  const boxes = createBoxes();
  const { load } = server(3);
  globalThis.fetch = async () => Response.json(await load({ limit: 200, count: true }));
  const app = /** @type {any} */ ({ boxes });
  const place = placeOf(app, "d", {}, "d {}");
  place.pager.want(0, 3);
  await settled();
  assert.equal(boxes.all([1, 2, 3]).length, 3);

  boxes.reload();
  await settled();

  assert.deepEqual(boxes.all([1, 2, 3]), []);
});

test("a kept list is outdated when a frame has been replaced by one with as many boxes, and only then", async () => {
  const { load } = server(3);
  let newest = 7;
  globalThis.fetch = async (input) => {
    const { pathname, searchParams } = new URL(String(input), "http://127.0.0.1");
    if (pathname.endsWith("/boxes")) return Response.json(await load({ limit: 200, count: true }));
    if (!pathname.endsWith("/frames")) return Response.json({ created_at: "2026-01-01T00:00:00Z", active_run: 1, counts: { boxes: 3 } });
    assert.deepEqual([searchParams.get("sort"), searchParams.get("limit")], ["-id", "1"]);
    return Response.json({ items: newest ? [{ id: newest }] : [], next_cursor: null });
  };
  const app = /** @type {any} */ ({ boxes: createBoxes() });
  const open = () => placeOf(app, "replaced", {}, "replaced {}");
  open();

  assert.equal(await open().isOutdated, false);
  newest = 8;
  assert.equal(await open().isOutdated, true);
});
