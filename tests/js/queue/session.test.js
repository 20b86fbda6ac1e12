import assert from "node:assert/strict";
import { test } from "node:test";

import { createValue } from "../../../static/js/core/observable.js";
import { currentOf, skippedBoxes, stepped } from "../../../static/js/queue/line.js";
import { sessionOf } from "../../../static/js/queue/session.js";

/**
 * A session of a queue whose server has these many boxes without an answer, and serves those with the answer unsure last.
 * @param {number} count
 */
function queueOf(count) {
  /** @type {Map<number, string | null>} */
  const answers = new Map(Array.from({ length: count }, (_, i) => [i + 1, null]));
  globalThis.fetch = async (_, init) => {
    const { exclude, limit } = JSON.parse(String(init?.body));
    assert.ok(exclude.length <= 1000);
    const withAnswer = (/** @type {string | null} */ wanted) => [...answers].flatMap(([id, answer]) => (answer === wanted ? [id] : []));
    const open = [...withAnswer(null), ...withAnswer("unsure")].filter((id) => !exclude.includes(id));
    const items = open.slice(0, limit).map((id) => ({ box_id: id, frame_id: 1, revision: 0, review: null }));
    return Response.json({ items, remaining: withAnswer(null).length, unsure: withAnswer("unsure").length, claimed_by_others: 0 });
  };
  const boxes = new Map();
  const app = /** @type {any} */ ({
    prefs: createValue({ lessons: true }),
    sender: { state: createValue({ waiting: new Map(), waitingInBulk: new Set() }) },
    boxes: {
      receive: (/** @type {any[]} */ items) => items.map((box) => (boxes.set(box.box_id, box), box.box_id)),
      hold: () => () => {},
      get: (/** @type {number} */ id) => boxes.get(id),
      loadAgain: async () => {},
    },
    answer: (/** @type {number} */ id, /** @type {string} */ verdict) => (answers.set(id, verdict), true),
  });
  const dataset = `town-${count}-${Math.random()}`;
  const returned = (/** @type {number | undefined} */ run) => sessionOf(app, dataset, {}, run);
  return { session: returned(undefined).session, boxes, returned };
}

/**
 * Go through the queue to its end.
 * @param {Pick<ReturnType<typeof queueOf>, "session" | "boxes">} queue @param {(seen: number) => "keep" | "unsure" | null} what  null: skip the box
 * @returns {Promise<number>} how many boxes were shown
 */
async function goThrough({ session, boxes }, what) {
  await session.refill();
  for (let seen = 0; ; seen++) {
    for (let i = 0; i < 4; i++) await new Promise((done) => setImmediate(done));
    const id = currentOf(session.line.get());
    if (id === null) return seen;
    const verdict = what(seen);
    if (verdict === null) session.show(stepped(session.line.get(), 1));
    else session.answer(boxes.get(id), verdict, "", false);
  }
}

test("boxes that were skipped at first do not hide those after the thousandth", async () => {
  const queue = queueOf(1100);

  assert.equal(await goThrough(queue, (seen) => (seen < 12 ? null : "keep")), 1100);
  assert.equal(queue.session.supply.get().isEnd, true);
});

test("the queue ends after more than a thousand boxes, also if the first one was answered with unsure", async () => {
  const queue = queueOf(1100);

  assert.equal(await goThrough(queue, (seen) => (seen === 0 ? "unsure" : "keep")), 1100);
  assert.equal(queue.session.supply.get().isEnd, true);
});

test("the session goes on as long as no other run has become active", () => {
  const { session, returned } = queueOf(5);

  assert.deepEqual(returned(3), { session, isChecked: true });
  assert.deepEqual(returned(undefined), { session, isChecked: false });
  assert.deepEqual(returned(3), { session, isChecked: true });
});

test("after another run, boxes are loaded anew, and what was answered or skipped is remembered", async () => {
  const { session, boxes, returned } = queueOf(20);
  await session.refill();
  returned(3);
  session.answer(boxes.get(1), "keep", "", false);
  session.show(stepped(session.line.get(), 1));
  session.answer(boxes.get(3), "unsure", "", false);

  const { session: next, isChecked } = returned(4);

  assert.ok(isChecked);
  assert.notEqual(next, session);
  assert.deepEqual(next.line.get().ids, [1, 2, 3]);
  assert.equal(currentOf(next.line.get()), null);
  assert.deepEqual([...next.tally.get().verdicts], [[1, "keep"], [3, "unsure"]]);
  await next.refill();
  assert.equal(currentOf(next.line.get()), 4);
  assert.deepEqual(skippedBoxes(next.line.get()), [2]);
});
