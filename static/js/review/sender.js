// @ts-check
// Sends what is in the outbox, one item at a time, the oldest first. Each waits until those before it are stored or
// refused. `afterError` says what each error means.

import { seenRevision } from "../boxes/box.js";
import { ApiError, NoResponse, createRetries, get, post } from "../core/api.js";
import { createValue } from "../core/observable.js";
import { countAnswers, idempotencyKey, isBulk, isBulkAnswer, isBulkUndo, isSingle, wasAttempted } from "./outbox.js";

/** @import { Decision } from "../boxes/box.js" */
/** @import { Later } from "../core/api.js" */
/** @import { Value } from "../core/observable.js" */
/** @import { History, HistoryEntry, Review as StoredReview, ReviewBatch, UndoneBatch } from "../core/openapi.js" */
/** @import { OpenTabs } from "../core/tab.js" */
/** @import { BulkAnswer, BulkItem, BulkUndo, GivenAnswer, NewAnswer, NewBulkAnswer, NewBulkUndo } from "./outbox.js" */
/** @import { Outbox, OutboxItem, SingleAnswer } from "./outbox.js" */

/**
 * @typedef {object} Requests  all but `history` resolve when the server has stored the item
 * @property {(item: SingleAnswer) => Promise<StoredReview>} answer
 * @property {(item: SingleAnswer) => Promise<StoredReview>} undo
 * @property {(boxId: number) => Promise<History>} history  the newest answers on a box, among others
 * @property {(bulk: BulkAnswer) => Promise<ReviewBatch>} bulkAnswer
 * @property {(undo: BulkUndo) => Promise<UndoneBatch>} bulkUndo
 */

/** @type {Requests} */
const REQUESTS = {
  answer(item) {
    const { boxId, verdict, comment, seenRevision: seen_revision, lookedMs: looked_ms = null } = item;
    const body = { verdict, comment, seen_revision, looked_ms };
    return post("/api/v1/boxes/{box_id}/reviews", { path: { box_id: boxId }, body, key: idempotencyKey(item) });
  },

  undo: ({ key, boxId, undoes = 0 }) =>
    post("/api/v1/boxes/{box_id}/reviews/{revision}/undo", { path: { box_id: boxId, revision: undoes }, key }),

  history: (boxId) => get("/api/v1/boxes/{box_id}/history", { path: { box_id: boxId }, query: { limit: 1000 } }),

  bulkAnswer({ key, dataset, verdict, boxIds, seenRevisions, filter, snapshot, lookedAt: looked_at = null }) {
    const boxes = boxIds ? { box_ids: boxIds, seen_revisions: seenRevisions } : { filter, snapshot };
    return post("/api/v1/reviews/bulk", { body: { dataset, verdict, looked_at, ...boxes }, key });
  },

  // The key is made from the batch, so that repeated requests undo it once.
  bulkUndo: ({ batchId }) =>
    post("/api/v1/review-batches/{batch_id}/undo", { path: { batch_id: batchId ?? 0 }, key: `undo-batch-${batchId}` }),
};

/**
 * @typedef {object} SenderEvents
 * @property {(stored: StoredReview, item: SingleAnswer) => void} onStored
 * @property {(item: SingleAnswer, current: Decision | null) => void} onOvertaken  the box was answered elsewhere since
 *   this person saw it; `current`: the box as it is now
 * @property {(item: SingleAnswer, error: Error) => void} onRefused  the server will never store it
 * @property {(item: SingleAnswer) => void} onWithdrawn  the server has refused it, after this person had undone it
 * @property {(bulk: BulkAnswer, stored: ReviewBatch) => void} onBulkStored
 * @property {(bulk: BulkAnswer, error: Error) => void} onBulkRefused
 * @property {(bulk: BulkAnswer) => void} onBulkDiscarded
 * @property {(undo: BulkUndo, stored: UndoneBatch) => void} onUndoStored
 * @property {(undo: BulkUndo, error: Error) => void} onUndoRefused  the server will never do it
 * @property {() => void} onSignedOut  the server stores nothing until somebody signs in
 * @property {() => void} onFull  something was not put into the outbox: this browser has no room for it
 */

/** @typedef {"saved" | "saving" | "offline" | "signed-out" | "busy"} Phase */

/**
 * @typedef {object} OpenBulkItem  a bulk answer, or the undo of one, that is not stored
 * @property {BulkItem} item
 * @property {"sending" | "waiting" | "changed" | "refused"} state  `changed` and `refused`: the server has refused the
 * bulk answer, which is no longer in the outbox, and the person has to decide; `changed`: other boxes match the filter
 *   than the person saw
 * @property {string} text  why it is not stored
 */

