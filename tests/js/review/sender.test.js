import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { ApiError, NoResponse } from "../../../static/js/core/api.js";
import { createOutbox, idempotencyKey } from "../../../static/js/review/outbox.js";
import { createSender } from "../../../static/js/review/sender.js";
import { decision, memoryStorage } from "../../support/page/builders.js";

/** @type {Storage} */
let storage;
/** Who is signed in. */
let person = "ada";
/** @type {import("../../../static/js/review/outbox.js").SingleAnswer[]} */
let sent;
/** Errors with which the server answers the next requests; without one it stores the answer. @type {Error[]} */
let refusals;
/** @type {any[]} */
let bulkAnswers;
/** @type {any[]} */
let undos;
/** @type {Map<number, number>} */
let revisions;
/** The boxes on which an answer repeats the latest one, so that it is not stored. @type {Set<number>} */
let repeats;
/** By box: the bulk answer of each revision that was stored through `requests`. @type {Map<number, {revision: number, batch: number | null}[]>} */
let stored;
/** @type {{run: () => void, ms: number}[]} */
let timers;
/** @type {any[]} */
let told;

beforeEach(() => {
  storage = memoryStorage();
  person = "ada";
  sent = [];
  bulkAnswers = [];
  undos = [];
  refusals = [];
  revisions = new Map();
  repeats = new Set();
  stored = new Map();
  timers = [];
  told = [];
});

/** Store an answer on a box, of this bulk answer. @param {number} boxId @param {number | null} batch */
function store(boxId, batch) {
  const revision = (revisions.get(boxId) ?? 0) + 1;
  revisions.set(boxId, revision);
  stored.set(boxId, [...(stored.get(boxId) ?? []), { revision, batch }]);
  return revision;
}

/** @param {string} [tab] */
function senderOf(tab = "t1") {
  const outbox = createOutbox(storage, tab, () => person);
  /** @type {any} */
  const requests = {
    answer: async (/** @type {any} */ item) => {
      sent.push(item);
      const refusal = refusals.shift();
      if (refusal) throw refusal;
      const { boxId, verdict, seenRevision } = item;
      const found = revisions.get(boxId) ?? 0;
      if (found !== seenRevision) {
        const review = { verdict: "keep", reviewer: found === 9 ? "bo" : "ada", revision: found, comment: "" };
        throw new ApiError(412, { current: decision({ box_id: boxId, revision: found, review }) }, null);
      }
      const revision = repeats.has(boxId) ? found : store(boxId, null);
      return { box_id: boxId, revision, verdict, reviewer: "ada", effective_verdict: "kept" };
    },
    undo: async (/** @type {any} */ item) => {
      sent.push(item);
      const refusal = refusals.shift();
      if (refusal) throw refusal;
      const { boxId, verdict } = item;
      return { box_id: boxId, revision: store(boxId, null), verdict, reviewer: "ada", effective_verdict: "kept" };
    },
    history: async (/** @type {number} */ boxId) => {
      const refusal = refusals.shift();
      if (refusal) throw refusal;
      const reviews = stored.get(boxId) ?? [];
      const revision = revisions.get(boxId) ?? 0; // set by the test: an answer that was not stored through `requests`
      const others = reviews.some((one) => one.revision === revision) ? [] : [{ revision, batch: null }];
      return { items: [{ kind: "decision" }, ...[...others, ...reviews].map((one) => ({ kind: "review", ...one }))] };
    },
    bulkAnswer: async (/** @type {any} */ bulk) => {
      bulkAnswers.push(bulk);
      const refusal = refusals.shift();
      if (refusal) throw refusal;
      if (bulk.filter) {
        for (const id of [1, 2]) store(id, 7);
        return { id: 7, count: 2, skipped: [], stale: [] };
      }
      const isStale = (/** @type {number} */ id, /** @type {number} */ i) => (revisions.get(id) ?? 0) !== bulk.seenRevisions[i];
      const stale = bulk.boxIds.filter(isStale);
      for (const id of bulk.boxIds) if (!stale.includes(id)) store(id, 7);
      return { id: 7, count: bulk.boxIds.length, skipped: [], stale };
    },
    bulkUndo: async (/** @type {any} */ undo) => {
      undos.push(undo);
      const refusal = refusals.shift();
      if (refusal) throw refusal;
      const boxIds = undo.boxIds ?? [1, 2];
      for (const id of boxIds) store(id, 8);
      return { id: 8, undone: boxIds.length, skipped: [] };
    },
  };
  const sender = createSender(outbox, requests, (run, ms) => void timers.push({ run, ms }));
  sender.observe({
    onStored: (stored) => told.push(["stored", stored.box_id, stored.revision]),
    onOvertaken: (item, current) => told.push(["overtaken", item.verdict, current?.review?.verdict]),
    onRefused: (item, error) => told.push(["refused", item.verdict, error.message]),
    onWithdrawn: (item) => told.push(["withdrawn", item.verdict]),
    onBulkStored: (_, { stale }) => told.push(["bulk stored", stale]),
    onBulkRefused: (_, error) => told.push(["bulk refused", error.message]),
    onBulkDiscarded: () => told.push(["bulk discarded"]),
    onUndoStored: (undo, { skipped }) => told.push(["undo stored", undo.batchId, skipped]),
    onUndoRefused: (undo, error) => told.push(["undo refused", undo.batchId, error.message]),
  });
  return { outbox, sender };
}

