// @ts-check
// Answers that the server has not stored yet: on one box, on many (bulk answers), and undos of bulk answers. They are
// kept in localStorage. Each tab sends its own, one at a time, oldest first. A bulk answer that the person must look at
// again is set aside, and later answers are sent before it.

import { seenRevision } from "../boxes/box.js";
import { ApiError, NoResponse, createRetries, post } from "../core/api.js";
import { createValue } from "../core/observable.js";

/** @typedef {import("../boxes/box.js").Answer} Answer */
/** @typedef {import("../boxes/box.js").Decision} Decision */
/** @typedef {import("../boxes/store.js").GivenAnswer} GivenAnswer */
/** @typedef {import("../core/openapi.js").Review} StoredReview */

/**
 * @typedef {object} QueuedAnswer  on one box
 * @property {string} key  also the Idempotency-Key
 * @property {string} person  who gave it: it is sent under no other name
 * @property {string} tab  the id of the tab that sends it
 * @property {number} order  its place among the answers of its tab: the lowest is sent first
 * @property {number} boxId
 * @property {number} frameId
 * @property {Answer} verdict
 * @property {string} comment
 * @property {number} seenRevision
 * @property {boolean} attempted  may have reached the server: a retry must send exactly the same
 * @property {number} [ownRevision]  the box's revision after this person's earlier answer, if that was stored when this one had been attempted already; `seenRevision` stays, because a retry must be the same
 */

/** @typedef {import("../core/openapi.js").BoxSelection} Filter */

/**
 * @typedef {object} BulkAnswer  a bulk answer: one answer on many boxes
 * @property {string} key  also the Idempotency-Key
 * @property {string} person  who gave it: it is sent under no other name
 * @property {string} tab  the id of the tab that sends it
 * @property {number} order
 * @property {string} dataset
 * @property {Answer} verdict
 * @property {number[]} [boxIds]
 * @property {number[]} [seen]  the revision of each of these boxes that the person saw
 * @property {Filter} [filter]  instead of `boxIds`: all boxes that match it, if they have not changed since the snapshot
 * @property {string} [snapshot]  identifies the state of the list that the person saw
 * @property {number} count  of boxes
 * @property {boolean} [attempted]  may have reached the server: a retry must send exactly the same
 */

/**
 * @typedef {object} Undo  of a bulk answer as a whole
 * @property {string} key
 * @property {string} person
 * @property {string} tab
 * @property {number} order
 * @property {string} dataset
 * @property {string} act  the key of the bulk answer
 * @property {number | null} batch  the bulk answer's id on the server; null until the server has stored the bulk answer, which is sent first
 * @property {number[]} [boxIds]  the boxes that get their earlier answers again; missing if the page does not know them
 * @property {number[]} [seen]  the revision of each of these boxes that the person saw
 * @property {GivenAnswer[]} before  the earlier answer on each of these boxes
 * @property {number} count  of boxes
 */

/** @typedef {QueuedAnswer | BulkAnswer | Undo} Item */
/** @typedef {Omit<BulkAnswer, "key" | "tab" | "person" | "order" | "attempted">} WantedBulkAnswer */
/** @typedef {Omit<Undo, "key" | "tab" | "person" | "order">} WantedUndo */

const ANSWER_PREFIX = "unghost.outbox.v1.";
const BULK_PREFIX = "unghost.bulk.v1.";
const UNDO_PREFIX = "unghost.undo.v1.";

/** @param {string} name */
const isOurs = (name) => [ANSWER_PREFIX, BULK_PREFIX, UNDO_PREFIX].some((prefix) => name.startsWith(prefix));

/** @param {Item} item @returns {item is QueuedAnswer} */
const isSingle = (item) => "boxId" in item;

/** @param {Item} item @returns {item is Undo} */
export const isUndo = (item) => "act" in item;

/** @param {Item} item @returns {item is BulkAnswer | Undo} */
const isMany = (item) => !isSingle(item);

/** @param {Item} item @returns {item is BulkAnswer} */
const isBulkAnswer = (item) => isMany(item) && !isUndo(item);

/** @param {Item} item */
const nameOf = (item) => (isSingle(item) ? ANSWER_PREFIX : isUndo(item) ? UNDO_PREFIX : BULK_PREFIX) + item.key;

/** How many answers it is. @param {Item} item */
const sizeOf = (item) => (isSingle(item) ? 1 : item.count);

