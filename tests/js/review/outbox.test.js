import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { createOutbox, isSingle } from "../../../static/js/review/outbox.js";
import { memoryStorage } from "../../support/page/builders.js";

/** @type {Storage} */
let storage;
/** Who is signed in. */
const person = "ada";

beforeEach(() => {
  storage = memoryStorage();
});

test("a tab takes over the answers of a closed tab, but not those of an open one", () => {
  const mine = createOutbox(storage, "t1", () => person);
  const given = { frameId: 1, verdict: /** @type {const} */ ("keep"), comment: "", seenRevision: 0 };
  createOutbox(storage, "open", () => person).addAnswer({ boxId: 1, ...given });
  createOutbox(storage, "closed", () => person).addAnswer({ boxId: 2, ...given });
  mine.takeOver(new Set(["t1", "open"]));
  assert.deepEqual(mine.items().map((item) => item.boxId), [2]);
});

test("answers of a closed tab are sorted among the tab's own by the time at which they were given", (t) => {
  let clock = 1000;
  t.mock.method(Date, "now", () => ++clock);
  const given = { frameId: 1, verdict: /** @type {const} */ ("keep"), comment: "", seenRevision: 0 };
  const mine = createOutbox(storage, "t1", () => person);
  const closed = createOutbox(storage, "closed", () => person);
  for (const outbox of [mine, closed, mine]) outbox.addAnswer({ boxId: clock, ...given });

  mine.takeOver(new Set(["t1"]));

  assert.deepEqual(mine.items().map((item) => item.boxId), [1000, 1001, 1002]);
});

test("answers keep their order, even if several are given in the same millisecond", (t) => {
  t.mock.method(Date, "now", () => 1000);
  const outbox = createOutbox(storage, "t1", () => person);
  const given = { frameId: 1, verdict: /** @type {const} */ ("keep"), comment: "", seenRevision: 0 };
  for (const boxId of [3, 1, 2]) outbox.addAnswer({ boxId, ...given });
  assert.deepEqual(outbox.items().map((item) => item.boxId), [3, 1, 2]);
});

test("an answer's seen revision is at most that of another tab's unsent answer on the box", () => {
  const given = { boxId: 1, frameId: 1, verdict: /** @type {const} */ ("keep"), comment: "" };
  createOutbox(storage, "open", () => person).addAnswer({ ...given, seenRevision: 0 });
  const mine = createOutbox(storage, "t1", () => person);
  mine.addAnswer({ ...given, seenRevision: 1 });
  assert.deepEqual(mine.items().map((item) => isSingle(item) && item.seenRevision), [0]);
});

test("entries of the storage that cannot be read as answers are ignored", () => {
  storage.setItem("unghost.outbox.v1.x", "{");
  storage.setItem("unghost.outbox.v1.y", "{}");
  assert.deepEqual(createOutbox(storage, "t1", () => person).items(), []);
});

test("lastAnswers gives the last unsent answer on each box, single or bulk", () => {
  const outbox = createOutbox(storage, "t1", () => person);
  outbox.addAnswer({ boxId: 1, frameId: 10, verdict: "keep", comment: "seen twice", seenRevision: 0 });
  outbox.addBulkAnswer({ dataset: "d", verdict: "reject", boxIds: [2, 3], seenRevisions: [0, 0], count: 2 });
  outbox.addAnswer({ boxId: 3, frameId: 10, verdict: "unsure", comment: "", seenRevision: 0 });

  assert.deepEqual(Object.fromEntries(outbox.lastAnswers()), {
    1: { verdict: "keep", comment: "seen twice" },
    2: { verdict: "reject", comment: "" },
    3: { verdict: "unsure", comment: "" },
  });
});

test("an answer for which the storage has no room does not remove the earlier one on that box", () => {
  const outbox = createOutbox(storage, "t1", () => person);
  const given = { boxId: 1, frameId: 10, verdict: /** @type {const} */ ("keep"), seenRevision: 0 };
  outbox.addAnswer({ ...given, comment: "" });
  const { setItem } = storage;
  storage.setItem = (name, value) => {
    if (value.length > 300) throw new DOMException("it is full", "QuotaExceededError");
    setItem.call(storage, name, value);
  };

  assert.throws(() => outbox.addAnswer({ ...given, comment: "x".repeat(1000) }), { name: "QuotaExceededError" });

  assert.deepEqual(outbox.items().map((item) => "comment" in item && item.comment), [""]);
});