/**
 * Give an answer on a box, seen as nobody has answered it yet.
 * @param {any} sender @param {number} boxId @param {any} verdict
 */
const answer = (sender, boxId, verdict) => sender.addAnswer({ boxId, frameId: 10, verdict, comment: "", seenRevision: 0 });

const settled = () => new Promise((resolve) => setImmediate(resolve));
const verdicts = () => sent.map((item) => [item.boxId, item.verdict, item.seenRevision]);

test("an answer is sent at once, with the revision that the person has seen", async () => {
  const { sender, outbox } = senderOf();
  answer(sender, 1, "keep");
  assert.equal(sender.state.get().phase, "saving");
  await settled();
  assert.deepEqual(verdicts(), [[1, "keep", 0]]);
  assert.deepEqual(told, [["stored", 1, 1]]);
  assert.deepEqual([sender.state.get().phase, outbox.items()], ["saved", []]);
});

test("without a network, answers wait, survive a reload, and are sent in order", async () => {
  refusals = [new NoResponse("gone"), new NoResponse("gone")];
  const { sender } = senderOf();
  answer(sender, 1, "keep");
  await settled();
  answer(sender, 2, "reject");
  await settled();
  assert.deepEqual([sender.state.get().phase, sender.state.get().waiting.size], ["offline", 2]);

  const reloaded = senderOf().sender;
  sent = [];
  await reloaded.resume();

  assert.deepEqual(verdicts(), [[1, "keep", 0], [2, "reject", 0]]);
  assert.equal(reloaded.state.get().phase, "saved");
});

test("an answer whose response was lost is sent again unchanged, with the same key", async () => {
  refusals = [new NoResponse("lost on the way back")];
  const { sender } = senderOf();
  answer(sender, 1, "keep");
  await settled();
  answer(sender, 1, "reject");
  await settled();
  assert.deepEqual(verdicts(), [[1, "keep", 0], [1, "keep", 0], [1, "reject", 1]]);
  assert.equal(sent[0]?.key, sent[1]?.key);
  assert.notEqual(sent[1]?.key, sent[2]?.key);
});

test("a refused bulk answer leaves the outbox, is not sent again, and is no longer shown on its boxes", async () => {
  refusals = [new ApiError(413, { detail: "too many" }, null)];
  const { sender, outbox } = senderOf();
  answerMany(sender, "reject", [1, 2], [0, 0]);
  await settled();
  await sender.resume();

  assert.equal(bulkAnswers.length, 1);
  const { phase, count, bulkItems } = sender.state.get();
  assert.deepEqual([phase, count, bulkItems.map(({ state, text }) => [state, text])], ["saved", 0, [["refused", "too many"]]]);
  assert.deepEqual([outbox.lastAnswers().size, storage.length], [0, 0]);
  assert.deepEqual(told, [["bulk refused", "too many"]]);
});

test("if somebody else clears an answer after an own bulk answer on a filter, that is reported, not overwritten", async () => {
  const { sender } = senderOf();
  sender.addBulkAnswer({ dataset: "d", verdict: "reject", filter: { class: "car" }, snapshot: "s", count: 2 });
  await settled();
  revisions.set(1, 2);
  refusals = [new ApiError(412, { current: decision({ revision: 2, review: null }) }, null)];
  sender.addAnswer({ boxId: 1, frameId: 10, verdict: "keep", comment: "", seenRevision: 1 });
  await settled();

  assert.deepEqual(told, [["bulk stored", []], ["overtaken", "keep", undefined]]);
});