/** Whether this bulk answer or undo may change the answer on the box. Always true for one on a filter: the page does not know which boxes the filter selects. @param {BulkAnswer | Undo} many @param {number} boxId */
const mayHaveAnswered = (many, boxId) => many.boxIds === undefined || many.boxIds.includes(boxId);

/** @param {Storage} storage @param {string} tab @param {() => string} who  returns the person who is signed in @param {() => string} [newKey] */
export function createOutbox(storage, tab, who, newKey = randomId) {
  /** @param {Item} item */
  const write = (item) => storage.setItem(nameOf(item), JSON.stringify(item));

  const everyone = () => storedItems(storage);

  const mine = () => everyone().filter((item) => item.tab === tab && item.person === who());

  /** @param {Item[]} waiting */
  const nextOrder = (waiting) => Math.max(0, ...waiting.map((item) => item.order)) + 1;

  return {
    /** The answers that this person gave in this tab and that are not stored yet, in their order. */
    items: mine,

    /** The last answer on each box. Bulk answers on a filter are left out: the page does not know which boxes they select. @returns {Map<number, {verdict: Answer, comment: string}>} */
    given() {
      /** @type {Map<number, GivenAnswer>} */
      const last = new Map();
      for (const item of mine()) {
        if (isSingle(item)) last.set(item.boxId, { verdict: item.verdict, comment: item.comment });
        else if (isUndo(item)) item.boxIds?.forEach((boxId, i) => last.set(boxId, item.before[i] ?? { verdict: "clear", comment: "" }));
        else for (const boxId of item.boxIds ?? []) last.set(boxId, { verdict: item.verdict, comment: "" });
      }
      return last;
    },

    /** The bulk answers, and undos of bulk answers, among `items`. */
    many: () => mine().filter(isMany),

    /** @param {string} key @returns {BulkAnswer | undefined} */
    bulkAnswer: (key) => mine().filter(isBulkAnswer).find((bulk) => bulk.key === key),

    /** The undo of this bulk answer, if there is one. @param {string} key */
    undoOf: (key) => mine().find((item) => isUndo(item) && item.act === key),

    /**
     * Queue an answer on one box. It replaces this person's earlier answer on the box, if that was never sent and no
     * bulk answer on the box was queued since. An earlier answer that may have reached the server stays, and is sent first.
     * @param {{boxId: number, frameId: number, verdict: Answer, comment: string, seenRevision: number}} answer  of the person who is signed in
     */
    add(answer) {
      const waiting = mine();
      const last = waiting.findLast((item) => (isSingle(item) ? item.boxId === answer.boxId : mayHaveAnswered(item, answer.boxId)));
      if (last && isSingle(last) && !last.attempted) {
        write({ ...last, key: newKey(), verdict: answer.verdict, comment: answer.comment });
        storage.removeItem(nameOf(last));
        return;
      }
      write({ ...answer, key: newKey(), person: who(), tab, order: nextOrder(waiting), attempted: false });
    },

    /** @param {WantedBulkAnswer} bulk @param {string} [key] */
    addBulkAnswer: (bulk, key = newKey()) => write({ ...bulk, key, person: who(), tab, order: nextOrder(mine()), attempted: false }),

    /** @param {WantedUndo} undo */
    addUndo: (undo) => write({ ...undo, key: newKey(), person: who(), tab, order: nextOrder(mine()) }),

    /** A bulk answer was stored. Puts the server's id into its undo, and removes the boxes from the undo that the bulk answer left out. @param {BulkAnswer} bulk @param {number} batch @param {readonly number[]} leftOut */
    setStored(bulk, batch, leftOut) {
      const out = new Set(leftOut);
      for (const item of mine()) {
        if (!isUndo(item) || item.act !== bulk.key) continue;
        const { boxIds, seen, before } = item;
        /** @type {<T>(values: T[]) => T[]} */
        const kept = (values) => values.filter((_, i) => !out.has(boxIds?.[i] ?? 0));
        write({ ...item, batch, before: kept(before), ...(boxIds && seen ? { boxIds: kept(boxIds), seen: kept(seen) } : {}) });
      }
    },

    /** How many answers of each person are kept in this browser, by any tab. @returns {Map<string, number>} */
    kept() {
      /** @type {Map<string, number>} */
      const counts = new Map();
      for (const item of everyone()) if (item.person) counts.set(item.person, (counts.get(item.person) ?? 0) + sizeOf(item));
      return counts;
    },

    /** @param {QueuedAnswer | BulkAnswer} item */
    markAttempted: (item) => write({ ...item, attempted: true }),

    /** Queue an answer again that the server has not stored, now with this seen revision. @param {QueuedAnswer} item @param {number} revision */
    requeue(item, revision) {
      storage.removeItem(nameOf(item));
      write({ ...item, key: newKey(), seenRevision: revision, ownRevision: undefined, attempted: false });
    },

    /** @param {Item} item */
    remove: (item) => storage.removeItem(nameOf(item)),

    /**
     * Put these revisions into the answers that this person has given after `earlier`. An attempted bulk answer is left
     * as it is.
     * @param {Item} earlier @param {ReadonlyMap<number, number>} revisions  by box
     */
    setSeenRevisions(earlier, revisions) {
      for (const item of mine()) {
        if (item.order <= earlier.order) continue;
        if (isSingle(item)) {
          const revision = revisions.get(item.boxId);
          if (revision !== undefined) write({ ...item, [item.attempted ? "ownRevision" : "seenRevision"]: revision });
        } else if (item.seen && !(isBulkAnswer(item) && item.attempted) && item.boxIds?.some((boxId) => revisions.has(boxId))) {
          write({ ...item, seen: item.seen.map((before, i) => revisions.get(item.boxIds?.[i] ?? 0) ?? before) });
        }
      }
    },

    /** Take over unsent answers of closed tabs, of all people. @param {OpenTabs} openTabs */
    adopt(openTabs) {
      for (const item of everyone()) if (item.tab !== tab && !openTabs.has(item.tab)) write({ ...item, tab });
    },
  };
}

