// @ts-check
// Sends what is in the outbox, one item at a time, the oldest first. Each waits until those before it are stored or
// refused; a refused bulk answer is passed over until the person decides. `afterError` says what each refusal means.

import { seenRevision } from "../boxes/box.js";
import { ApiError, NoResponse, createRetries, post } from "../core/api.js";
import { createValue } from "../core/observable.js";
import { isBulk, isBulkAnswer, isBulkUndo, isSingle } from "./outbox.js";

/** @typedef {import("../boxes/box.js").Decision} Decision */
/** @typedef {import("../core/openapi.js").Review} StoredReview */
/** @typedef {import("./outbox.js").SingleAnswer} SingleAnswer */
/** @typedef {import("./outbox.js").BulkAnswer} BulkAnswer */
/** @typedef {import("./outbox.js").BulkUndo} BulkUndo */
/** @typedef {import("./outbox.js").BulkItem} BulkItem */
/** @typedef {import("./outbox.js").OutboxItem} OutboxItem */

/**
 * @typedef {object} BulkStored  the response to a bulk answer
 * @property {number} id  of the batch
 * @property {number} count
 * @property {number[]} skipped  boxes that were deleted or replaced since they were seen
 * @property {number[]} stale  boxes that were answered since they were seen
 */

/** @typedef {{id: number, undone: number, skipped: number[]}} UndoStored  the response to the undo of a bulk answer */

/**
 * @typedef {object} Requests  each resolves when the server has stored the item
 * @property {(item: SingleAnswer) => Promise<StoredReview>} answer
 * @property {(bulk: BulkAnswer) => Promise<BulkStored>} bulkAnswer
 * @property {(undo: BulkUndo) => Promise<UndoStored>} bulkUndo
 */

/** @type {Requests} */
const REQUESTS = {
  answer: ({ key, boxId, verdict, comment, seenRevision: seen_revision }) =>
    post("/api/v1/boxes/{box_id}/reviews", { path: { box_id: boxId }, body: { verdict, comment, seen_revision }, key }),

  bulkAnswer({ key, dataset, verdict, boxIds, seenRevisions, filter, snapshot }) {
    const boxes = boxIds ? { box_ids: boxIds, seen_revisions: seenRevisions } : { filter, snapshot };
    return post("/api/v1/reviews/bulk", { body: { dataset, verdict, ...boxes }, key });
  },

  // The key is made from the batch, so that repeated requests undo it once.
  bulkUndo: ({ batchId }) =>
    post("/api/v1/review-batches/{batch_id}/undo", { path: { batch_id: batchId ?? 0 }, key: `undo-batch-${batchId}` }),
};

/**
 * @typedef {object} SenderEvents
 * @property {(stored: StoredReview) => void} onStored
 * @property {(item: SingleAnswer, current: Decision | null) => void} onConflict  somebody else has answered the box
 *   since this person saw it; `current`: the box as it is now
 * @property {(item: SingleAnswer, error: Error) => void} onRefused  the server will never store it
 * @property {(bulk: BulkAnswer, stored: BulkStored) => void} onBulkStored
 * @property {(bulk: BulkAnswer) => void} onBulkDiscarded
 * @property {(undo: BulkUndo, stored: UndoStored) => void} onUndoStored
 * @property {(undo: BulkUndo, error: Error) => void} onUndoRefused  the server will never do it
 * @property {() => void} onSignedOut  the server stores nothing until somebody signs in
 * @property {() => void} onFull  something was not put into the outbox: this browser has no room for it
 */

/** @typedef {"saved" | "saving" | "offline" | "signed-out" | "busy"} Phase */

/**
 * @typedef {object} OpenBulkItem  a bulk answer, or the undo of one, that is not stored
 * @property {BulkItem} item
 * @property {"sending" | "waiting" | "changed" | "refused"} state  `changed` and `refused` bulk answers are set aside
 *   until the person decides; `changed`: other boxes match the filter than the person saw
 * @property {string} text  why it is not stored
 */

/**
 * @typedef {object} SenderState
 * @property {Phase} phase
 * @property {ReadonlySet<number>} waiting  boxes with an unsaved answer that was given on one box, in any tab
 * @property {ReadonlySet<number>} waitingInBulk  boxes of bulk answers, and of their undos, that are not stored, of any
 *   tab
 * @property {number} count  of the answers that this tab has to send: boxes with an answer on one box, and the boxes of
 *   each bulk item that is not set aside
 * @property {readonly OpenBulkItem[]} bulkItems  of this tab
 */