test("an answer whose response was lost is sent again unchanged, before an older one of a closed tab", async () => {
  const closed = createOutbox(storage, "closed", () => person);
  closed.addAnswer({ boxId: 1, frameId: 10, verdict: "keep", comment: "", seenRevision: 0 });
  refusals = [new NoResponse("lost on the way there")];
  const { sender } = senderOf();
  answer(sender, 1, "reject");
  await settled();

  sender.takeOver(new Set());
  await sender.resume();

  assert.deepEqual(verdicts(), [[1, "reject", 0], [1, "reject", 0], [1, "keep", 0]]);
  assert.equal(sent[0]?.key, sent[1]?.key);
  assert.deepEqual(told, [["stored", 1, 1], ["overtaken", "keep", "keep"]]);
});

test("another person's answer that was hidden by an own unsent one is reported, not overwritten", async () => {
  refusals = [new NoResponse("away")];
  const { sender } = senderOf();
  answerMany(sender, "reject", [1, 2], [0, 0]);
  await settled();
  revisions.set(1, 9); // another person's answer, which the page has loaded, but not shown
  sender.addAnswer({ boxId: 1, frameId: 10, verdict: "keep", comment: "", seenRevision: 9 });

  await settled();

  assert.deepEqual(told, [["bulk stored", [1]], ["overtaken", "keep", "keep"]]);
});

test("several answers on a box that wait are sent in their order, each with the revision after the one before", async () => {
  refusals = [new ApiError(401, {}, null)];
  const { sender, outbox } = senderOf();
  answer(sender, 7, "keep");
  await settled();
  for (const verdict of ["keep", "reject", "unsure"]) answer(sender, 1, verdict);
  assert.equal(sender.state.get().count, 2, "boxes");
  assert.equal(outbox.lastAnswers().get(1)?.verdict, "unsure");

  await sender.resume();

  assert.deepEqual(verdicts().slice(2), [[1, "keep", 0], [1, "reject", 1], [1, "unsure", 2]]);
});

test("of several answers on a box that wait, those that are undone are never sent", async () => {
  refusals = [new ApiError(401, {}, null)];
  const { sender, outbox } = senderOf();
  answer(sender, 7, "keep");
  await settled();
  answer(sender, 1, "keep");
  const last = answer(sender, 1, "reject");
  sender.undoAnswer(last, before("keep"));
  assert.equal(outbox.lastAnswers().get(1)?.verdict, "keep");

  await sender.resume();

  assert.deepEqual(verdicts().slice(2), [[1, "keep", 0]]);
});

test("the pause between attempts grows, and any success resets it", async () => {
  refusals = [new NoResponse(""), new NoResponse(""), new NoResponse("")];
  const { sender } = senderOf();
  answer(sender, 1, "keep");
  for (let i = 0; i < 4; i++) {
    await settled();
    timers.at(-1)?.run();
  }
  await settled();
  assert.deepEqual(timers.map((timer) => timer.ms), [1000, 2000, 4000]);
  assert.equal(sender.state.get().phase, "saved");
});

test("a new answer does not make the page ask a busy server before the time that it named", async () => {
  refusals = [new ApiError(503, {}, 7)];
  const { sender } = senderOf();
  answer(sender, 1, "keep");
  await settled();
  answer(sender, 2, "keep");
  await settled();
  assert.equal(sent.length, 1);
  timers[0]?.run();
  await settled();
  assert.deepEqual(verdicts(), [[1, "keep", 0], [1, "keep", 0], [2, "keep", 0]]);
  const [first, second] = sent.map(idempotencyKey);
  assert.equal(first, second);
});

test("an answer that the server gave up receiving (408) is sent again", async () => {
  refusals = [new ApiError(408, { code: "request_timeout" }, null)];
  const { sender } = senderOf();
  answer(sender, 1, "keep");
  await settled();
  timers[0]?.run();
  await settled();
  assert.deepEqual(told, [["stored", 1, 1]]);
});

test("a resume during a request that succeeds does not shorten the wait of a later one", async () => {
  const { sender } = senderOf();
  answer(sender, 1, "keep");
  void sender.resume();
  await settled();
  refusals = [new ApiError(503, {}, 7)];
  answer(sender, 2, "keep");
  await settled();
  assert.equal(timers.at(-1)?.ms, 7000);
});

test("when signed out, answers are kept, and nothing is sent until somebody signs in", async () => {
  refusals = [new ApiError(401, {}, null)];
  const { sender } = senderOf();
  answer(sender, 1, "keep");
  await settled();
  answer(sender, 2, "keep");
  await settled();
  assert.deepEqual([sent.length, sender.state.get().phase, timers.length], [1, "signed-out", 0]);
  await sender.resume();
  assert.deepEqual(verdicts().slice(1), [[1, "keep", 0], [2, "keep", 0]]);
});