/** @typedef {ReturnType<typeof createOutbox>} Outbox */

/** @param {Storage} storage @returns {Item[]} in their order */
function storedItems(storage) {
  const names = Array.from({ length: storage.length }, (_, i) => storage.key(i) ?? "").filter(isOurs);
  const items = names.map((name) => parsed(name, storage.getItem(name)));
  return items.filter((item) => item !== null).sort((a, b) => a.order - b.order);
}

/** @param {string} name @param {string | null} text @returns {Item | null} */
function parsed(name, text) {
  try {
    const item = JSON.parse(text ?? "");
    if (name.startsWith(ANSWER_PREFIX)) return typeof item?.boxId === "number" ? item : null;
    // Bulk answers that an earlier version of the page has kept have no order: they go first.
    return typeof item?.key === "string" && typeof item.count === "number" ? { order: 0, ...item } : null;
  } catch {
    return null;
  }
}

/** 128 random bits. (`crypto.randomUUID` and `navigator.locks` are missing on pages that are not served securely.) */
export const randomId = () => Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");

const TAB_LOCK = "unghost-tab-";

/** @typedef {Pick<ReadonlySet<string>, "has">} OpenTabs */

/**
 * A name for this tab that survives a reload, held as a lock as long as the tab is open.
 * A duplicated tab starts with the other's name, finds the lock taken, and gets its own.
 * @returns {Promise<{tab: string, openTabs: () => Promise<OpenTabs>}>}  `openTabs`: those that are open now
 */
export async function nameThisTab() {
  const remembered = sessionStorage.getItem("unghost.tab") ?? randomId();
  const tab = (await holdLock(TAB_LOCK + remembered)) ? remembered : randomId();
  if (tab !== remembered) await holdLock(TAB_LOCK + tab);
  sessionStorage.setItem("unghost.tab", tab);
  let isFirst = true;
  return {
    tab,
    async openTabs() {
      const isStart = isFirst;
      isFirst = false;
      // Without locks nobody knows. Then this tab takes over what others have left when it is opened, and nothing later.
      if (!navigator.locks) return { has: () => !isStart };
      const { held = [] } = await navigator.locks.query();
      return new Set(held.map(({ name = "" }) => name.slice(TAB_LOCK.length)));
    },
  };
}

/** @param {string} name @returns {Promise<boolean>} true also in browsers without locks */
function holdLock(name) {
  if (!navigator.locks) return Promise.resolve(true);
  return new Promise((resolve) => {
    navigator.locks.request(name, { ifAvailable: true }, (lock) => {
      resolve(lock !== null);
      return lock === null ? undefined : new Promise(() => {});
    });
  });
}