/**
 * @param {import("./outbox.js").Outbox} outbox @param {Requests} [requests]
 * @param {import("../core/api.js").Later} [later]
 */
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
  /** If the request that is under way fails, send the item again at once: `resume` was called meanwhile. */
  let isRetryDue = false;
  /** The bulk answers that are set aside, by their keys. @type {Map<string, Pick<OpenBulkItem, "state" | "text">>} */
  const setAside = new Map();
  /** The `order` of the last bulk answer on a filter, or undo of one, that was stored since the page was loaded. */
  let lastFilterOrder = 0;

  /** @type {import("../core/observable.js").Value<SenderState>} */
  const state = createValue(stateIn("saved"));

  /** @param {Phase} phase @returns {SenderState} */
  function stateIn(phase) {
    const ofAllTabs = outbox.itemsOfAllTabs();
    const items = ofAllTabs.filter(outbox.isOfThisTab);
    const inTurn = items.filter(({ key }) => !setAside.has(key));
    const bulkCount = inTurn.filter(isBulk).reduce((sum, { count }) => sum + count, 0);
    return {
      phase: inTurn.length > 0 ? phase : "saved",
      waiting: boxesOf(ofAllTabs),
      waitingInBulk: new Set(ofAllTabs.filter(isBulk).flatMap(({ boxIds = [] }) => boxIds)),
      count: boxesOf(items).size + bulkCount,
      bulkItems: items.filter(isBulk).map((item) => ({ item, ...bulkStateIn(phase, item) })),
    };
  }

  /** @param {Phase} phase @param {BulkItem} item @returns {Pick<OpenBulkItem, "state" | "text">} */
  function bulkStateIn(phase, { key }) {
    const aside = setAside.get(key);
    if (aside) return aside;
    const isSending = phase === "saving" && sending?.key === key;
    return waitingBecause && !isSending ? { state: "waiting", text: waitingBecause } : { state: "sending", text: "" };
  }

  /** @param {Phase} phase */
  const show = (phase) => state.set(stateIn(phase));

  const next = () => outbox.items().find(({ key }) => !setAside.has(key)) ?? null;

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
    const stored = await requests.answer(item);
    outbox.remove(item);
    outbox.setSeenRevisions(item, new Map([[item.boxId, stored.revision]]));
    tell(({ onStored }) => onStored?.(stored));
  }

  /**
   * What becomes of an item that was not stored.
   * @param {OutboxItem} item @param {unknown} error @returns {boolean} whether the next one is sent now
   */
  function afterError(item, error) {
    // Whatever the item is: it stays, and is sent again with the same key, before all others.
    if (error instanceof NoResponse) return waitAndRetry("offline", "the server does not answer");
    if (!(error instanceof ApiError)) return waitAfterFault(error);
    if (error.isTemporary) return waitAndRetry("busy", error.message, error.retryAfterS);
    if (error.status === 401) return waitForSignIn();

    // The server has refused this item, and the next one is sent.
    if (isBulkAnswer(item)) return putAside(item, error); // stays: the person decides
    if (isBulkUndo(item)) return drop(item, ({ onUndoRefused }) => onUndoRefused?.(item, error));
    if (error.status !== 412) return drop(item, ({ onRefused }) => onRefused?.(item, error));

    // 412: the box was answered since the person saw it.
    const current = error.problem.current ?? null;
    if (current && isConflictWithOneself(item, current)) return renew(item, current);
    return drop(item, ({ onConflict }) => onConflict?.(item, current));
  }

  /** @param {Phase} phase @param {string} text  why @param {number | null} [seconds]  as the server has asked */
  function waitAndRetry(phase, text, seconds = null) {
    waitingBecause = text;
    show(phase);
    retries.wait(() => void drain(), isRetryDue ? 0 : seconds);
    isRetryDue = false;
    return false;
  }

  /** A fault of this page: the item is sent again all the same. @param {unknown} error @returns {never} */
  function waitAfterFault(error) {
    waitAndRetry("busy", error instanceof Error ? error.message : String(error));
    throw error;
  }

  function waitForSignIn() {
    waitingBecause = "you are signed out";
    show("signed-out");
    tell(({ onSignedOut }) => onSignedOut?.());
    return false;
  }

  /** @param {SingleAnswer | BulkUndo} item @param {(observer: Partial<SenderEvents>) => void} notify */
  function drop(item, notify) {
    outbox.remove(item);
    // Later items count as having seen what this one had seen. If it was renewed, that is newer than what they have.
    outbox.setSeenRevisions(item, revisionsSeenBy(item));
    tell(notify);
    return true;
  }

  /**
   * Nobody else has answered the box: send the answer again, as a new one.
   * @param {SingleAnswer} item @param {Decision} current
   */
  function renew(item, current) {
    outbox.renew(item, seenRevision(current));
    return true;
  }

  /**
   * Whether an answer was refused because of an earlier one of the same person, and not of somebody else. That happens
   * in two cases: the earlier one was stored after this one had been attempted (see `ownRevision`); or it was given to
   * all boxes of a filter, or undone on them, and the page does not know which boxes a filter selects. (After an undo
   * the box may have no answer.)
   * @param {SingleAnswer} item @param {Decision} current
   */
  function isConflictWithOneself(item, current) {
    if (seenRevision(current) === item.ownRevision) return true;
    const isAfterFilter = lastFilterOrder > 0 && item.order > lastFilterOrder;
    return isAfterFilter && (current.review?.reviewer ?? item.person) === item.person;
  }

  /**
   * Put something into the outbox, and send it unless nobody is signed in.
   * @param {() => void} add @returns {boolean} false: this browser has no room for it
   */
  function put(add) {
    try {
      add();
    } catch (error) {
      if (!(error instanceof DOMException && error.name === "QuotaExceededError")) throw error;
      tell(({ onFull }) => onFull?.());
      return false;
    }
    const { phase } = state.get();
    show(phase === "saved" ? "saving" : phase);
    if (phase !== "signed-out") void drain();
    return true;
  }

  /** Try now: the network is back, or somebody has signed in. */
  function resume() {
    isRetryDue = sending !== null;
    retries.reset();
    return drain();
  }

  // Bulk answers and their undo.

  /** @param {BulkAnswer} bulk */
  async function sendBulkAnswer(bulk) {
    outbox.markAttempted(bulk);
    const stored = await requests.bulkAnswer(bulk);
    outbox.remove(bulk);
    outbox.completeUndo(bulk, stored.id, [...stored.stale, ...stored.skipped]);
    setRevisionsAfter(bulk, stored.stale);
    tell(({ onBulkStored }) => onBulkStored?.(bulk, stored));
  }

  /** @param {BulkUndo} undo */
  async function sendBulkUndo(undo) {
    const stored = await requests.bulkUndo(undo);
    outbox.remove(undo);
    setRevisionsAfter(undo, stored.skipped);
    tell(({ onUndoStored }) => onUndoStored?.(undo, stored));
  }

  /**
   * A bulk item was stored: later items have seen the revisions that its boxes have now.
   * @param {BulkItem} item @param {readonly number[]} leftOut
   */
  function setRevisionsAfter(item, leftOut) {
    if (!item.boxIds) lastFilterOrder = item.order;
    const revisions = revisionsSeenBy(item);
    for (const boxId of leftOut) revisions.delete(boxId);
    for (const [boxId, seen] of revisions) revisions.set(boxId, seen + 1);
    outbox.setSeenRevisions(item, revisions);
  }

  /**
   * Pass over a bulk answer until the person decides; if it was to be undone, there is nothing to decide.
   * @param {BulkAnswer} bulk @param {ApiError} error
   */
  function putAside(bulk, error) {
    const isChanged = error.problem.code === "stale_snapshot";
    setAside.set(bulk.key, { state: isChanged ? "changed" : "refused", text: error.message });
    outbox.setSeenRevisions(bulk, revisionsSeenBy(bulk));
    if (outbox.undoOf(bulk.key)) discard(bulk.key);
    return true;
  }

  /** Discard a bulk answer and its undo. @param {string} key */
  function discard(key) {
    const bulk = outbox.bulkAnswer(key);
    if (!bulk) return;
    const undo = outbox.undoOf(key);
    if (undo) outbox.remove(undo);
    outbox.remove(bulk);
    // If it was set aside, later items got their revisions then, and people may have answered the boxes since.
    if (!setAside.delete(key)) outbox.setSeenRevisions(bulk, revisionsSeenBy(bulk));
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

    /** @param {import("./outbox.js").NewAnswer} answer @returns {boolean} false: this browser has no room for it */
    addAnswer: (answer) => put(() => outbox.addAnswer(answer)),

    /** @param {import("./outbox.js").NewBulkAnswer} bulk @param {string} [key] @returns {boolean} as `addAnswer` */
    addBulkAnswer: (bulk, key) => put(() => outbox.addBulkAnswer(bulk, key)),

    /**
     * Undo a bulk answer. If the server cannot have stored it, it is discarded; else its undo is put into the outbox.
     * @param {import("./outbox.js").NewBulkUndo} undo @returns {boolean} as `addAnswer`
     */
    addBulkUndo(undo) {
      const bulk = outbox.bulkAnswer(undo.bulkKey);
      if (!bulk || (bulk.attempted && !setAside.has(bulk.key))) return put(() => outbox.addBulkUndo(undo));
      discard(bulk.key);
      return true;
    },

    /** Send a bulk item again that was set aside or is waiting. @param {string} key */
    retry(key) {
      setAside.delete(key);
      return resume();
    },

    discard,

    /**
     * Take over the items of closed tabs. `resume` sends those of this person, and those that this tab had before it
     * was loaded again.
     * @param {import("../core/tab.js").OpenTabs} openTabs
     */
    takeOver(openTabs) {
      outbox.takeOver(openTabs);
      if (!sending) waitingBecause ||= "it was not sent before the page was closed";
      show(state.get().phase);
    },
  };
}

/** @typedef {ReturnType<typeof createSender>} Sender */

/** The boxes of the answers on one box. @param {readonly OutboxItem[]} items */
const boxesOf = (items) => new Set(items.filter(isSingle).map(({ boxId }) => boxId));

/**
 * The revision of each box that the person saw. None for a bulk item on a filter.
 * @param {OutboxItem} item @returns {Map<number, number>}
 */
function revisionsSeenBy(item) {
  if (isSingle(item)) return new Map([[item.boxId, item.seenRevision]]);
  return new Map(item.boxIds?.map((boxId, i) => [boxId, item.seenRevisions?.[i] ?? 0]));
}
