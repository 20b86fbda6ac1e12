import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { ApiError, NoResponse } from "../../../static/js/core/api.js";
import { countUnowned, createOutbox, createSender, discardUnowned, own } from "../../../static/js/review/outbox.js";
import { decision, memoryStorage } from "../../support/page/builders.js";

/** @typedef {{boxId: number, verdict: string, comment: string, seen_revision: number, key: string}} Sent */

/** @type {Storage} */
let storage;
/** Who is signed in. */
let person = "ada";
/** @type {Sent[]} */
let sent;
/** What the server says next; nothing: it stores. @type {Error[]} */
let refusals;
/** @type {any[]} */
let bulkAnswers;
/** @type {any[]} */
let undos;
/** @type {Map<number, number>} */
let revisions;
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
  timers = [];
  told = [];
});

/** @param {string} [tab] */
function saverOf(tab = "t1") {
  const outbox = createOutbox(storage, tab, () => person);
  /** @type {any} */
  const send = async (/** @type {number} */ boxId, /** @type {any} */ answer, /** @type {string} */ key) => {
    sent.push({ boxId, ...answer, key });
    const refusal = refusals.shift();
    if (refusal) throw refusal;
    const found = revisions.get(boxId) ?? 0;
    if (found !== answer.seen_revision) throw new ApiError(412, { current: decision({ box_id: boxId, revision: found, review: { verdict: "keep", reviewer: found === 9 ? "bo" : "ada", revision: found, comment: "" } }) }, null);
    const revision = found + 1;
    revisions.set(boxId, revision);
    return { box_id: boxId, revision, verdict: answer.verdict, reviewer: "ada", effective_verdict: "kept" };
  };
  const events = {
    onStored: (/** @type {any} */ stored) => told.push(["stored", stored.box_id, stored.revision]),
    onConflict: (/** @type {any} */ item, /** @type {any} */ current) => told.push(["conflict", item.verdict, current?.review?.verdict]),
    onRefused: (/** @type {any} */ item, /** @type {Error} */ error) => told.push(["refused", item.verdict, error.message]),
  };
  const answerMany = async (/** @type {any} */ bulk) => {
    bulkAnswers.push(bulk);
    const refusal = refusals.shift();
    if (refusal) throw refusal;
    if (bulk.filter) {
      for (const id of [1, 2]) revisions.set(id, (revisions.get(id) ?? 0) + 1);
      return { id: 7, count: 2, skipped: [], stale: [] };
    }
    const stale = bulk.boxIds.filter((/** @type {number} */ id, /** @type {number} */ i) => (revisions.get(id) ?? 0) !== bulk.seen[i]);
    for (const id of bulk.boxIds) if (!stale.includes(id)) revisions.set(id, (revisions.get(id) ?? 0) + 1);
    return { id: 7, count: bulk.boxIds.length, skipped: [], stale };
  };
  const undo = async (/** @type {any} */ item) => {
    undos.push(item);
    const refusal = refusals.shift();
    if (refusal) throw refusal;
    const boxIds = item.boxIds ?? [1, 2];
    for (const id of boxIds) revisions.set(id, (revisions.get(id) ?? 0) + 1);
    return { id: 8, undone: boxIds.length, skipped: [] };
  };
  const ofBulkAnswers = {
    onDone: (/** @type {any} */ done) => told.push(["done", done.stale]),
    onUndone: (/** @type {any} */ item, /** @type {any} */ out) => told.push(["undone", item.batch, out.skipped]),
    onUndoRefused: (/** @type {any} */ item, /** @type {Error} */ error) => told.push(["undo refused", item.batch, error.message]),
    onSignedOut: () => {},
    onGivenUp: () => told.push(["given up"]),
  };
  return { outbox, saver: createSender(outbox, { answer: send, answerMany, undo }, { ...events, ...ofBulkAnswers }, (run, ms) => void timers.push({ run, ms })) };
}

/** An answer that has seen what the server last said of the box: nothing yet. @param {any} saver @param {number} boxId @param {any} verdict */
const answer = (saver, boxId, verdict) => saver.answer({ boxId, frameId: 10, verdict, comment: "", seenRevision: 0 });

const settled = () => new Promise((resolve) => setImmediate(resolve));
const verdicts = () => sent.map((item) => [item.boxId, item.verdict, item.seen_revision]);

