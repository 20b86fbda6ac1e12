// @ts-check
// What bulk acts mean to the rest of the page: boxes change at once, a message offers to take
// it back, and whatever was left out is listed.

import { sendBulk, undoBulk } from "./calls/boxes.js";
import { createBulk } from "./bulk.js";
import { ApiError, api } from "./api.js";
import { seenRevision, withAnswer } from "./reviews.js";
import { createValue } from "./store.js";
import { countOf } from "./wording.js";

/** @typedef {import("./bulk.js").Act} Act */
/** @typedef {import("./types.js").Answer} Answer */
/** @typedef {import("./types.js").Decision} Decision */
/** @typedef {{text: string, boxes: readonly number[]}} Report  boxes that an act or an undo left alone */

/** Why an undo is refused for good. */
const NEVER_UNDONE = new Set(["already_undone", "others_answers"]);
/** Of more boxes than these, the lists are read again instead. */
const MOST_LOOKS = 20;

/** @type {Record<Answer, string>} */
const DONE = { keep: "kept", reject: "rejected", unsure: "flagged as unsure", clear: "without an answer again" };

/**
 * @param {{storage: Storage, tab: string, openTabs: ReadonlySet<string>, who: () => string, stores: import("./open_stores.js").OpenStores,
 *   frames: import("./frames.js").Frames, toasts: import("./toasts.js").Toasts, undo: import("./undo.js").Undo,
 *   notice: (error: unknown) => void}} page
 */
export function createBulkActs({ storage, tab, openTabs, who, stores, frames, toasts, undo, notice }) {
  /** Boxes as they were before an act that this page has begun. @type {Map<string, readonly Decision[]>} */
  const before = new Map();
  /** Of a batch that was stored: its act, and the message that offers to undo it. @type {Map<number, {key: string, toast: number}>} */
  const stored = new Map();
  const report = createValue(/** @type {Report | null} */ (null));
  /** Counts what has changed on the server by acts on a whole filter: lists are read again. */
  const sweeps = createValue(0);

  /** Boxes as they were before an act. @param {string} key @param {{but?: ReadonlySet<number>, isUndo?: boolean}} [how]  an undo is an answer more */
  function putBack(key, { but = new Set(), isUndo = false } = {}) {
    for (const box of before.get(key) ?? []) {
      if (!but.has(box.box_id)) stores.tell(box.box_id, (now) => (isUndo ? { ...box, revision: seenRevision(now) + 1 } : box));
    }
  }

  /** Whatever boxes were left out, and why. @param {number[]} skipped @param {number[]} stale @returns {Report | null} */
  function leftOut(skipped, stale) {
    const why = [];
    if (stale.length) why.push(`${countOf(stale.length, "box was", "boxes were")} left out: somebody has answered since.`);
    if (skipped.length) why.push(`${countOf(skipped.length, "box was", "boxes were")} left out: deleted or replaced meanwhile.`);
    return why.length ? { text: why.join(" "), boxes: [...stale, ...skipped] } : null;
  }

  /** Others have answered these boxes: shown as they are now. @param {readonly number[]} boxIds */
  async function lookAgain(boxIds) {
    if (boxIds.length > MOST_LOOKS) return sweeps.set(sweeps.get() + 1);
    for (const id of boxIds) {
      const box = await api.box(id).catch(notice);
      if (box) stores.tell(id, () => box);
    }
  }

  /** @param {number} batchId */
  async function takeBack(batchId) {
    if (await bulk.undo(batchId)) undo.forgetBatch(batchId);
  }

  const bulk = createBulk(storage, tab, who, { send: sendBulk, undo: undoBulk }, {
    onDone({ batchId, act, skipped, stale }) {
      undo.noticeBatch(batchId);
      frames.forgetAll();
      if (act.filter) sweeps.set(sweeps.get() + 1);
      before.set(act.key, (before.get(act.key) ?? []).filter((box) => !stale.includes(box.box_id)));
      void lookAgain(stale);
      const toast = toasts.show(`${countOf(act.count - skipped.length - stale.length, "box", "boxes")} ${DONE[act.verdict]}`, {
        action: { text: "Undo", run: () => void takeBack(batchId) },
      });
      stored.set(batchId, { key: act.key, toast });
      report.set(leftOut(skipped, stale));
    },
    onGivenUp: (act) => putBack(act.key),
    onUndone(batchId, { undone, skipped }) {
      const { key = "", toast = 0 } = stored.get(batchId) ?? {};
      toasts.dismiss(toast);
      putBack(key, { but: new Set(skipped), isUndo: true });
      frames.forgetAll();
      if (!before.get(key)?.length) sweeps.set(sweeps.get() + 1);
      toasts.show(`${countOf(undone, "answer")} taken back`);
      report.set(skipped.length ? { text: `${countOf(skipped.length, "answer was", "answers were")} left as ${skipped.length === 1 ? "it is" : "they are"}: somebody has answered since.`, boxes: skipped } : null);
    },
    onError(error, batchId) {
      notice(error);
      if (!batchId || !(error instanceof ApiError) || !NEVER_UNDONE.has(error.problem.code ?? "")) return;
      undo.forgetBatch(batchId);
      toasts.show(error.message, { kind: "error" });
    },
  });
  bulk.adopt(openTabs);

  return {
    ...bulk,

    /** Send what waits: the network is back, or somebody has signed in. */
    resume() {
      bulk.adopt(openTabs);
      bulk.resume();
    },

    report,
    sweeps,

    /** One answer on these boxes, shown at once. @param {string} dataset @param {Answer} verdict @param {readonly number[]} boxIds @param {ReadonlyMap<number, number>} revisions  as the person saw them */
    answer(dataset, verdict, boxIds, revisions) {
      const boxes = boxIds.flatMap((id) => stores.find(id) ?? []);
      const key = crypto.randomUUID();
      before.set(key, boxes);
      for (const box of boxes) stores.tell(box.box_id, () => ({ ...withAnswer(box, verdict), revision: seenRevision(box) + 1 }));
      bulk.start({ dataset, verdict, boxIds: [...boxIds], seen: boxIds.map((id) => revisions.get(id) ?? 0), count: boxIds.length }, key);
    },

    /** One answer on all that a filter selected when the list was read. @param {string} dataset @param {Answer} verdict @param {import("./bulk.js").Filter} filter @param {{total: number, snapshot: string}} list */
    answerAll: (dataset, verdict, filter, { total, snapshot }) => bulk.start({ dataset, verdict, filter, snapshot, count: total }),

    /** Take back the last act, a bulk one. @param {number} batchId */
    async undo(batchId) {
      await takeBack(batchId).catch(() => {});
      if (undo.peek()?.batchId === batchId) toasts.show("Not taken back: the server could not be asked.", { kind: "error" });
    },
  };
}

/** @typedef {ReturnType<typeof createBulkActs>} BulkActs */