test("answers are stored in the format that later versions of the page read", () => {
  const kept = { person: "ada", tab: "t1", dataset: "d", boxIds: [1, 2], seenRevisions: [3, 4], count: 2 };
  const before = [{ verdict: "keep", comment: "" }, { verdict: "clear", comment: "" }];
  const answer = { person: "ada", tab: "t1", key: "k1", order: 1, boxId: 3, frameId: 10, verdict: "keep", comment: "", seenRevision: 5, attempted: true };
  const bulk = { ...kept, key: "k2", order: 2, verdict: "reject", attempted: true };
  const undo = { ...kept, key: "k3", order: 3, bulkKey: "k2", batchId: 7, before };
  const texts = { "unghost.outbox.v1.k1": answer, "unghost.bulk.v1.k2": bulk, "unghost.undo.v1.k3": undo };
  for (const [name, item] of Object.entries(texts)) storage.setItem(name, JSON.stringify(item));

  const outbox = createOutbox(storage, "t2", () => person);
  outbox.takeOver(new Set());

  const [first, second, third] = /** @type {any[]} */ (outbox.items());
  assert.equal(first.seenRevision, 5);
  assert.deepEqual([second.seenRevisions, second.attempted], [[3, 4], true]);
  assert.deepEqual([third.bulkKey, third.batchId, third.seenRevisions, third.before], ["k2", 7, [3, 4], before]);
  assert.equal(outbox.undoOf("k2")?.key, "k3");
  for (const [name, item] of Object.entries(texts)) {
    assert.deepEqual(JSON.parse(storage.getItem(name) ?? ""), { ...item, tab: "t2" });
  }
});

test("unsaved answers are counted by box, and bulk answers by their size", () => {
  const outbox = createOutbox(storage, "t1", () => person);
  const given = { boxId: 1, frameId: 1, comment: "", seenRevision: 0 };
  outbox.addAnswer({ ...given, verdict: "keep" });
  outbox.addAnswer({ ...given, verdict: "reject" });
  outbox.addBulkAnswer({ dataset: "d", verdict: "keep", boxIds: [1, 2], seenRevisions: [0, 0], count: 2 });
  assert.deepEqual([...outbox.countByPerson()], [["ada", 3]]);
});

test("an answer can be renewed even if the storage has no room for more", () => {
  const outbox = createOutbox(storage, "t1", () => person);
  outbox.addAnswer({ boxId: 1, frameId: 10, verdict: "keep", comment: "", seenRevision: 0 });
  const [item] = outbox.items().filter(isSingle);
  if (item) outbox.markAttempted(item);
  const textAt = (/** @type {number} */ i) => storage.getItem(storage.key(i) ?? "") ?? "";
  const used = () => Array.from({ length: storage.length }, (_, i) => textAt(i)).join("").length;
  const most = used();
  const { setItem } = storage;
  storage.setItem = (name, value) => {
    if (used() - (storage.getItem(name) ?? "").length + value.length > most) throw new DOMException("it is full", "QuotaExceededError");
    setItem.call(storage, name, value);
  };

  const [attempted] = outbox.items().filter(isSingle);
  if (attempted) outbox.renew(attempted, 7);

  assert.deepEqual(outbox.items().map((one) => isSingle(one) && [one.seenRevision, one.attempted]), [[7, undefined]]);
});

test("of the answers of two tabs on a box, the one given last counts", (t) => {
  let clock = 1000;
  t.mock.method(Date, "now", () => ++clock);
  const given = { boxId: 1, frameId: 1, comment: "", seenRevision: 0 };
  const mine = createOutbox(storage, "t1", () => person);
  mine.addAnswer({ ...given, verdict: "keep" });
  createOutbox(storage, "t2", () => person).addAnswer({ ...given, verdict: "reject" });
  mine.addAnswer({ ...given, verdict: "unsure" });
  assert.equal(mine.lastAnswers().get(1)?.verdict, "unsure");
});