test("an answer is sent at once, with what was seen", async () => {
  const { saver, outbox } = saverOf();
  answer(saver, 1, "keep");
  assert.equal(saver.state.get().phase, "saving");
  await settled();
  assert.deepEqual(verdicts(), [[1, "keep", 0]]);
  assert.deepEqual(told, [["stored", 1, 1]]);
  assert.deepEqual([saver.state.get().phase, outbox.items()], ["saved", []]);
});

test("a second answer waits for the first and has seen its revision", async () => {
  const { saver } = saverOf();
  answer(saver, 1, "keep");
  answer(saver, 1, "reject");
  await settled();
  assert.deepEqual(verdicts(), [[1, "keep", 0], [1, "reject", 1]]);
  assert.deepEqual(told, [["stored", 1, 1], ["stored", 1, 2]]);
});

test("without a network answers wait, survive a reload, and are sent in order", async () => {
  refusals = [new NoResponse("gone"), new NoResponse("gone")];
  const { saver } = saverOf();
  answer(saver, 1, "keep");
  await settled();
  answer(saver, 2, "reject");
  await settled();
  assert.deepEqual([saver.state.get().phase, saver.state.get().waiting.size], ["offline", 2]);

  const reloaded = saverOf().saver;
  sent = [];
  await reloaded.resume();

  assert.deepEqual(verdicts(), [[1, "keep", 0], [2, "reject", 0]]);
  assert.equal(reloaded.state.get().phase, "saved");
});

test("an answer that may have arrived is repeated word for word, under the same key", async () => {
  refusals = [new NoResponse("lost on the way back")];
  const { saver } = saverOf();
  answer(saver, 1, "keep");
  await settled();
  answer(saver, 1, "reject");
  await settled();
  assert.deepEqual(verdicts(), [[1, "keep", 0], [1, "keep", 0], [1, "reject", 1]]);
  assert.equal(sent[0]?.key, sent[1]?.key);
  assert.notEqual(sent[1]?.key, sent[2]?.key);
});

test("an answer that may have arrived stays word for word when an earlier bulk answer is stored after all", async () => {
  refusals = [new ApiError(409, { code: "stale_snapshot" }, null), new NoResponse("lost on the way there")];
  const { saver } = saverOf();
  answerMany(saver, "reject", [1], [0]);
  await settled();
  answer(saver, 1, "keep");
  await settled();
  await saver.retry(bulkAnswers[0].key);
  assert.deepEqual(verdicts(), [[1, "keep", 0], [1, "keep", 0], [1, "keep", 1]]);
  assert.equal(sent[0]?.key, sent[1]?.key);
  assert.notEqual(sent[1]?.key, sent[2]?.key);
  assert.deepEqual(told, [["done", []], ["stored", 1, 2]]);
});

test("a bulk answer that may have arrived stays word for word when an earlier one is stored after all", async () => {
  refusals = [new ApiError(409, { code: "stale_snapshot" }, null), new NoResponse("lost on the way there")];
  const { saver } = saverOf();
  answerMany(saver, "reject", [1], [0]);
  await settled();
  answerMany(saver, "keep", [1, 2], [0, 0]);
  await settled();
  await saver.retry(bulkAnswers[0].key);
  assert.deepEqual(bulkAnswers.map(({ verdict, seen }) => [verdict, seen]), [["reject", [0]], ["keep", [0, 0]], ["reject", [0]], ["keep", [0, 0]]]);
  assert.deepEqual(told, [["done", []], ["done", [1]]]);
});

test("answers that were never sent are replaced by the latest on that box", async () => {
  refusals = [new ApiError(401, {}, null)];
  const { saver, outbox } = saverOf();
  answer(saver, 7, "keep");
  await settled();
  for (const verdict of ["keep", "reject", "unsure"]) answer(saver, 1, verdict);
  assert.deepEqual(outbox.items().map((item) => [item.boxId, item.verdict]), [[7, "keep"], [1, "unsure"]]);
});

test("the pause between attempts grows, and any success resets it", async () => {
  refusals = [new NoResponse(""), new NoResponse(""), new NoResponse("")];
  const { saver } = saverOf();
  answer(saver, 1, "keep");
  for (let i = 0; i < 4; i++) {
    await settled();
    timers.at(-1)?.run();
  }
  await settled();
  assert.deepEqual(timers.map((timer) => timer.ms), [1000, 2000, 4000]);
  assert.equal(saver.state.get().phase, "saved");
});