/** @typedef {{id: number, count: number, skipped: number[], stale: number[]}} BulkOut  `stale`: boxes that were answered since they were seen */
/** @typedef {{id: number, undone: number, skipped: number[]}} UndoOut */
/** @typedef {"sending" | "waiting" | "changed" | "refused"} ManyState  `changed` and `refused` wait for the person to decide */
/** @typedef {{item: BulkAnswer | Undo, state: ManyState, text: string}} OpenItem */
/** @typedef {{batchId: number, bulk: BulkAnswer, skipped: number[], stale: number[]}} StoredBulkAnswer */
/** @typedef {"saved" | "saving" | "offline" | "signed-out" | "busy"} Phase */
/** @typedef {{phase: Phase, waiting: ReadonlySet<number>, count: number}} SenderState  `waiting`: boxes with an unsaved single answer; `count`: these boxes, and those of each bulk answer and undo */

/**
 * @typedef {object} SenderCalls
 * @property {(boxId: number, answer: {verdict: Answer, comment: string, seen_revision: number}, key: string) => Promise<StoredReview>} answer
 * @property {(bulk: BulkAnswer) => Promise<BulkOut>} answerMany
 * @property {(undo: Undo) => Promise<UndoOut>} undo
 */

/**
 * @typedef {object} SenderEvents
 * @property {(stored: StoredReview) => void} onStored
 * @property {(item: QueuedAnswer, current: Decision | null) => void} onConflict  the box was answered since this person saw it
 * @property {(item: QueuedAnswer, error: Error) => void} onRefused  the server will never store it
 * @property {(done: StoredBulkAnswer) => void} onDone
 * @property {(bulk: BulkAnswer) => void} onGivenUp
 * @property {(undo: Undo, out: UndoOut) => void} onUndone
 * @property {(undo: Undo, error: Error) => void} onUndoRefused  the server will never do it
 * @property {() => void} onSignedOut  the server stores nothing until somebody signs in
 */

/**
 * Sends the answers in the outbox, oldest first, one at a time. Each waits until those before it are stored or
 * refused. A bulk answer that needs a decision of the person is set aside, and the others go on.
 * @param {Outbox} outbox @param {SenderCalls} calls @param {SenderEvents} events
 * @param {import("../core/api.js").Later} [later]
 */