/**
 * @typedef {object} SenderState
 * @property {Phase} phase
 * @property {ReadonlySet<number>} waiting  boxes with an unsaved answer that was given on one box, in any tab
 * @property {ReadonlySet<number>} waitingInBulk  boxes of bulk answers, and of their undos, that are not stored, of any
 *   tab
 * @property {number} count  of the answers that this tab has to send
 * @property {readonly OpenBulkItem[]} bulkItems  of this tab, with the refused ones
 */

/** The box as it is now, if an answer was refused because the box was answered since. @param {unknown} error */
const currentBox = (error) => (error instanceof ApiError && error.status === 412 && error.problem.current) || null;

/** @param {Outbox} outbox @param {Requests} [requests] @param {Later} [later] */
export function createSender(outbox, requests = REQUESTS, later) {
  const retries = createRetries(later);
  /** @type {Partial<SenderEvents>[]} */
  const observers = [];
  /** @param {(observer: Partial<SenderEvents>) => void} notify */
  const tell = (notify) => observers.forEach(notify);

  /** The item that is being sent, until it is known what becomes of it. @type {OutboxItem | null} */
  let sending = null;
  /** Why the items wait; empty if the last one was stored or refused. */
  let waitingBecause = "";
  /**
   * The bulk answers that were refused since the page was loaded, by their keys.
   * @type {Map<string, OpenBulkItem & {item: BulkAnswer}>}
   */
  const refused = new Map();
  /**
   * The bulk answers on a filter, and their undos, that this tab has stored since it was loaded: from the id on the
   * server to the `order` in which they were given. `isOvertakenByOwn` recognises them in a box's history.
   * @type {Map<number, number>}
   */
  const storedOnFilter = new Map();

  /** @type {Value<SenderState>} */
  const state = createValue(stateIn("saved"));

  /** @param {Phase} phase @returns {SenderState} */
  function stateIn(phase) {
    const ofAllTabs = outbox.itemsOfAllTabs();
    const items = ofAllTabs.filter(outbox.isOfThisTab);
    const bulkItems = items.filter(isBulk);
    return {
      phase: items.length > 0 ? phase : "saved",
      waiting: new Set(ofAllTabs.filter(isSingle).map(({ boxId }) => boxId)),
      waitingInBulk: new Set(ofAllTabs.filter(isBulk).flatMap(({ boxIds = [] }) => boxIds)),
      count: countAnswers(items),
      bulkItems: [
        ...refused.values(),
        ...bulkItems.map((item) => {
          const isSending = !waitingBecause || (phase === "saving" && sending?.key === item.key);
          return /** @type {OpenBulkItem} */ (
            isSending ? { item, state: "sending", text: "" } : { item, state: "waiting", text: waitingBecause }
          );
        }),
      ],
    };
  }

  /** @param {Phase} phase */
  const show = (phase) => state.set(stateIn(phase));

  /**
   * The item to send next. First comes an item that was sent before, without a response: the server may have stored
   * it, and then later items on its boxes need the new revision. Then comes the oldest item. (The two can differ: an
   * item that was taken over from another tab may be older than the one that was sent.)
   */
  function next() {
    const items = outbox.items();
    return items.find(wasAttempted) ?? items[0] ?? null;
  }

  /** Send everything, until something has to wait. */
  async function drain() {
    if (sending) return;
    try {
      for (sending = next(); sending; sending = next()) {
        show("saving");
        if (!(await deliver(sending))) return;
        waitingBecause = "";
        retries.reset();
      }
      waitingBecause = "";
      show("saved");
    } finally {
      sending = null;
    }
  }

  /** @param {OutboxItem} item @returns {Promise<boolean>} whether the next one is sent now */
  async function deliver(item) {
    try {
      if (isSingle(item)) await sendAnswer(item);
      else if (isBulkUndo(item)) await sendBulkUndo(item);
      else await sendBulkAnswer(item);
      return true;
    } catch (error) {
      return afterError(item, error);
    }
  }

  /** @param {SingleAnswer} item */
  async function sendAnswer(item) {
    outbox.markAttempted(item);
    let stored;
    try {
      stored = await (item.undoes ? requests.undo(item) : requests.answer(item));
    } catch (error) {
      const current = currentBox(error);
      const isByOwn = current && (await isOvertakenByOwn(item));
      // It may have been undone just now.
      if (!isByOwn || outbox.wasUndone(item)) throw error;
      outbox.renew(item, seenRevision(current));
      return; // it is still in the outbox, so `drain` sends it once more
    }
    outbox.finish(item, { revision: stored.revision });
    tell(({ onStored }) => onStored?.(stored, item));
  }

  /**
   * Whether a single answer was refused (412) only because of the person's own earlier bulk answers on a filter.
   * The page does not know which boxes such a bulk answer has changed, so it does not know their new revisions, and the
   * server refuses the next single answer on one of them as if somebody else had answered meanwhile. The box's history
   * says who it was. Every entry since the seen revision has to be a bulk answer on a filter, or the undo of one. This
   * tab must have sent it, and the person must have given it before the single answer.
   * @param {SingleAnswer} item
   * @returns {Promise<boolean>} false also if the history will never be loaded: the person chooses between the answers
   * @throws {Error} of the request, if the history may be loaded later: the answer waits
   */
  async function isOvertakenByOwn(item) {
    if (storedOnFilter.size === 0) return false;
    let items;
    try {
      ({ items } = await requests.history(item.boxId));
    } catch (error) {
      // After a 500 it would fail again: that is a fault of the server with this one box.
      if (!(error instanceof ApiError) || error.status === 401 || (error.isTemporary && error.status !== 500))
        throw error;
      return false;
    }
    const since = items.filter(({ revision }) => (revision ?? 0) > item.seenRevision);
    const isOwnAndGivenBefore = (/** @type {HistoryEntry} */ { batch }) => {
      const givenAt = batch ? storedOnFilter.get(batch) : undefined;
      return givenAt !== undefined && givenAt <= item.order;
    };
    const isWhole = since.some(({ revision }) => revision === item.seenRevision + 1);
    return isWhole && since.every(isOwnAndGivenBefore);
  }

  /**
   * What becomes of an item that was not stored.
   * @param {OutboxItem} item @param {unknown} error @returns {boolean} whether the next one is sent now
   */
  function afterError(item, error) {
    // Whatever the item is: it stays, and is sent again with the same key.
    if (error instanceof NoResponse) return waitAndRetry("offline", "the server does not answer");
    if (!(error instanceof ApiError)) {
      // A fault of this page: the item is sent again all the same, and the fault is thrown, so that it is reported.
      waitAndRetry("busy", error instanceof Error ? error.message : String(error));
      throw error;
    }
    if (error.isTemporary) return waitAndRetry("busy", error.message, error.retryAfterS);
    if (error.status === 401) {
      waitingBecause = "you are signed out";
      show("signed-out");
      tell(({ onSignedOut }) => onSignedOut?.());
      return false;
    }

    // The server has refused this item, and the next one is sent.
    if (isBulkAnswer(item)) return refuse(item, error);
    if (isBulkUndo(item)) return drop(item, ({ onUndoRefused }) => onUndoRefused?.(item, error));
    if (outbox.wasUndone(item)) return drop(item, ({ onWithdrawn }) => onWithdrawn?.(item));
    // 412: the box was answered since the person saw it.
    if (error.status === 412) return drop(item, ({ onOvertaken }) => onOvertaken?.(item, currentBox(error)));
    return drop(item, ({ onRefused }) => onRefused?.(item, error));
  }

  /** @param {Phase} phase @param {string} text  why @param {number | null} [seconds]  as the server has asked */
  function waitAndRetry(phase, text, seconds = null) {
    waitingBecause = text;
    show(phase);
    retries.wait(() => void drain(), seconds);
    return false;
  }

  /** @param {SingleAnswer | BulkUndo} item @param {(observer: Partial<SenderEvents>) => void} notify */
  function drop(item, notify) {
    outbox.remove(item);
    tell(notify);
    return true;
  }

  /**
   * Put something into the outbox. It is sent at once, also if the server did not answer before ("offline"). But if
   * nobody is signed in, it waits for that; and after a failure of the server or of this page ("busy"), it waits for
   * the next attempt.
   * @template T
   * @param {() => T} add @returns {T | null} what `add` returns; null: this browser has no room for it
   */
  function put(add) {
    let added;
    try {
      added = add();
    } catch (error) {
      if (!(error instanceof DOMException && error.name === "QuotaExceededError")) throw error;
      tell(({ onFull }) => onFull?.());
      return null;
    }
    const { phase } = state.get();
    show(phase === "saved" ? "saving" : phase);
    if (phase !== "signed-out" && phase !== "busy") void drain();
    return added;
  }

  /** Try now: the network is back, or somebody has signed in. */
  function resume() {
    retries.reset();
    // While a request is under way, `drain` does nothing. If that request fails, it is sent again without a pause.
    if (sending) retries.skipNext();
    return drain();
  }

  // Bulk answers and their undo.

  /** @param {BulkAnswer} bulk */
  async function sendBulkAnswer(bulk) {
    outbox.markAttempted(bulk);
    const stored = await requests.bulkAnswer(bulk);
    const leftOut = stored.count ? [...stored.stale, ...stored.skipped] : (bulk.boxIds ?? []);
    finishBulk(bulk, stored.id, leftOut);
    outbox.completeUndo(bulk, stored.id, leftOut);
    tell(({ onBulkStored }) => onBulkStored?.(bulk, stored));
  }

  /** @param {BulkUndo} undo */
  async function sendBulkUndo(undo) {
    const stored = await requests.bulkUndo(undo);
    finishBulk(undo, stored.id, stored.skipped);
    tell(({ onUndoStored }) => onUndoStored?.(undo, stored));
  }

  /** @param {BulkItem} item @param {number} storedId @param {readonly number[]} leftOut */
  function finishBulk(item, storedId, leftOut) {
    if (!item.boxIds) storedOnFilter.set(storedId, item.order);
    outbox.finish(item, { leftOut });
  }

  /**
   * A bulk answer was refused: the person decides what becomes of it, unless it was to be undone.
   * @param {BulkAnswer} bulk @param {ApiError} error
   */
  function refuse(bulk, error) {
    const state = error.problem.code === "stale_snapshot" ? "changed" : "refused";
    refused.set(bulk.key, { item: bulk, state, text: error.message });
    if (outbox.undoOf(bulk.key)) {
      discard(bulk.key);
    } else {
      outbox.remove(bulk);
      tell(({ onBulkRefused }) => onBulkRefused?.(bulk, error));
    }
    return true;
  }

  /** Discard a bulk answer and its undo. @param {string} key */
  function discard(key) {
    const bulk = outbox.bulkAnswer(key) ?? refused.get(key)?.item;
    if (!bulk) return;
    const undo = outbox.undoOf(key);
    if (undo) outbox.remove(undo);
    outbox.remove(bulk);
    refused.delete(key);
    show(state.get().phase);
    tell(({ onBulkDiscarded }) => onBulkDiscarded?.(bulk));
  }

  return {
    state,
    resume,

    /** Another tab has changed what is in the outbox. */
    refresh: () => show(state.get().phase),

    /** @param {Partial<SenderEvents>} events */
    observe: (events) => void observers.push(events),

    /** @param {NewAnswer} answer @returns null: this browser has no room for it */
    addAnswer: (answer) => put(() => outbox.addAnswer(answer)),

    /**
     * Undo an answer on one box.
     * @param {GivenAnswer} given @param {NewAnswer} earlier  what its box gets again
     * @returns {boolean | null} as that of the outbox; null: this browser has no room for it
     */
    undoAnswer: (given, earlier) => put(() => outbox.undoAnswer(given, earlier)),

    /** @param {NewBulkAnswer} bulk @param {string} [key] @returns {boolean} false: this browser has no room for it */
    addBulkAnswer: (bulk, key) => put(() => outbox.addBulkAnswer(bulk, key)) !== null,

    /**
     * Undo a bulk answer. If the server cannot have stored it, it is discarded; else its undo is put into the outbox.
     * @param {NewBulkUndo} undo @returns {"discarded" | "added" | "full"}  full: this browser has no room for it
     */
    addBulkUndo(undo) {
      const { bulkKey } = undo;
      const bulk = outbox.bulkAnswer(bulkKey);
      const isUnsent = refused.has(bulkKey) || (bulk && !bulk.attempted);
      if (!isUnsent) return put(() => outbox.addBulkUndo(undo)) === null ? "full" : "added";
      discard(bulkKey);
      return "discarded";
    },

    discard,

    /**
     * Take over the items of closed tabs. `resume` then sends the items of the person who is signed in: those taken
     * over, and those that this tab had before it was loaded again.
     * @param {OpenTabs} openTabs
     */
    takeOver(openTabs) {
      outbox.takeOver(openTabs);
      if (!sending) waitingBecause ||= "it was not sent before the page was closed";
      show(state.get().phase);
    },
  };
}

/** @typedef {ReturnType<typeof createSender>} Sender */