test("a busy server is asked again when it says", async () => {
  refusals = [new ApiError(503, {}, 7)];
  const { saver } = saverOf();
  answer(saver, 1, "keep");
  await settled();
  assert.deepEqual([timers[0]?.ms, saver.state.get().phase], [7000, "busy"]);
});

test("signed out, answers are kept and nothing is tried until somebody signs in", async () => {
  refusals = [new ApiError(401, {}, null)];
  const { saver } = saverOf();
  answer(saver, 1, "keep");
  await settled();
  answer(saver, 2, "keep");
  await settled();
  assert.deepEqual([sent.length, saver.state.get().phase, timers.length], [1, "signed-out", 0]);
  await saver.resume();
  assert.deepEqual(verdicts().slice(1), [[1, "keep", 0], [2, "keep", 0]]);
});

test("an error that nobody knows ends nothing: the answer is sent again", async () => {
  const { saver, outbox } = saverOf();
  outbox.add({ boxId: 1, frameId: 10, verdict: "keep", comment: "", seenRevision: 0 });
  refusals = [new RangeError("a fault of the page")];

  await assert.rejects(saver.resume(), RangeError);
  assert.equal(saver.state.get().phase, "busy");
  timers.at(-1)?.run();
  await settled();

  assert.deepEqual([saver.state.get().phase, outbox.items()], ["saved", []]);
});

test("a conflict is told with the other's answer, is not repeated, and does not stop the rest", async () => {
  const theirs = decision({ review: { verdict: "reject", reviewer: "bo", revision: 3 } });
  refusals = [new ApiError(412, { current: theirs }, null)];
  const { saver } = saverOf();
  answer(saver, 1, "keep");
  answer(saver, 2, "keep");
  await settled();
  assert.deepEqual(told, [["conflict", "keep", "reject"], ["stored", 2, 1]]);
  assert.equal(saver.state.get().phase, "saved");
});

test("what the server will never take is told and let go", async () => {
  refusals = [new ApiError(403, { detail: "viewers cannot review" }, null)];
  const { saver, outbox } = saverOf();
  answer(saver, 1, "keep");
  await settled();
  assert.deepEqual(told, [["refused", "keep", "viewers cannot review"]]);
  assert.deepEqual(outbox.items(), []);
});

test("a tab leaves the answers of another open tab alone and adopts those of a closed one", () => {
  const mine = createOutbox(storage, "t1", () => person);
  const given = { frameId: 1, verdict: /** @type {const} */ ("keep"), comment: "", seenRevision: 0 };
  createOutbox(storage, "open", () => person).add({ boxId: 1, ...given });
  createOutbox(storage, "closed", () => person).add({ boxId: 2, ...given });
  mine.adopt(new Set(["t1", "open"]));
  assert.deepEqual(mine.items().map((item) => item.boxId), [2]);
});

test("an answer goes out under the name of who gave it, and under no other", async () => {
  refusals = [new ApiError(401, {}, null)];
  const { saver, outbox } = saverOf();
  answer(saver, 1, "keep");
  await settled();

  person = "bo";
  await saver.resume();
  assert.deepEqual([sent.length, outbox.items()], [1, []]);
  answer(saver, 2, "reject");
  await settled();
  assert.deepEqual(sent.map(({ boxId }) => boxId), [1, 2]);
  assert.deepEqual([...outbox.kept()], [["ada", 1]]);

  person = "ada";
  await saver.resume();
  assert.deepEqual(sent.map(({ boxId }) => boxId), [1, 2, 1]);
});

test("rubbish in the storage is not an answer", () => {
  storage.setItem("unghost.outbox.v1.x", "{");
  storage.setItem("unghost.outbox.v1.y", "{}");
  assert.deepEqual(createOutbox(storage, "t1", () => person).items(), []);
});

test("a network that comes back while an attempt is still failing is not waited for", async () => {
  const { saver } = saverOf();
  refusals = [new NoResponse(new Error("down")), new NoResponse(new Error("down")), new NoResponse(new Error("down"))];
  answer(saver, 1, "keep");
  void saver.resume();
  await settled();

  assert.equal(timers.at(-1)?.ms, 0);
  timers.at(-1)?.run();
  await settled();
  assert.equal(timers.at(-1)?.ms, 2000);
});