export function createSender(outbox, calls, events, later) {
  /** The state of bulk answers and undos that are not stored, by their keys. @type {Map<string, {state: ManyState, text: string}>} */
  const told = new Map();
  const open = createValue(/** @type {readonly OpenItem[]} */ ([]));
  /** @type {import("../core/observable.js").Value<SenderState>} */
  const state = createValue(stateNow("saved"));
  /** Boxes of bulk answers, and of their undos, that are not stored. @type {ReadonlySet<number>} */
  let inMany = new Set();
  let isSending = false;
  /** If the answer that is being sent fails, send it again at once, because `resume` was called meanwhile. */
  let isWorthTrying = false;
  const retries = createRetries(later);
  /** The `order` of the last stored bulk answer on a filter, or of its undo. The page does not know which boxes it answered. */
  let lastOnFilter = 0;

  /** Whether it was set aside, until the person decides. @param {Item} item */
  function isAside(item) {
    return ["changed", "refused"].includes(told.get(item.key)?.state ?? "");
  }

  /** @param {Phase} phase @returns {SenderState} */
  function stateNow(phase) {
    const items = outbox.items().filter((item) => !isAside(item));
    const waiting = new Set(items.flatMap((item) => (isSingle(item) ? [item.boxId] : [])));
    const count = waiting.size + items.reduce((sum, item) => sum + (isSingle(item) ? 0 : item.count), 0);
    return { phase: items.length ? phase : "saved", waiting, count };
  }

  /** @param {Phase} phase */
  function show(phase) {
    state.set(stateNow(phase));
    const many = outbox.many();
    inMany = new Set(many.flatMap(({ boxIds = [] }) => boxIds));
    open.set(many.map((item) => ({ item, ...(told.get(item.key) ?? { state: "sending", text: "" }) })));
  }

  /** Set the text that says why bulk answers and undos are waiting. @param {string} text */
  function sayWaiting(text) {
    for (const item of outbox.many()) if (!isAside(item)) told.set(item.key, { state: "waiting", text });
  }

  async function drain() {
    if (isSending) return;
    isSending = true;
    try {
      for (let item = next(); item; item = next()) {
        told.delete(item.key);
        show("saving");
        if (!(await deliver(item))) return;
        retries.reset();
      }
      show("saved");
    } finally {
      isSending = false;
    }
  }

  const next = () => outbox.items().find((item) => !isAside(item));

  /** @param {Item} item @returns {Promise<boolean>} go on with the next? */
  async function deliver(item) {
    try {
      if (isSingle(item)) await sendAnswer(item);
      else if (isUndo(item)) await sendUndo(item);
      else await sendBulkAnswer(item);
      return true;
    } catch (error) {
      return afterError(item, error);
    }
  }

  /** @param {QueuedAnswer} item */
  async function sendAnswer(item) {
    const { boxId, verdict, comment, seenRevision: seen_revision } = item;
    outbox.markAttempted(item);
    const stored = await calls.answer(boxId, { verdict, comment, seen_revision }, item.key);
    outbox.remove(item);
    outbox.setSeenRevisions(item, new Map([[boxId, stored.revision]]));
    events.onStored(stored);
  }

  /** @param {BulkAnswer} bulk */
  async function sendBulkAnswer(bulk) {
    outbox.markAttempted(bulk);
    const out = await calls.answerMany(bulk);
    outbox.remove(bulk);
    outbox.setStored(bulk, out.id, [...out.stale, ...out.skipped]);
    answered(bulk, out.stale);
    events.onDone({ batchId: out.id, bulk, skipped: out.skipped, stale: out.stale });
  }

  /** @param {Undo} undo */
  async function sendUndo(undo) {
    const out = await calls.undo(undo);
    outbox.remove(undo);
    answered(undo, out.skipped);
    events.onUndone(undo, out);
  }

  /** A bulk answer or undo was stored: later answers have seen the new revisions of its boxes. @param {BulkAnswer | Undo} item @param {readonly number[]} but  boxes that it has left out */
  function answered(item, but) {
    const { boxIds, seen = [] } = item;
    if (!boxIds) lastOnFilter = item.order;
    const left = new Set(but);
    const revisions = new Map(boxIds?.map((boxId, i) => [boxId, (seen[i] ?? 0) + 1]));
    left.forEach((boxId) => revisions.delete(boxId));
    outbox.setSeenRevisions(item, revisions);
  }

  /** @param {Item} item @param {unknown} error @returns {boolean} go on with the next? */
  function afterError(item, error) {
    if (error instanceof NoResponse) return waitAndRetry("offline", null, "the server does not answer");
    if (!(error instanceof ApiError)) {
      // A fault of this page. The answer is kept, and sent again all the same.
      waitAndRetry("busy", null, error instanceof Error ? error.message : String(error));
      throw error;
    }
    if (error.status === 401) {
      sayWaiting("you are signed out");
      show("signed-out");
      events.onSignedOut();
      return false;
    }
    if (error.isTemporary) return waitAndRetry("busy", error.retryAfterS, error.message);
    if (isBulkAnswer(item)) {
      told.set(item.key, { state: error.problem.code === "stale_snapshot" ? "changed" : "refused", text: error.message });
      leftOut(item);
      if (outbox.undoOf(item.key)) giveUp(item.key);
      return true;
    }
    if (isUndo(item)) {
      outbox.remove(item);
      leftOut(item);
      events.onUndoRefused(item, error);
      return true;
    }
    const current = error.status === 412 ? (error.problem.current ?? null) : null;
    if (current && isOwn(item, current)) {
      outbox.requeue(item, seenRevision(current));
      return true;
    }
    outbox.remove(item);
    leftOut(item);
    if (error.status === 412) events.onConflict(item, current);
    else events.onRefused(item, error);
    return true;
  }

  /**
   * Whether the conflict is with this person's own earlier answer. That happens in two cases: the earlier one was
   * stored after the item had been attempted; or it was a bulk answer on a filter, or its undo. (The page does not know
   * which boxes a filter selects, so the item has an older revision. After an undo a box may have no answer.)
   * @param {QueuedAnswer} item @param {Decision} current
   */
  function isOwn(item, current) {
    if (seenRevision(current) === item.ownRevision) return true;
    return lastOnFilter > 0 && item.order > lastOnFilter && (current.review?.reviewer ?? item.person) === item.person;
  }

  /** The item was not stored: give this person's later answers the revisions that it had. @param {Item} item */
  function leftOut(item) {
    const { boxIds, seen } = isSingle(item) ? { boxIds: [item.boxId], seen: [item.seenRevision] } : item;
    outbox.setSeenRevisions(item, new Map(boxIds?.map((boxId, i) => [boxId, seen?.[i] ?? 0])));
  }

  /** @param {Phase} phase @param {number | null} seconds  as the server has asked @param {string} text */
  function waitAndRetry(phase, seconds, text) {
    sayWaiting(text);
    show(phase);
    retries.wait(() => void drain(), isWorthTrying ? 0 : seconds);
    isWorthTrying = false;
    return false;
  }

  /** Something was added: send it, unless nobody is signed in. */
  function more() {
    const { phase } = state.get();
    if (phase === "signed-out") sayWaiting("you are signed out");
    show(phase === "saved" ? "saving" : phase);
    if (phase !== "signed-out") void drain();
  }

  /** Try now: the network is back, or somebody has signed in. */
  function resume() {
    isWorthTrying = isSending;
    retries.reset();
    return drain();
  }

  /** Discard a bulk answer, and its undo. @param {string} key */
  function giveUp(key) {
    const bulk = outbox.bulkAnswer(key);
    if (!bulk) return;
    const undo = outbox.undoOf(key);
    if (undo) {
      outbox.remove(undo);
      told.delete(undo.key);
    }
    outbox.remove(bulk);
    // If it was set aside, later answers got their revisions then, and people may have answered the boxes since.
    if (!isAside(bulk)) leftOut(bulk);
    told.delete(key);
    show(state.get().phase);
    events.onGivenUp(bulk);
  }

  show("saved");

  return {
    state,
    /** The bulk answers, and undos of bulk answers, that are not stored. */
    open,
    resume,

    /** An answer that a person has given. @param {Parameters<Outbox["add"]>[0]} answer */
    answer(answer) {
      outbox.add(answer);
      more();
    },

    /** @param {WantedBulkAnswer} bulk @param {string} [key] */
    start(bulk, key) {
      outbox.addBulkAnswer(bulk, key);
      more();
    },

    /** Send a bulk answer or undo again that was set aside or is waiting. @param {string} key */
    retry(key) {
      told.delete(key);
      return resume();
    },

    giveUp,

    /** Undo a bulk answer. If the server cannot have stored it, it is discarded; else the undo is put into the outbox. @param {WantedUndo} undo */
    undo(undo) {
      const bulk = outbox.bulkAnswer(undo.act);
      if (bulk && (isAside(bulk) || !bulk.attempted)) return giveUp(bulk.key);
      outbox.addUndo(undo);
      more();
    },

    /** Boxes of bulk answers, and of their undos, that are not stored. */
    waitingIds: () => inMany,

    /** Take over the unsent answers of closed tabs. `resume` sends those of this person, with those that this tab had before a reload. @param {OpenTabs} openTabs */
    adopt(openTabs) {
      outbox.adopt(openTabs);
      for (const { key } of outbox.many()) {
        if (!told.has(key)) told.set(key, { state: "waiting", text: "it was not sent before the page was closed" });
      }
      show(state.get().phase);
    },
  };
}