test("after an unexpected error in the page, the answer is sent again", async () => {
  const { sender, outbox } = senderOf();
  outbox.addAnswer({ boxId: 1, frameId: 10, verdict: "keep", comment: "", seenRevision: 0 });
  refusals = [new RangeError("a fault of the page")];

  await assert.rejects(sender.resume(), RangeError);
  assert.equal(sender.state.get().phase, "busy");
  timers.at(-1)?.run();
  await settled();

  assert.deepEqual([sender.state.get().phase, outbox.items()], ["saved", []]);
});

test("an overtaken answer is reported with the other person's answer, is not repeated, and does not stop other answers", async () => {
  const theirs = decision({ review: { verdict: "reject", reviewer: "bo", revision: 3 } });
  refusals = [new ApiError(412, { current: theirs }, null)];
  const { sender } = senderOf();
  answer(sender, 1, "keep");
  answer(sender, 2, "keep");
  await settled();
  assert.deepEqual(told, [["overtaken", "keep", "reject"], ["stored", 2, 1]]);
  assert.equal(sender.state.get().phase, "saved");
});

test("an answer that the server will never accept is reported and dropped", async () => {
  refusals = [new ApiError(403, { detail: "viewers cannot review" }, null)];
  const { sender, outbox } = senderOf();
  answer(sender, 1, "keep");
  await settled();
  assert.deepEqual(told, [["refused", "keep", "viewers cannot review"]]);
  assert.deepEqual(outbox.items(), []);
});

test("an answer is sent only while the person who gave it is signed in", async () => {
  refusals = [new ApiError(401, {}, null)];
  const { sender, outbox } = senderOf();
  answer(sender, 1, "keep");
  await settled();

  person = "bo";
  await sender.resume();
  assert.deepEqual([sent.length, outbox.items()], [1, []]);
  answer(sender, 2, "reject");
  await settled();
  assert.deepEqual(sent.map(({ boxId }) => boxId), [1, 2]);
  assert.deepEqual([...outbox.countByPerson()], [["ada", 1]]);

  person = "ada";
  await sender.resume();
  assert.deepEqual(sent.map(({ boxId }) => boxId), [1, 2, 1]);
});

test("a resume during a failing attempt makes the next attempt follow at once", async () => {
  const { sender } = senderOf();
  refusals = [new NoResponse(new Error("down")), new NoResponse(new Error("down")), new NoResponse(new Error("down"))];
  answer(sender, 1, "keep");
  void sender.resume();
  await settled();

  assert.equal(timers.at(-1)?.ms, 0);
  timers.at(-1)?.run();
  await settled();
  assert.equal(timers.at(-1)?.ms, 2000);
});

/** @param {any} sender @param {any} verdict @param {number[]} boxIds @param {number[]} seenRevisions */
const answerMany = (sender, verdict, boxIds, seenRevisions) =>
  sender.addBulkAnswer({ dataset: "d", verdict, boxIds, seenRevisions, count: boxIds.length });

test("without a network, an answer that follows a bulk answer is sent after it", async () => {
  refusals = [new NoResponse("away"), new NoResponse("away")];
  const { sender } = senderOf();
  answerMany(sender, "reject", [1, 2], [0, 0]);
  await settled();
  answer(sender, 1, "keep");
  await settled();

  await sender.resume();

  assert.deepEqual(told, [["bulk stored", []], ["stored", 1, 2]]);
  assert.deepEqual([sender.state.get().phase, sender.state.get().bulkItems], ["saved", []]);
});

test("without a network, a bulk answer is sent after the answers that were given before it", async () => {
  refusals = [new NoResponse("away"), new NoResponse("away")];
  const { sender } = senderOf();
  answer(sender, 1, "keep");
  await settled();
  answerMany(sender, "reject", [1, 2], [0, 0]);
  await settled();
  assert.deepEqual([sender.state.get().count, sender.state.get().bulkItems.map(({ state }) => state)], [3, ["waiting"]]);

  await sender.resume();

  assert.deepEqual(told, [["stored", 1, 1], ["bulk stored", []]]);
});