/** @param {any} saver @param {any} verdict @param {number[]} boxIds @param {number[]} seen */
const answerMany = (saver, verdict, boxIds, seen) => saver.start({ dataset: "d", verdict, boxIds, seen, count: boxIds.length });

test("away from the server, an answer after a bulk answer is sent after it", async () => {
  refusals = [new NoResponse("away"), new NoResponse("away")];
  const { saver } = saverOf();
  answerMany(saver, "reject", [1, 2], [0, 0]);
  await settled();
  answer(saver, 1, "keep");
  await settled();

  await saver.resume();

  assert.deepEqual(told, [["done", []], ["stored", 1, 2]]);
  assert.deepEqual([saver.state.get().phase, saver.open.get()], ["saved", []]);
});

test("away from the server, a bulk answer is sent after the answers before it", async () => {
  refusals = [new NoResponse("away"), new NoResponse("away")];
  const { saver } = saverOf();
  answer(saver, 1, "keep");
  await settled();
  answerMany(saver, "reject", [1, 2], [0, 0]);
  await settled();
  assert.deepEqual([saver.state.get().count, saver.open.get().map(({ state }) => state)], [3, ["waiting"]]);

  await saver.resume();

  assert.deepEqual(told, [["stored", 1, 1], ["done", []]]);
});

test("what an earlier version of the page has kept is sent and forgotten, its bulk answers, which had no order, first", async () => {
  const kept = { person: "ada", tab: "closed", verdict: "keep" };
  const old = {
    "unghost.outbox.v1.k1": { ...kept, key: "k1", order: 1, boxId: 3, frameId: 10, comment: "", seenRevision: 0, attempted: true },
    "unghost.bulk.v1.k2": { ...kept, key: "k2", dataset: "d", boxIds: [1, 2], seen: [0, 0], count: 2 },
  };
  for (const [name, item] of Object.entries(old)) storage.setItem(name, JSON.stringify(item));
  const { saver } = saverOf();

  saver.adopt(new Set(["t1"]));
  await saver.resume();
  await settled();

  assert.deepEqual(bulkAnswers.map(({ key, boxIds, seen }) => [key, boxIds, seen]), [["k2", [1, 2], [0, 0]]]);
  assert.deepEqual(sent.map(({ key, boxId, verdict, seen_revision }) => [key, boxId, verdict, seen_revision]), [["k1", 3, "keep", 0]]);
  assert.deepEqual(told, [["done", []], ["stored", 3, 1]]);
  assert.equal(storage.length, 0);
});

test("an answer is not replaced by one that was given after a bulk answer on the box", async () => {
  refusals = [new ApiError(401, {}, null)];
  const { saver, outbox } = saverOf();
  answer(saver, 7, "keep");
  await settled();
  answer(saver, 1, "keep");
  answerMany(saver, "reject", [1], [0]);
  answer(saver, 1, "unsure");

  assert.deepEqual(outbox.items().map(({ verdict }) => verdict), ["keep", "keep", "reject", "unsure"]);
  await saver.resume();
  assert.deepEqual([...revisions], [[7, 1], [1, 3]]);
});

test("what rests on an answer that somebody was faster than overwrites nothing", async () => {
  refusals = [new NoResponse("away"), new NoResponse("away")];
  const { saver } = saverOf();
  answer(saver, 1, "keep");
  await settled();
  answerMany(saver, "unsure", [1, 2], [0, 0]);
  answer(saver, 1, "reject");
  await settled();
  revisions.set(1, 1); // another person's

  await saver.resume();

  assert.deepEqual(told.map((event) => event.slice(0, 2)), [["conflict", "keep"], ["done", [1]], ["conflict", "reject"]]);
  assert.equal(revisions.get(1), 1);
});

test("a bulk answer that is given up takes nothing with it that was answered later", async () => {
  refusals = [new ApiError(413, { detail: "too many" }, null)];
  const { saver } = saverOf();
  answerMany(saver, "reject", [1, 2], [0, 0]);
  answer(saver, 1, "keep");
  await settled();

  assert.deepEqual(told, [["stored", 1, 1]]);
  assert.deepEqual(saver.open.get().map(({ state }) => state), ["refused"]);
  saver.giveUp(saver.open.get()[0]?.item.key ?? "");
  assert.deepEqual(saver.open.get(), []);
});

