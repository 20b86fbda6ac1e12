// @ts-check
// The only one who changes what people said: answer one, answer many, undo, insist, give up.

import { seenRevision, withAnswer, withStored } from "../boxes/box.js";
import { LOCAL, createFrames, createOpenStores } from "../boxes/store.js";
import { ApiError, api } from "../core/api.js";
import { countOf } from "../core/numbers.js";
import { createValue } from "../core/observable.js";
import { createOutbox, createSender, nameThisTab, own, sendBulk, undoBulk, unowned } from "./outbox.js";

/** @typedef {import("../core/types.js").Answer} Answer */
/** @typedef {import("../boxes/store.js").Change} Change */
/** @typedef {import("../core/types.js").Decision} Decision */
/** @typedef {import("./outbox.js").QueuedAnswer} QueuedAnswer */
/** @typedef {{text: string, boxes: readonly number[]}} Report  boxes that an act or an undo left alone */

/** Why an undo is refused for good. */
const NEVER_UNDONE = new Set(["already_undone", "others_answers"]);

/** Of more boxes than these, the lists are read again instead. */
const MOST_LOOKS = 20;

/** @type {Record<Answer, string>} */
const DONE = { keep: "kept", reject: "rejected", unsure: "flagged as unsure", clear: "without an answer again" };

/**
 * What people's answers need for the whole page: unsent ones, acts on many boxes, undo, conflicts, and the boxes that are on show.
 * @param {import("../core/app.js").App} app @param {Storage} storage
 */
export async function createAnswers(app, storage) {
  const { toasts, notice } = app;
  const { tab, openTabs } = await nameThisTab();
  const items = createOutbox(storage, tab, app.owner);
  const frames = createFrames(app.api);
  const stores = createOpenStores(() => frames.current()?.store);
  const undo = createUndo();
  /** Answers that met somebody else's. */
  const conflicts = createValue(/** @type {ReadonlyMap<number, QueuedAnswer>} */ (new Map()));
  const acts = createActs({ stores, frames, toasts, undo, notice, start: (act, key) => sender.start(act, key) });
  const sender = createSender(items, { answer: app.api.review, act: sendBulk }, {
    onStored(stored, isLatest) {
      frames.forget(frames.current()?.frame.id);
      if (isLatest) stores.tell(stored.box_id, (box) => withStored(box, stored));
    },
    onConflict(item, current) {
      undo.forget(item.boxId);
      conflicts.set(new Map(conflicts.get()).set(item.boxId, item));
      if (current) stores.tell(item.boxId, () => current);
      // The box on show says it itself, and so does the queue.
      const { name, query } = app.router.route.get();
      if (name === "queue" || query.box === String(item.boxId)) return;
      toasts.show(`Somebody else has answered a box. Yours (${item.verdict}) is not stored.`, {
        kind: "error",
        action: { text: "Show box", href: `#/frames/${item.frameId}?box=${item.boxId}` },
      });
    },
    onRefused(item, error) {
      undo.forget(item.boxId);
      toasts.show(`Not stored: ${error.message}`, { kind: "error" });
      void frames.refresh(item.boxId);
    },
    onDone: acts.done,
    onGivenUp: acts.givenUp,
    onActFailed: notice,
    onSignedOut: app.endSession,
  });
  sender.adopt(openTabs);

  /** Send what waits. */
  function resume() {
    sender.adopt(openTabs);
    void sender.resume();
  }
  app.isSignedIn.observe((isIn) => isIn && (offerUnowned(), resume()));
  addEventListener("online", resume);

  /** Answers that are kept since before they had a name on them. */
  function offerUnowned() {
    const count = unowned(storage).length;
    const name = app.owner();
    if (count === 0 || !name) return;
    toasts.show(`${countOf(count, "answer")} kept in this browser ${count === 1 ? "has" : "have"} no name.`, {
      action: { text: `Send as ${name}`, run: () => (own(storage, name), app.startAnew()) },
    });
  }

  /** @param {number} boxId */
  function settle(boxId) {
    const rest = new Map(conflicts.get());
    rest.delete(boxId);
    conflicts.set(rest);
  }

  return {
    frames,
    stores,
    outbox: sender,
    acts,
    undo,
    conflicts,
    offerUnowned,
    resume,
    /** How many answers of each person wait in this browser. */
    kept: items.kept,
    /** A conflict that the person has seen. */
    settle,

    /** An answer that lost against another one, given again on top of it. @param {Decision} box @param {QueuedAnswer} item */
    insist(box, item) {
      settle(box.box_id);
      stores.answering(box.box_id)?.apply(withAnswer(box, item.verdict, item.comment), LOCAL);
    },
  };
}

/** @typedef {import("../core/app.js").App & Awaited<ReturnType<typeof createAnswers>>} ReviewApp  what views are given in which people answer */