test("after an overtaken answer, later own answers on the box overwrite nothing either", async () => {
  refusals = [new NoResponse("away"), new NoResponse("away")];
  const { sender } = senderOf();
  answer(sender, 1, "keep");
  await settled();
  answerMany(sender, "unsure", [1, 2], [0, 0]);
  answer(sender, 1, "reject");
  await settled();
  revisions.set(1, 1); // another person's answer

  await sender.resume();

  assert.deepEqual(told.map((event) => event.slice(0, 2)), [["overtaken", "keep"], ["bulk stored", [1]], ["overtaken", "reject"]]);
  assert.equal(revisions.get(1), 1);
});

test("an answer after an own bulk answer on a filter is not overtaken by that bulk answer", async () => {
  refusals = [new NoResponse("away"), new NoResponse("away")];
  const { sender } = senderOf();
  sender.addBulkAnswer({ dataset: "d", verdict: "reject", filter: { class: "car" }, snapshot: "s", count: 2 });
  await settled();
  answer(sender, 1, "keep");
  answer(sender, 3, "keep");
  await settled();
  revisions.set(3, 9); // another person's answer

  await sender.resume();

  assert.deepEqual(told.map((event) => event.slice(0, 3)), [["bulk stored", []], ["stored", 1, 2], ["overtaken", "keep", "keep"]]);
});

test("an answer is overtaken if the page of the box's history does not reach back to what the person saw", async () => {
  const { sender } = senderOf();
  revisions.set(1, 1); // the answer of this revision is on a later page
  sender.addBulkAnswer({ dataset: "d", verdict: "reject", filter: { class: "car" }, snapshot: "s", count: 2 });
  await settled();

  sender.addAnswer({ boxId: 1, frameId: 10, verdict: "keep", comment: "", seenRevision: 0 });
  await settled();

  assert.deepEqual(told.at(-1)?.slice(0, 2), ["overtaken", "keep"]);
});

for (const [who, reviewer] of [["somebody else", "bo"], ["this person in another window", "ada"]]) {
  test(`an answer of ${who} is not taken for a part of an own bulk answer on a filter, or of its undo`, async () => {
    const { sender } = senderOf();
    const filter = { class: "walker" }; // boxes 1 and 2
    sender.addBulkAnswer({ dataset: "d", verdict: "keep", filter, snapshot: "s", count: 2 }, "k0");
    await settled();
    sender.addBulkUndo({ bulkKey: "k0", batchId: 7, dataset: "d", before: [], count: 2 });
    await settled();
    revisions.set(3, 4);
    const review = reviewer === "bo" ? null : { verdict: "keep", reviewer, revision: 4, comment: "" };
    refusals = [new ApiError(412, { current: decision({ box_id: 3, revision: 4, review }) }, null)];

    sender.addAnswer({ boxId: 3, frameId: 10, verdict: "reject", comment: "", seenRevision: 3 });
    await settled();

    assert.deepEqual(verdicts(), [[3, "reject", 3]]);
    assert.deepEqual(told.at(-1)?.slice(0, 2), ["overtaken", "reject"]);
  });
}

test("an answer waits if it cannot be found out whether an own bulk answer has overtaken it", async () => {
  const { sender, outbox } = senderOf();
  const filter = { class: "car" };
  sender.addBulkAnswer({ dataset: "d", verdict: "reject", filter, snapshot: "s", count: 2 });
  await settled();
  const current = decision({ box_id: 1, revision: 1 });
  refusals = [new ApiError(412, { current }, null), new NoResponse("away")];
  answer(sender, 1, "keep");
  await settled();
  assert.deepEqual([sender.state.get().phase, outbox.items().length], ["offline", 1]);

  await sender.resume();

  assert.deepEqual(verdicts(), [[1, "keep", 0], [1, "keep", 0], [1, "keep", 1]]);
  assert.deepEqual(told.at(-1), ["stored", 1, 2]);
});

for (const status of [404, 500]) {
  test(`after a ${status} to the question whether an own bulk answer has overtaken it, the person chooses`, async () => {
    const { sender } = senderOf();
    const filter = { class: "car" };
    sender.addBulkAnswer({ dataset: "d", verdict: "reject", filter, snapshot: "s", count: 2 });
    await settled();
    const current = decision({ box_id: 1, revision: 1 });
    refusals = [new ApiError(412, { current }, null), new ApiError(status, {}, null)];
    answer(sender, 1, "keep");
    answer(sender, 3, "keep");
    await settled();

    assert.deepEqual(told.slice(1).map((event) => event.slice(0, 2)), [["overtaken", "keep"], ["stored", 3]]);
    assert.equal(sender.state.get().phase, "saved");
  });
}