test("an answer after one's own bulk answer on a filter meets nobody else", async () => {
  refusals = [new NoResponse("away"), new NoResponse("away")];
  const { saver } = saverOf();
  saver.start({ dataset: "d", verdict: "reject", filter: { class: "car" }, snapshot: "s", count: 2 });
  await settled();
  answer(saver, 1, "keep");
  answer(saver, 3, "keep");
  await settled();
  revisions.set(3, 9); // another person's

  await saver.resume();

  assert.deepEqual(told.map((event) => event.slice(0, 3)), [["done", []], ["stored", 1, 2], ["conflict", "keep", "keep"]]);
});

test("what was said of each box last is known, whatever it was said with", () => {
  const outbox = createOutbox(storage, "t1", () => person);
  outbox.add({ boxId: 1, frameId: 10, verdict: "keep", comment: "seen twice", seenRevision: 0 });
  outbox.addBulkAnswer({ dataset: "d", verdict: "reject", boxIds: [2, 3], seen: [0, 0], count: 2 });
  outbox.add({ boxId: 3, frameId: 10, verdict: "unsure", comment: "", seenRevision: 0 });

  assert.deepEqual(Object.fromEntries(outbox.given()), {
    1: { verdict: "keep", comment: "seen twice" },
    2: { verdict: "reject", comment: "" },
    3: { verdict: "unsure", comment: "" },
  });
});

/** The undos that are not stored: of which bulk answers, and why they wait. @param {any} saver */
const openOf = (saver) => saver.open.get().map((/** @type {any} */ { item, state, text }) => [item.act, state, text]);

/** The undo of a bulk answer that rejected boxes 1 and 2, which had no answer. @param {any} saver @param {string} act  its key @param {{batch?: number | null, seen?: number[]}} [some] */
const undoBulkAnswer = (saver, act, { batch = null, seen = [0, 0] } = {}) =>
  saver.undo({ act, batch, dataset: "d", boxIds: [1, 2], seen, before: [1, 2].map(() => ({ verdict: "clear", comment: "" })), count: 2 });

test("the undo of a bulk answer is sent after the answers before it, and answers after it have seen it", async () => {
  revisions = new Map([[1, 1], [2, 1]]);
  refusals = [new ApiError(503, {}, 7)];
  const { saver, outbox } = saverOf();
  answer(saver, 3, "keep");
  await settled();
  undoBulkAnswer(saver, "k0", { batch: 7, seen: [1, 1] });
  saver.answer({ boxId: 1, frameId: 10, verdict: "keep", comment: "", seenRevision: 1 });
  assert.deepEqual(Object.fromEntries(outbox.given()), { 1: { verdict: "keep", comment: "" }, 2: { verdict: "clear", comment: "" }, 3: { verdict: "keep", comment: "" } });

  await saver.resume();
  await settled();

  assert.deepEqual(told, [["stored", 3, 1], ["undone", 7, []], ["stored", 1, 3]]);
  assert.equal(storage.length, 0);
});

test("without a network the undo of a bulk answer waits, survives a reload, and is sent", async () => {
  revisions = new Map([[1, 1], [2, 1]]);
  refusals = [new NoResponse("away")];
  const { saver } = saverOf();
  undoBulkAnswer(saver, "k0", { batch: 7, seen: [1, 1] });
  await settled();
  assert.deepEqual(openOf(saver), [["k0", "waiting", "the server does not answer"]]);

  const next = saverOf().saver;
  next.adopt(new Set());
  assert.deepEqual(openOf(next), [["k0", "waiting", "it was not sent before the page was closed"]]);
  await next.retry(next.open.get()[0]?.item.key ?? "");
  assert.deepEqual(openOf(next), []);

  assert.deepEqual(undos.map(({ batch }) => batch), [7, 7]);
  assert.deepEqual([told, storage.length], [[["undone", 7, []]], 0]);
});

test("undoing a bulk answer that was not sent discards it", async () => {
  refusals = [new ApiError(401, {}, null)];
  const { saver, outbox } = saverOf();
  answer(saver, 3, "keep");
  await settled();
  saver.start({ dataset: "d", verdict: "reject", boxIds: [1, 2], seen: [0, 0], count: 2 }, "k1");
  undoBulkAnswer(saver, "k1");

  assert.deepEqual([outbox.items().map(({ boxId }) => boxId), told], [[3], [["given up"]]]);
});

