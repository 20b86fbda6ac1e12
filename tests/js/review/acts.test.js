import assert from "node:assert/strict";
import { test } from "node:test";

import { ApiError, NoResponse } from "../../../static/js/core/api.js";
import { createOutbox, createSender } from "../../../static/js/review/outbox.js";
import { memoryStorage } from "../builders.js";

/** A server that answers as it is told. */
function actsWith(answers, storage = memoryStorage(), tab = "t1", person = "ada") {
  const sent = [];
  const events = [];
  let key = 0;
  const calls = {
    answer: async () => assert.fail("no answer on one box was given"),
    act: async (/** @type {any} */ act) => {
      sent.push(act);
      const answer = answers.shift() ?? { id: 7, count: act.count, skipped: [], stale: [] };
      if (answer instanceof Error) throw answer;
      return answer;
    },
  };
  const outbox = createOutbox(storage, tab, () => person, () => `k${++key}`);
  const sender = createSender(outbox, calls, {
    onStored: () => {},
    onConflict: () => {},
    onRefused: () => {},
    onDone: (done) => events.push(["done", done.batchId, done.skipped, done.stale]),
    onGivenUp: (act) => events.push(["given up", act.key]),
    onActFailed: () => {},
    onSignedOut: () => {},
  }, () => {});
  return { sender, sent, events, storage };
}

const MANY = { dataset: "d", verdict: /** @type {const} */ ("reject"), boxIds: [1, 2, 3], count: 3 };
const tick = () => new Promise((done) => setTimeout(done));

test("an act is sent once and forgotten when it is stored", async () => {
  const { sender, sent, events, storage } = actsWith([]);

  sender.start(MANY);
  assert.deepEqual([...sender.waitingIds()], [1, 2, 3]);
  await tick();

  assert.deepEqual(sent.map(({ boxIds }) => boxIds), [[1, 2, 3]]);
  assert.deepEqual(events, [["done", 7, [], []]]);
  assert.deepEqual([sender.open.get(), storage.length], [[], 0]);
});

for (const [name, error] of [
  ["offline", new NoResponse(null)],
  ["signed out", new ApiError(401, {}, null)],
  ["busy", new ApiError(503, { detail: "busy" }, 1)],
]) {
  test(`an act that cannot be sent (${name}) waits, and goes again with the same key`, async () => {
    const { sender, sent, events } = actsWith([error]);
    sender.start(MANY);
    await tick();
    assert.deepEqual(sender.open.get().map(({ state }) => state), ["waiting"]);

    sender.resume();
    await tick();

    assert.deepEqual(sent.map(({ key }) => key), ["k1", "k1"]);
    assert.deepEqual(events, [["done", 7, [], []]]);
  });
}

test("an act survives its page, and goes on in the next one or in another tab", async () => {
  const { sender, storage } = actsWith([new NoResponse(null)]);
  sender.start(MANY);
  await tick();

  const same = actsWith([], storage);
  same.sender.adopt(new Set(["t1"]));
  assert.deepEqual(same.sender.open.get().map(({ act }) => act.key), ["k1"]);
  const other = actsWith([], storage, "t2");
  assert.deepEqual(other.sender.open.get(), []);
  other.sender.adopt(new Set(["t1"]));
  assert.deepEqual(other.sender.open.get(), []);
  other.sender.adopt(new Set());
  other.sender.resume();
  await tick();

  assert.deepEqual(other.events, [["done", 7, [], []]]);
  assert.equal(storage.length, 0);
});

test("an act is sent under the name of who did it, and under no other", async () => {
  const { sender, storage } = actsWith([new ApiError(401, {}, null)]);
  sender.start(MANY);
  await tick();

  const bo = actsWith([], storage, "t1", "bo");
  bo.sender.adopt(new Set());
  bo.sender.resume();
  await tick();
  assert.deepEqual([bo.sent, bo.sender.open.get()], [[], []]);

  const ada = actsWith([], storage);
  ada.sender.adopt(new Set());
  ada.sender.resume();
  await tick();
  assert.deepEqual(ada.sent.map(({ key, person }) => [key, person]), [["k1", "ada"]]);
});

test("boxes that are not as they were seen are not tried again by themselves: somebody decides", async () => {
  const { sender, sent } = actsWith([new ApiError(412, { code: "stale_snapshot", detail: "selects 4" }, null)]);
  sender.start({ dataset: "d", verdict: "keep", filter: { class: "car" }, snapshot: "s", count: 3 });
  await tick();
  assert.deepEqual(sender.open.get().map(({ state, text }) => [state, text]), [["changed", "selects 4"]]);

  sender.resume();
  await tick();

  assert.equal(sent.length, 1);
});

test("boxes that somebody answered meanwhile are told", async () => {
  const { sender, events } = actsWith([{ id: 7, count: 2, skipped: [], stale: [2] }]);

  sender.start({ ...MANY, seen: [0, 0, 0] });
  await tick();

  assert.deepEqual(events, [["done", 7, [], [2]]]);
});

test("what was refused is shown until it is given up", async () => {
  const { sender, events, storage } = actsWith([new ApiError(413, { detail: "too many" }, null)]);
  sender.start(MANY);
  await tick();
  assert.deepEqual(sender.open.get().map(({ state, text }) => [state, text]), [["refused", "too many"]]);

  sender.giveUp("k1");

  assert.deepEqual(events, [["given up", "k1"]]);
  assert.equal(storage.length, 0);
});
