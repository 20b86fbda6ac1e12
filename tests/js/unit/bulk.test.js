import assert from "node:assert/strict";
import { test } from "node:test";

import { ApiError, NoAnswer } from "../../../static/js/core/api.js";
import { createBulk } from "../../../static/js/review/outbox.js";
import { memoryStorage } from "./builders.js";

/** A server that answers as it is told. */
function bulkWith(answers, storage = memoryStorage(), tab = "t1", person = "ada") {
  const sent = [];
  const events = [];
  let key = 0;
  const calls = {
    send: async (act) => {
      sent.push(act);
      const answer = answers.shift() ?? { id: 7, count: act.count, skipped: [], stale: [] };
      if (answer instanceof Error) throw answer;
      return answer;
    },
    undo: async (id) => ({ id: id + 1, undone: 3, skipped: [] }),
  };
  const bulk = createBulk(storage, tab, () => person, calls, {
    onDone: (done) => events.push(["done", done.batchId, done.skipped, done.stale]),
    onGivenUp: (act) => events.push(["given up", act.key]),
    onUndone: (id, out) => events.push(["undone", id, out.undone]),
    onError: () => {},
  }, () => `k${++key}`);
  return { bulk, sent, events, storage };
}

const ACT = { dataset: "d", verdict: /** @type {const} */ ("reject"), boxIds: [1, 2, 3], count: 3 };
const tick = () => new Promise((done) => setTimeout(done));

test("an act is sent once and forgotten when it is stored", async () => {
  const { bulk, sent, events, storage } = bulkWith([]);

  bulk.start(ACT);
  assert.deepEqual([...bulk.waitingIds()], [1, 2, 3]);
  await tick();

  assert.deepEqual(sent.map(({ boxIds }) => boxIds), [[1, 2, 3]]);
  assert.deepEqual(events, [["done", 7, [], []]]);
  assert.deepEqual([bulk.open.get(), storage.length], [[], 0]);
});

for (const [name, error] of [
  ["offline", new NoAnswer(null)],
  ["signed out", new ApiError(401, {}, null)],
  ["busy", new ApiError(503, { detail: "busy" }, 1)],
]) {
  test(`an act that cannot be sent (${name}) waits, and goes again with the same key`, async () => {
    const { bulk, sent, events } = bulkWith([error]);
    bulk.start(ACT);
    await tick();
    assert.deepEqual(bulk.open.get().map(({ state }) => state), ["waiting"]);

    bulk.resume();
    await tick();

    assert.deepEqual(sent.map(({ key }) => key), ["k1", "k1"]);
    assert.deepEqual(events, [["done", 7, [], []]]);
  });
}

test("an act survives its page, and goes on in the next one or in another tab", async () => {
  const { bulk, storage } = bulkWith([new NoAnswer(null)]);
  bulk.start(ACT);
  await tick();

  const same = bulkWith([], storage);
  same.bulk.adopt(new Set(["t1"]));
  assert.deepEqual(same.bulk.open.get().map(({ act }) => act.key), ["k1"]);
  const other = bulkWith([], storage, "t2");
  assert.deepEqual(other.bulk.open.get(), []);
  other.bulk.adopt(new Set(["t1"]));
  assert.deepEqual(other.bulk.open.get(), []);
  other.bulk.adopt(new Set());
  other.bulk.resume();
  await tick();

  assert.deepEqual(other.events, [["done", 7, [], []]]);
  assert.equal(storage.length, 0);
});

test("an act is sent under the name of who did it, and under no other", async () => {
  const { bulk, storage } = bulkWith([new ApiError(401, {}, null)]);
  bulk.start(ACT);
  await tick();

  const bo = bulkWith([], storage, "t1", "bo");
  bo.bulk.adopt(new Set());
  bo.bulk.resume();
  await tick();
  assert.deepEqual([bo.sent, bo.bulk.open.get()], [[], []]);

  const ada = bulkWith([], storage);
  ada.bulk.adopt(new Set());
  ada.bulk.resume();
  await tick();
  assert.deepEqual(ada.sent.map(({ key, person }) => [key, person]), [["k1", "ada"]]);
});

test("boxes that are not as they were seen are not tried again by themselves: somebody decides", async () => {
  const { bulk, sent } = bulkWith([new ApiError(412, { code: "stale_snapshot", detail: "selects 4" }, null)]);
  bulk.start({ dataset: "d", verdict: "keep", filter: { class: "car" }, snapshot: "s", count: 3 });
  await tick();
  assert.deepEqual(bulk.open.get().map(({ state, text }) => [state, text]), [["changed", "selects 4"]]);

  bulk.resume();
  await tick();

  assert.equal(sent.length, 1);
});

test("boxes that somebody answered meanwhile are told", async () => {
  const { bulk, events } = bulkWith([{ id: 7, count: 2, skipped: [], stale: [2] }]);

  bulk.start({ ...ACT, seen: [0, 0, 0] });
  await tick();

  assert.deepEqual(events, [["done", 7, [], [2]]]);
});

test("what was refused is shown until it is given up", async () => {
  const { bulk, events, storage } = bulkWith([new ApiError(413, { detail: "too many" }, null)]);
  bulk.start(ACT);
  await tick();
  assert.deepEqual(bulk.open.get().map(({ state, text }) => [state, text]), [["refused", "too many"]]);

  bulk.giveUp("k1");

  assert.deepEqual(events, [["given up", "k1"]]);
  assert.equal(storage.length, 0);
});
