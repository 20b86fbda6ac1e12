// @ts-check
// What bulk acts mean to the rest of the page: boxes change at once, a message offers to take
// it back, and whatever was left out is listed.

import { sendBulk, undoBulk } from "./calls/boxes.js";
import { createBulk } from "./bulk.js";
import { ApiError } from "./api.js";
import { seenRevision, withAnswer } from "./reviews.js";
import { createValue } from "./store.js";
import { countOf } from "./wording.js";

/** @typedef {import("./bulk.js").Act} Act */
/** @typedef {import("./types.js").Answer} Answer */
/** @typedef {import("./types.js").Decision} Decision */
/** @typedef {{text: string, boxes: readonly number[]}} Report  boxes that an act or an undo left alone */

/** @type {Record<Answer, string>} */
const DONE = { keep: "kept", reject: "rejected", unsure: "flagged as unsure", clear: "without an answer again" };

/**
 * @param {{storage: Storage, tab: string, openTabs: ReadonlySet<string>, stores: import("./open_stores.js").OpenStores,
 *   frames: import("./frames.js").Frames, toasts: import("./toasts.js").Toasts, undo: import("./undo.js").Undo,
 *   notice: (error: unknown) => void}} page
 */
export function createBulkActs({ storage, tab, openTabs, stores, frames, toasts, undo, notice }) {
  /** Boxes as they were before an act that this page has begun. @type {Map<string, readonly Decision[]>} */
  const before = new Map();
  /** Of a batch that was stored: its act, and the message that offers to undo it. @type {Map<number, {key: string, toast: number}>} */
  const stored = new Map();
  const report = createValue(/** @type {Report | null} */ (null));
  /** Counts what has changed on the server by acts on a whole filter: lists are read again. */
  const sweeps = createValue(0);

  /** @param {string} key @param {ReadonlySet<number>} [but] */
  function putBack(key, but = new Set()) {
    for (const box of before.get(key) ?? []) {
      if (!but.has(box.box_id)) stores.tell(box.box_id, (now) => ({ ...box, revision: seenRevision(now) + 1 }));
    }
  }

  /** @param {number} batchId */
  async function takeBack(batchId) {
    if (await bulk.undo(batchId)) undo.forgetBatch(batchId);
  }

  const bulk = createBulk(storage, tab, { send: sendBulk, undo: undoBulk }, {
    onDone({ batchId, act, skipped }) {
      undo.noticeBatch(batchId);
      frames.forgetAll();
      if (act.filter) sweeps.set(sweeps.get() + 1);
      const toast = toasts.show(`${countOf(act.count - skipped.length, "box", "boxes")} ${DONE[act.verdict]}`, {
        action: { text: "Undo", run: () => void takeBack(batchId) },
      });
      stored.set(batchId, { key: act.key, toast });
      report.set(skipped.length ? { text: `${countOf(skipped.length, "box was", "boxes were")} left out: deleted or replaced meanwhile.`, boxes: skipped } : null);
    },
    onGivenUp: (act) => putBack(act.key),
    onUndone(batchId, { undone, skipped }) {
      const { key = "", toast = 0 } = stored.get(batchId) ?? {};
      toasts.dismiss(toast);
      putBack(key, new Set(skipped));
      frames.forgetAll();
      if (!before.get(key)?.length) sweeps.set(sweeps.get() + 1);
      toasts.show(`${countOf(undone, "answer")} taken back`);
      report.set(skipped.length ? { text: `${countOf(skipped.length, "answer was", "answers were")} left as ${skipped.length === 1 ? "it is" : "they are"}: somebody has answered since.`, boxes: skipped } : null);
    },
    onError(error) {
      notice(error);
      if (error instanceof ApiError && error.problem.code === "already_undone") toasts.show(error.message, { kind: "error" });
    },
  });
  bulk.adopt(openTabs);

  return {
    ...bulk,
    report,
    sweeps,

    /** One answer on these boxes, shown at once. @param {string} dataset @param {Answer} verdict @param {readonly number[]} boxIds */
    answer(dataset, verdict, boxIds) {
      const boxes = boxIds.flatMap((id) => stores.find(id) ?? []);
      const key = crypto.randomUUID();
      before.set(key, boxes);
      for (const box of boxes) stores.tell(box.box_id, () => ({ ...withAnswer(box, verdict), revision: seenRevision(box) + 1 }));
      bulk.start({ dataset, verdict, boxIds: [...boxIds], count: boxIds.length }, key);
    },

    /** One answer on all that a filter selects. @param {string} dataset @param {Answer} verdict @param {import("./bulk.js").Filter} filter @param {number} count */
    answerAll: (dataset, verdict, filter, count) => bulk.start({ dataset, verdict, filter, count }),

    /** Take back the last act, a bulk one. @param {number} batchId */
    async undo(batchId) {
      await takeBack(batchId).catch(() => {});
      if (undo.peek()?.batchId === batchId) toasts.show("Not taken back: the server could not be asked.", { kind: "error" });
    },
  };
}

/** @typedef {ReturnType<typeof createBulkActs>} BulkActs */