/**
 * Acts on many boxes as the person sees them: shown at once, told when they are stored, taken back as one.
 * @param {{stores: import("../boxes/store.js").OpenStores, frames: import("../boxes/store.js").Frames, toasts: import("../core/messages.js").Toasts,
 *   undo: Undo, notice: (error: unknown) => void, start: (act: import("./outbox.js").WantedAct, key?: string) => void}} page
 */
function createActs({ stores, frames, toasts, undo, notice, start }) {
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

  /** @param {number} batchId @returns {Promise<boolean>} was it taken back? */
  async function takeBack(batchId) {
    try {
      undone(batchId, await undoBulk(batchId));
      undo.forgetBatch(batchId);
      return true;
    } catch (error) {
      notice(error);
      if (!(error instanceof ApiError) || !NEVER_UNDONE.has(error.problem.code ?? "")) return false;
      undo.forgetBatch(batchId);
      toasts.show(error.message, { kind: "error" });
      return false;
    }
  }

  /** @param {number} batchId @param {import("./outbox.js").UndoOut} out */
  function undone(batchId, { undone: count, skipped }) {
    const { key = "", toast = 0 } = stored.get(batchId) ?? {};
    toasts.dismiss(toast);
    putBack(key, { but: new Set(skipped), isUndo: true });
    frames.forgetAll();
    if (!before.get(key)?.length) sweeps.set(sweeps.get() + 1);
    toasts.show(`${countOf(count, "answer")} taken back`);
    report.set(skipped.length ? { text: `${countOf(skipped.length, "answer was", "answers were")} left as ${skipped.length === 1 ? "it is" : "they are"}: somebody has answered since.`, boxes: skipped } : null);
  }

  return {
    report,
    sweeps,

    /** It is stored. @param {import("./outbox.js").DoneAct} done */
    done({ batchId, act, skipped, stale }) {
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

    /** It will not be stored. @param {import("./outbox.js").Act} act */
    givenUp: (act) => putBack(act.key),

    /** One answer on these boxes, shown at once. @param {string} dataset @param {Answer} verdict @param {readonly number[]} boxIds @param {ReadonlyMap<number, number>} revisions  as the person saw them */
    answer(dataset, verdict, boxIds, revisions) {
      const boxes = boxIds.flatMap((id) => stores.find(id) ?? []);
      const key = crypto.randomUUID();
      before.set(key, boxes);
      for (const box of boxes) stores.tell(box.box_id, () => ({ ...withAnswer(box, verdict), revision: seenRevision(box) + 1 }));
      start({ dataset, verdict, boxIds: [...boxIds], seen: boxIds.map((id) => revisions.get(id) ?? 0), count: boxIds.length }, key);
    },

    /** One answer on all that a filter selected when the list was read. @param {string} dataset @param {Answer} verdict @param {import("./outbox.js").Filter} filter @param {{total: number, snapshot: string}} list */
    answerAll: (dataset, verdict, filter, { total, snapshot }) => start({ dataset, verdict, filter, snapshot, count: total }),

    /** Take back the last act, one on many boxes. @param {number} batchId */
    async undo(batchId) {
      await takeBack(batchId);
      if (undo.peek()?.batchId === batchId) toasts.show("Not taken back: the server could not be asked.", { kind: "error" });
    },
  };
}

/**
 * @typedef {object} UndoStep
 * @property {number} boxId
 * @property {number} frameId
 * @property {Answer} verdict  the answer to post again; clear when there was none
 * @property {string} comment
 * @property {number} [batchId]  of a bulk act, which is taken back as one
 */

const DEPTH = 500;

export function createUndo() {
  /** @type {UndoStep[]} */
  const steps = [];

  /** @param {UndoStep} step */
  function push(step) {
    steps.push(step);
    if (steps.length > DEPTH) steps.shift();
  }

  return {
    /** @param {Change} change */
    notice({ origin, before }) {
      if (origin !== LOCAL) return;
      push({
        boxId: before.box_id,
        frameId: before.frame_id,
        verdict: before.review?.verdict ?? "clear",
        comment: before.review?.comment ?? "",
      });
    },

    /** One answer on many boxes is one step. @param {number} batchId */
    noticeBatch: (batchId) => push({ boxId: 0, frameId: 0, verdict: "clear", comment: "", batchId }),

    /** @param {number} batchId */
    forgetBatch(batchId) {
      const at = steps.findIndex((step) => step.batchId === batchId);
      if (at >= 0) steps.splice(at, 1);
    },

    /** The step to take back next, without taking it. */
    peek: () => steps.at(-1) ?? null,

    take: () => steps.pop() ?? null,

    /** Someone else's answer stands now: what this person did to the box is no longer theirs to undo. @param {number} boxId */
    forget(boxId) {
      for (let i = steps.length - 1; i >= 0; i--) if (steps[i]?.boxId === boxId) steps.splice(i, 1);
    },

    size: () => steps.length,
  };
}

/** @typedef {ReturnType<typeof createUndo>} Undo */