test("the undo of a bulk answer that may have arrived waits until the bulk answer is stored", async () => {
  refusals = [new NoResponse("away")];
  const { saver, outbox } = saverOf();
  saver.start({ dataset: "d", verdict: "reject", boxIds: [1, 2], seen: [0, 0], count: 2 }, "k1");
  await settled();
  undoBulkAnswer(saver, "k1");
  assert.deepEqual([...outbox.given()].map(([id, { verdict }]) => [id, verdict]), [[1, "clear"], [2, "clear"]]);

  await saver.resume();
  await settled();

  assert.deepEqual(told, [["done", []], ["undone", 7, []]]);
  assert.deepEqual([undos[0].seen, [...revisions]], [[1, 1], [[1, 2], [2, 2]]]);
});

test("the undo of a bulk answer leaves out what the bulk answer has left out", async () => {
  refusals = [new NoResponse("away")];
  const { saver } = saverOf();
  saver.start({ dataset: "d", verdict: "reject", boxIds: [1, 2], seen: [0, 0], count: 2 }, "k1");
  await settled();
  revisions.set(1, 9); // another person's
  undoBulkAnswer(saver, "k1");

  await saver.resume();
  await settled();

  assert.deepEqual(undos.map(({ boxIds, seen, before }) => [boxIds, seen, before.length]), [[[2], [1], 1]]);
});

test("a bulk answer that is refused is forgotten together with its undo", async () => {
  refusals = [new NoResponse("away"), new ApiError(413, { detail: "too many" }, null)];
  const { saver } = saverOf();
  saver.start({ dataset: "d", verdict: "reject", boxIds: [1, 2], seen: [0, 0], count: 2 }, "k1");
  await settled();
  undoBulkAnswer(saver, "k1");
  answer(saver, 1, "keep");

  await saver.resume();
  await settled();

  assert.deepEqual(told, [["given up"], ["stored", 1, 1]]);
  assert.deepEqual([undos, storage.length, saver.open.get()], [[], 0, []]);
});

test("an undo that is refused is told, and stops nothing", async () => {
  revisions = new Map([[1, 1], [2, 1]]);
  refusals = [new ApiError(409, { code: "already_undone", detail: "was undone already" }, null)];
  const { saver } = saverOf();
  undoBulkAnswer(saver, "k0", { batch: 7, seen: [1, 1] });
  saver.answer({ boxId: 1, frameId: 10, verdict: "keep", comment: "", seenRevision: 1 });
  await settled();

  assert.deepEqual(told, [["undo refused", 7, "was undone already"], ["stored", 1, 2]]);
});

test("an answer after the undo of one's bulk answer on a filter meets nobody else", async () => {
  revisions = new Map([[1, 1], [2, 1]]);
  refusals = [new NoResponse("away")];
  const { saver } = saverOf();
  saver.undo({ act: "k0", batch: 7, dataset: "d", before: [], count: 2 });
  saver.answer({ boxId: 1, frameId: 10, verdict: "keep", comment: "", seenRevision: 1 });
  await settled();

  await saver.resume();
  await settled();

  assert.deepEqual(told, [["undone", 7, []], ["stored", 1, 3]]);
});

test("discarding a refused bulk answer leaves alone what was answered on its boxes since", async () => {
  refusals = [new ApiError(413, { detail: "too many" }, null)];
  const { saver } = saverOf();
  answerMany(saver, "reject", [1, 2], [0, 0]);
  answer(saver, 1, "keep");
  await settled();
  refusals = [new NoResponse("away")];
  saver.answer({ boxId: 1, frameId: 10, verdict: "unsure", comment: "", seenRevision: 1 });
  await settled();

  saver.giveUp(saver.open.get()[0]?.item.key ?? "");
  await saver.resume();

  assert.deepEqual(told, [["stored", 1, 1], ["given up"], ["stored", 1, 2]]);
});

/** A server that answers as it is told. */
function actsWith(answers, storage = memoryStorage(), tab = "t1", person = "ada") {
  const sent = [];
  const events = [];
  let key = 0;
  const calls = {
    answer: async () => assert.fail("no answer on one box was given"),
    answerMany: async (/** @type {any} */ bulk) => {
      sent.push(bulk);
      const answer = answers.shift() ?? { id: 7, count: bulk.count, skipped: [], stale: [] };
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
    onGivenUp: (bulk) => events.push(["given up", bulk.key]),
    onActFailed: () => {},
    onSignedOut: () => {},
  }, () => {});
  return { sender, sent, events, storage };
}