for (const status of [502, 503]) {
  test(`after a ${status} to that question the answer waits, and is then sent under a new key`, async () => {
    const { sender } = senderOf();
    sender.addBulkAnswer({ dataset: "d", verdict: "reject", filter: { class: "car" }, snapshot: "s", count: 2 });
    await settled();
    const current = decision({ box_id: 1, revision: 1 });
    refusals = [new ApiError(412, { current }, null), new ApiError(status, {}, null)];
    answer(sender, 1, "keep");
    await settled();
    assert.equal(sender.state.get().phase, "busy");

    await sender.resume();

    assert.deepEqual(told.slice(1), [["stored", 1, 2]]);
    const keys = sent.map(idempotencyKey);
    assert.deepEqual([keys[0] === keys[1], keys[1] === keys[2]], [true, false]);
  });
}

/** What box 1 gets again after an undo. @param {any} verdict */
const before = (verdict, seenRevision = 0) => ({ boxId: 1, frameId: 10, verdict, comment: "", seenRevision });
/** What was sent on box 1, the last of an undo being the revision that it undoes. */
const sentOnBox = () => sent.map((item) => [item.verdict, item.seenRevision, item.undoes ?? null]);

test("an answer that is undone while it is being sent is stored and then undone by its revision", async () => {
  const { sender, outbox } = senderOf();
  refusals = [new NoResponse("offline")];
  const given = answer(sender, 1, "keep");
  await settled();
  sender.undoAnswer(given, before("clear"));
  assert.deepEqual([...outbox.lastAnswers()], [[1, { verdict: "clear", comment: "" }]], "shown at once");
  await settled();
  assert.deepEqual([sentOnBox(), outbox.items()], [[["keep", 0, null], ["keep", 0, null], ["clear", 1, 1]], []]);
  assert.deepEqual(told, [["stored", 1, 1], ["stored", 1, 2]]);
});

test("an answer that follows an undo is sent with the revision after the undo", async () => {
  const { sender } = senderOf();
  refusals = [new NoResponse("offline")];
  const given = answer(sender, 1, "keep");
  await settled();
  refusals = [new NoResponse("offline")];
  sender.undoAnswer(given, before("clear"));
  await settled();
  answer(sender, 1, "unsure");
  await settled();

  assert.deepEqual(sentOnBox().slice(-3), [["keep", 0, null], ["clear", 1, 1], ["unsure", 2, null]]);
  assert.deepEqual(told, [["stored", 1, 1], ["stored", 1, 2], ["stored", 1, 3]]);
});

test("an answer that is undone while it is being sent, and then changes nothing, has no undo", async () => {
  const { sender, outbox } = senderOf();
  revisions.set(1, 3);
  repeats.add(1); // the box has this answer already
  const given = sender.addAnswer({ boxId: 1, frameId: 10, verdict: "keep", comment: "", seenRevision: 3 });
  assert.ok(given);

  assert.equal(sender.undoAnswer(given, { boxId: 1, frameId: 10, verdict: "keep", comment: "", seenRevision: 3 }), true);
  await settled();

  assert.deepEqual([sent.map(({ undoes }) => undoes), outbox.items()], [[undefined], []]);
});

test("an answer that is undone while it is being sent, and then refused, is dropped with its undo", async () => {
  const { sender, outbox } = senderOf();
  refusals = [new NoResponse("offline")];
  const given = answer(sender, 1, "keep");
  await settled();
  revisions.set(1, 9); // somebody else has answered
  sender.undoAnswer(given, before("clear"));
  await settled();
  assert.deepEqual([told, outbox.items()], [[["withdrawn", "keep"]], []]);
});

test("an answer that is undone while the page looks up what has overtaken it is not sent again", async () => {
  const { sender, outbox } = senderOf();
  sender.addBulkAnswer({ dataset: "d", verdict: "reject", filter: {}, snapshot: "s", count: 2 });
  await settled();
  const given = answer(sender, 1, "keep"); // with the revision before the bulk answer
  sender.undoAnswer(given, before("clear"));
  await settled();

  assert.deepEqual([told.slice(1), outbox.items()], [[["withdrawn", "keep"]], []]);
  assert.equal(sent.length, 1);
});