/** @typedef {ReturnType<typeof createSender>} Sender */

/** One answer on many boxes, as they were seen. @param {BulkAnswer} bulk @returns {Promise<BulkOut>} */
export function sendBulk({ key, dataset, verdict, boxIds, seen, filter, snapshot }) {
  const which = boxIds ? { box_ids: boxIds, seen_revisions: seen } : { filter, snapshot };
  return post("/api/v1/reviews/bulk", { body: { dataset, verdict, ...which }, key });
}

/** The key is made from the batch, so that repeated requests undo it once. @param {Undo} undo @returns {Promise<UndoOut>} */
export const undoBulk = ({ batch }) => post("/api/v1/review-batches/{batch_id}/undo", { path: { batch_id: batch ?? 0 }, key: `undo-batch-${batch}` });

/** Answers that an earlier version of the page has kept without the person who gave them. @param {Storage} storage */
const unowned = (storage) => storedItems(storage).filter((item) => !item.person);

/** How many answers do not say who gave them. @param {Storage} storage */
export const countUnowned = (storage) => unowned(storage).reduce((sum, item) => sum + sizeOf(item), 0);

/** Store them under this person's name. @param {Storage} storage @param {string} person */
export function own(storage, person) {
  for (const item of unowned(storage)) storage.setItem(nameOf(item), JSON.stringify({ ...item, person }));
}

/** Discard them. @param {Storage} storage */
export function discardUnowned(storage) {
  for (const item of unowned(storage)) storage.removeItem(nameOf(item));
}