const MANY = { dataset: "d", verdict: /** @type {const} */ ("reject"), boxIds: [1, 2, 3], count: 3 };
const tick = () => new Promise((done) => setTimeout(done));

test("a bulk answer is sent once and forgotten when it is stored", async () => {
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
  test(`a bulk answer that cannot be sent (${name}) waits, and goes again with the same key`, async () => {
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

test("a bulk answer survives its page, and goes on in the next one or in another tab", async () => {
  const { sender, storage } = actsWith([new NoResponse(null)]);
  sender.start(MANY);
  await tick();

  const same = actsWith([], storage);
  same.sender.adopt(new Set(["t1"]));
  assert.deepEqual(same.sender.open.get().map(({ item }) => item.key), ["k1"]);
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

test("a bulk answer is sent under the name of who did it, and under no other", async () => {
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

test("a bulk answer whose boxes have changed waits until the person decides", async () => {
  const { sender, sent } = actsWith([new ApiError(412, { code: "stale_snapshot", detail: "selects 4" }, null)]);
  sender.start({ dataset: "d", verdict: "keep", filter: { class: "car" }, snapshot: "s", count: 3 });
  await tick();
  assert.deepEqual(sender.open.get().map(({ state, text }) => [state, text]), [["changed", "selects 4"]]);

  sender.resume();
  await tick();

  assert.equal(sent.length, 1);
});

test("boxes that somebody answered meanwhile are reported", async () => {
  const { sender, events } = actsWith([{ id: 7, count: 2, skipped: [], stale: [2] }]);

  sender.start({ ...MANY, seen: [0, 0, 0] });
  await tick();

  assert.deepEqual(events, [["done", 7, [], [2]]]);
});

test("a refused bulk answer is shown until it is discarded", async () => {
  const { sender, events, storage } = actsWith([new ApiError(413, { detail: "too many" }, null)]);
  sender.start(MANY);
  await tick();
  assert.deepEqual(sender.open.get().map(({ state, text }) => [state, text]), [["refused", "too many"]]);

  sender.giveUp("k1");

  assert.deepEqual(events, [["given up", "k1"]]);
  assert.equal(storage.length, 0);
});

/** What an earlier version of the page has kept, which did not say who answered, beside a bulk answer of bo. */
function keptUnowned() {
  storage.setItem("unghost.outbox.v1.a", JSON.stringify({ key: "a", boxId: 1 }));
  storage.setItem("unghost.bulk.v1.b", JSON.stringify({ key: "b", count: 3 }));
  storage.setItem("unghost.bulk.v1.c", JSON.stringify({ key: "c", count: 5, person: "bo" }));
  storage.setItem("unghost.prefs", JSON.stringify({}));
}

/** Who gave what is kept, by key. */
const owners = () => Object.fromEntries(["outbox.v1.a", "bulk.v1.b", "bulk.v1.c"].map((name) => [name.at(-1), JSON.parse(storage.getItem(`unghost.${name}`) ?? "{}").person]));

test("answers that do not say who gave them wait until a person takes them", () => {
  keptUnowned();
  assert.equal(countUnowned(storage), 4);

  own(storage, "ada");

  assert.deepEqual([countUnowned(storage), owners()], [0, { a: "ada", b: "ada", c: "bo" }]);
});

test("of the answers kept here only those are discarded that do not say who gave them", () => {
  keptUnowned();

  discardUnowned(storage);

  assert.deepEqual([countUnowned(storage), storage.length, owners().c], [0, 2, "bo"]);
});

test("an answer for which there is no room takes no earlier one away", () => {
  const outbox = createOutbox(storage, "t1", () => person);
  const given = { boxId: 1, frameId: 10, verdict: /** @type {const} */ ("keep"), seenRevision: 0 };
  outbox.add({ ...given, comment: "" });
  const { setItem } = storage;
  storage.setItem = (name, value) => {
    if (value.length > 300) throw new DOMException("it is full", "QuotaExceededError");
    setItem.call(storage, name, value);
  };

  assert.throws(() => outbox.add({ ...given, comment: "x".repeat(1000) }), { name: "QuotaExceededError" });

  assert.deepEqual(outbox.items().map((item) => "comment" in item && item.comment), [""]);
});