test("the undo of a stored answer is retried with the same key, and reported if it is refused", async () => {
  const { sender, outbox } = senderOf();
  const given = answer(sender, 1, "keep");
  await settled();
  refusals = [new NoResponse("offline"), new ApiError(409, { code: "not_in_force", detail: "others followed" }, null)];

  sender.undoAnswer({ ...given, revision: 1 }, before("clear", 1));
  await settled();
  await sender.resume();

  assert.deepEqual(sentOnBox().slice(1), [["clear", 1, 1], ["clear", 1, 1]]);
  assert.equal(sent[1]?.key, sent[2]?.key);
  assert.deepEqual([told.at(-1), outbox.items()], [["refused", "clear", "others followed"], []]);
});

/** Undos that are not stored yet: the bulk answer's key, the state, and the reason to wait. @param {any} sender */
const openOf = (sender) => sender.state.get().bulkItems.map((/** @type {any} */ { item, state, text }) => [item.bulkKey, state, text]);

/**
 * Undo a bulk answer that rejected boxes 1 and 2, which had no answer before.
 * @param {any} sender @param {string} bulkKey @param {{batchId?: number | null, seenRevisions?: number[]}} [some]
 */
function undoBulkAnswer(sender, bulkKey, { batchId = null, seenRevisions = [0, 0] } = {}) {
  const before = [1, 2].map(() => ({ verdict: "clear", comment: "" }));
  sender.addBulkUndo({ bulkKey, batchId, dataset: "d", boxIds: [1, 2], seenRevisions, before, count: 2 });
}

test("undoing a bulk answer is sent after earlier answers, and later answers are sent with its revision as seen", async () => {
  revisions = new Map([[1, 1], [2, 1]]);
  refusals = [new ApiError(503, {}, 7)];
  const { sender, outbox } = senderOf();
  answer(sender, 3, "keep");
  await settled();
  undoBulkAnswer(sender, "k0", { batchId: 7, seenRevisions: [1, 1] });
  sender.addAnswer({ boxId: 1, frameId: 10, verdict: "keep", comment: "", seenRevision: 1 });
  assert.deepEqual(Object.fromEntries(outbox.lastAnswers()), { 1: { verdict: "keep", comment: "" }, 2: { verdict: "clear", comment: "" }, 3: { verdict: "keep", comment: "" } });

  await sender.resume();
  await settled();

  assert.deepEqual(told, [["stored", 3, 1], ["undo stored", 7, []], ["stored", 1, 3]]);
  assert.equal(storage.length, 0);
});

test("without a network, undoing a bulk answer waits, survives a reload, and is sent", async () => {
  revisions = new Map([[1, 1], [2, 1]]);
  refusals = [new NoResponse("away")];
  const { sender } = senderOf();
  undoBulkAnswer(sender, "k0", { batchId: 7, seenRevisions: [1, 1] });
  await settled();
  assert.deepEqual(openOf(sender), [["k0", "waiting", "the server does not answer"]]);

  const next = senderOf().sender;
  next.takeOver(new Set());
  assert.deepEqual(openOf(next), [["k0", "waiting", "it was not sent before the page was closed"]]);
  await next.resume();
  assert.deepEqual(openOf(next), []);

  assert.deepEqual(undos.map(({ batchId }) => batchId), [7, 7]);
  assert.deepEqual([told, storage.length], [[["undo stored", 7, []]], 0]);
});

test("undoing a bulk answer that was never sent discards it", async () => {
  refusals = [new ApiError(401, {}, null)];
  const { sender, outbox } = senderOf();
  answer(sender, 3, "keep");
  await settled();
  sender.addBulkAnswer({ dataset: "d", verdict: "reject", boxIds: [1, 2], seenRevisions: [0, 0], count: 2 }, "k1");
  undoBulkAnswer(sender, "k1");

  assert.deepEqual([outbox.items().map(({ boxId }) => boxId), told], [[3], [["bulk discarded"]]]);
});

test("undoing a bulk answer whose response was lost waits until the bulk answer is stored", async () => {
  refusals = [new NoResponse("away")];
  const { sender, outbox } = senderOf();
  sender.addBulkAnswer({ dataset: "d", verdict: "reject", boxIds: [1, 2], seenRevisions: [0, 0], count: 2 }, "k1");
  await settled();
  undoBulkAnswer(sender, "k1");
  assert.deepEqual([...outbox.lastAnswers()].map(([id, { verdict }]) => [id, verdict]), [[1, "clear"], [2, "clear"]]);

  await sender.resume();
  await settled();

  assert.deepEqual(told, [["bulk stored", []], ["undo stored", 7, []]]);
  assert.deepEqual([undos[0].seenRevisions, [...revisions]], [[1, 1], [[1, 2], [2, 2]]]);
});

test("undoing a bulk answer leaves out the boxes that the server left out of the bulk answer", async () => {
  refusals = [new NoResponse("away")];
  const { sender } = senderOf();
  sender.addBulkAnswer({ dataset: "d", verdict: "reject", boxIds: [1, 2], seenRevisions: [0, 0], count: 2 }, "k1");
  await settled();
  revisions.set(1, 9); // another person's answer
  undoBulkAnswer(sender, "k1");

  await sender.resume();
  await settled();

  assert.deepEqual(undos.map(({ boxIds, seenRevisions, before }) => [boxIds, seenRevisions, before.length]), [[[2], [1], 1]]);
});

test("a bulk answer that was undone before the server refused it is dropped with its undo", async () => {
  refusals = [new NoResponse("away"), new ApiError(413, { detail: "too many" }, null)];
  const { sender } = senderOf();
  sender.addBulkAnswer({ dataset: "d", verdict: "reject", boxIds: [1, 2], seenRevisions: [0, 0], count: 2 }, "k1");
  await settled();
  undoBulkAnswer(sender, "k1");
  answer(sender, 1, "keep");

  await sender.resume();
  await settled();

  assert.deepEqual(told, [["bulk discarded"], ["stored", 1, 1]]);
  assert.deepEqual([undos, storage.length, sender.state.get().bulkItems], [[], 0, []]);
});

test("a refused undo is reported, and does not stop later answers", async () => {
  revisions = new Map([[1, 1], [2, 1]]);
  refusals = [new ApiError(409, { code: "already_undone", detail: "was undone already" }, null)];
  const { sender } = senderOf();
  undoBulkAnswer(sender, "k0", { batchId: 7, seenRevisions: [1, 1] });
  sender.addAnswer({ boxId: 1, frameId: 10, verdict: "keep", comment: "", seenRevision: 1 });
  await settled();

  assert.deepEqual(told, [["undo refused", 7, "was undone already"], ["stored", 1, 2]]);
});

test("an answer after undoing an own bulk answer on a filter is not overtaken by that undo", async () => {
  revisions = new Map([[1, 1], [2, 1]]);
  refusals = [new NoResponse("away")];
  const { sender } = senderOf();
  sender.addBulkUndo({ bulkKey: "k0", batchId: 7, dataset: "d", before: [], count: 2 });
  sender.addAnswer({ boxId: 1, frameId: 10, verdict: "keep", comment: "", seenRevision: 1 });
  await settled();

  await sender.resume();
  await settled();

  assert.deepEqual(told, [["undo stored", 7, []], ["stored", 1, 3]]);
});

test("discarding a refused bulk answer keeps answers that were given on its boxes since", async () => {
  refusals = [new ApiError(413, { detail: "too many" }, null)];
  const { sender } = senderOf();
  answerMany(sender, "reject", [1, 2], [0, 0]);
  answer(sender, 1, "keep");
  await settled();
  refusals = [new NoResponse("away")];
  sender.addAnswer({ boxId: 1, frameId: 10, verdict: "unsure", comment: "", seenRevision: 1 });
  await settled();

  sender.discard(sender.state.get().bulkItems[0]?.item.key ?? "");
  await sender.resume();

  assert.deepEqual(told.slice(1), [["stored", 1, 1], ["bulk discarded"], ["stored", 1, 2]]);
});

test("a bulk answer whose response was lost is sent again with the same key", async () => {
  const { sender } = senderOf();
  refusals = [new NoResponse("away")];
  answerMany(sender, "reject", [1, 2], [0, 0]);
  assert.deepEqual([...sender.state.get().waitingInBulk], [1, 2]);
  await settled();
  assert.deepEqual(sender.state.get().bulkItems.map(({ state }) => state), ["waiting"]);

  await sender.resume();

  assert.equal(bulkAnswers[0].key, bulkAnswers[1].key);
  assert.deepEqual([told, sender.state.get().bulkItems, storage.length], [[["bulk stored", []]], [], 0]);
});

test("a bulk answer on a filter that selects other boxes by now waits until the person decides", async () => {
  const { sender } = senderOf();
  refusals = [new ApiError(412, { code: "stale_snapshot", detail: "selects 4" }, null)];
  sender.addBulkAnswer({ dataset: "d", verdict: "keep", filter: { class: "car" }, snapshot: "s", count: 3 });
  await settled();
  assert.deepEqual(sender.state.get().bulkItems.map(({ state, text }) => [state, text]), [["changed", "selects 4"]]);

  await sender.resume();

  assert.equal(bulkAnswers.length, 1);
});
