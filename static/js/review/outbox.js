// @ts-check
// Answers and acts that are not confirmed, kept in localStorage, sent one after the other in order.

import { seenRevision } from "../boxes/box.js";
import { REMOTE } from "../boxes/store.js";
import { ApiError, NoAnswer, post } from "../core/api.js";
import { createValue } from "../core/observable.js";

/** @typedef {import("../core/types.js").Answer} Answer */
/** @typedef {import("../core/types.js").Decision} Decision */
/** @typedef {import("../core/types.js").StoredReview} StoredReview */

/**
 * @typedef {object} QueuedAnswer
 * @property {string} key  also the Idempotency-Key
 * @property {string} person  who gave it: it is sent under no other name
 * @property {string} tab  that sends it
 * @property {number} order
 * @property {number} boxId
 * @property {number} frameId
 * @property {Answer} verdict
 * @property {string} comment
 * @property {number} seenRevision
 * @property {boolean} attempted  may have reached the server: to be repeated word for word
 */

const PREFIX = "unghost.outbox.v1.";

/** @param {Storage} storage @param {string} tab @param {() => string} who  answers now @param {() => string} [newKey] */
export function createOutbox(storage, tab, who, newKey = () => crypto.randomUUID()) {
  /** @param {QueuedAnswer} item */
  const write = (item) => storage.setItem(PREFIX + item.key, JSON.stringify(item));

  const everyone = () => storedItems(storage);

  const mine = () => everyone().filter((item) => item.tab === tab && item.person === who());

  return {
    /** This person's answers in this tab, in the order in which they were given. */
    items: mine,

    /**
     * An answer that has not been sent is replaced; one that may have arrived is followed.
     * @param {{boxId: number, frameId: number, verdict: Answer, comment: string, seenRevision: number}} answer  of whoever answers now
     */
    add(answer) {
      const waiting = mine();
      const same = waiting.find((item) => item.boxId === answer.boxId && !item.attempted);
      if (same) {
        storage.removeItem(PREFIX + same.key);
        write({ ...same, key: newKey(), verdict: answer.verdict, comment: answer.comment });
        return;
      }
      const order = Math.max(0, ...waiting.map((item) => item.order)) + 1;
      write({ ...answer, key: newKey(), person: who(), tab, order, attempted: false });
    },

    /** How many answers of each person are kept in this browser, by any tab. @returns {Map<string, number>} */
    kept() {
      /** @type {Map<string, number>} */
      const counts = new Map();
      for (const { person } of everyone()) if (person) counts.set(person, (counts.get(person) ?? 0) + 1);
      return counts;
    },

    /** @param {QueuedAnswer} item */
    markAttempted: (item) => write({ ...item, attempted: true }),

    /** @param {QueuedAnswer} item */
    remove: (item) => storage.removeItem(PREFIX + item.key),

    /** What waits for this box has now seen that revision. @param {number} boxId @param {number} revision */
    rebase(boxId, revision) {
      for (const item of mine()) if (item.boxId === boxId) write({ ...item, seenRevision: revision });
    },

    /** Take over what closed tabs have left behind. @param {ReadonlySet<string>} openTabs */
    adopt(openTabs) {
      for (const item of everyone()) if (item.tab !== tab && !openTabs.has(item.tab)) write({ ...item, tab });
    },
  };
}

/** @typedef {ReturnType<typeof createOutbox>} Outbox */

/** @param {Storage} storage @returns {QueuedAnswer[]} */
function storedItems(storage) {
  const items = [];
  for (let i = 0; i < storage.length; i++) {
    const name = storage.key(i);
    if (name?.startsWith(PREFIX)) items.push(parsed(storage.getItem(name)));
  }
  return items.filter((item) => item !== null).sort((a, b) => a.order - b.order);
}

/** @param {string | null} text @returns {QueuedAnswer | null} */
function parsed(text) {
  try {
    const item = JSON.parse(text ?? "");
    return typeof item?.boxId === "number" ? item : null;
  } catch {
    return null;
  }
}

const TAB_LOCK = "unghost-tab-";

/**
 * A name for this tab that survives a reload, held as a lock as long as the tab is open.
 * A duplicated tab starts with the other's name, finds the lock taken, and gets its own.
 * @returns {Promise<{tab: string, openTabs: Set<string>}>}
 */
export async function nameThisTab() {
  const remembered = sessionStorage.getItem("unghost.tab") ?? crypto.randomUUID();
  const tab = (await holdLock(TAB_LOCK + remembered)) ? remembered : crypto.randomUUID();
  if (tab !== remembered) await holdLock(TAB_LOCK + tab);
  sessionStorage.setItem("unghost.tab", tab);
  const { held = [] } = (await navigator.locks?.query()) ?? {};
  const names = held.map(({ name = "" }) => name).filter((name) => name.startsWith(TAB_LOCK));
  return { tab, openTabs: new Set(names.map((name) => name.slice(TAB_LOCK.length))) };
}

/** @param {string} name @returns {Promise<boolean>} true without locks, too: there they cannot be asked for */
function holdLock(name) {
  if (!navigator.locks) return Promise.resolve(true);
  return new Promise((resolve) => {
    navigator.locks.request(name, { ifAvailable: true }, (lock) => {
      resolve(lock !== null);
      return lock === null ? undefined : new Promise(() => {});
    });
  });
}

/** @typedef {{id: number, count: number, skipped: number[], stale: number[]}} BulkOut  `stale`: answered by somebody since they were seen */
/** @typedef {{id: number, undone: number, skipped: number[]}} UndoOut */
/** @typedef {Record<string, string | number | boolean>} Filter */

/**
 * @typedef {object} Act
 * @property {string} key  also the Idempotency-Key
 * @property {string} person  who did it: it is sent under no other name
 * @property {string} tab  that sends it
 * @property {string} dataset
 * @property {Answer} verdict
 * @property {number[]} [boxIds]
 * @property {number[]} [seen]  the revision of each of these boxes that the person saw
 * @property {Filter} [filter]  all that it selects, as long as they are as in the snapshot
 * @property {string} [snapshot]  of the list that the person saw
 * @property {number} count
 */

/** @typedef {"sending" | "waiting" | "changed" | "refused"} ActState */
/** @typedef {{act: Act, state: ActState, text: string}} OpenAct */
/** @typedef {{batchId: number, act: Act, skipped: number[], stale: number[]}} DoneAct */

/**
 * @typedef {object} BulkCalls
 * @property {(act: Act) => Promise<BulkOut>} send
 * @property {(batchId: number) => Promise<UndoOut>} undo
 */

/**
 * @typedef {object} BulkEvents
 * @property {(done: DoneAct) => void} onDone
 * @property {(act: Act) => void} onGivenUp
 * @property {(batchId: number, out: UndoOut) => void} onUndone
 * @property {(error: unknown, batchId?: number) => void} onError  `batchId`: it could not be undone
 */

const BULK_PREFIX = "unghost.bulk.v1.";

/**
 * @param {Storage} storage @param {string} tab @param {() => string} who  acts now @param {BulkCalls} calls @param {BulkEvents} events
 * @param {() => string} [newKey]
 */
export function createBulk(storage, tab, who, calls, events, newKey = () => crypto.randomUUID()) {
  const open = createValue(/** @type {readonly OpenAct[]} */ ([]));

  /** @param {string} key */
  const find = (key) => open.get().find(({ act }) => act.key === key);

  /** @param {Act} act @param {ActState} state @param {string} [text] */
  function show(act, state, text = "") {
    const entry = { act, state, text };
    const isNew = !find(act.key);
    open.set(isNew ? [...open.get(), entry] : open.get().map((other) => (other.act.key === act.key ? entry : other)));
  }

  /** @param {Act} act */
  function drop(act) {
    storage.removeItem(BULK_PREFIX + act.key);
    open.set(open.get().filter((other) => other.act.key !== act.key));
  }

  /** @param {Act} act */
  async function deliver(act) {
    show(act, "sending");
    try {
      const out = await calls.send(act);
      drop(act);
      events.onDone({ batchId: out.id, act, skipped: out.skipped, stale: out.stale });
    } catch (error) {
      fail(act, error);
    }
  }

  /** @param {Act} act @param {unknown} error */
  function fail(act, error) {
    events.onError(error);
    const { message } = /** @type {Error} */ (error);
    if (!(error instanceof ApiError)) return show(act, "waiting", error instanceof NoAnswer ? "the server does not answer" : message);
    if (error.status === 401) return show(act, "waiting", "you are signed out");
    if (error.isTemporary) return show(act, "waiting", message);
    return show(act, error.problem.code === "stale_snapshot" ? "changed" : "refused", message);
  }

  /** @param {Omit<Act, "key" | "tab" | "person">} wanted @param {string} [key] */
  function start(wanted, key = newKey()) {
    const act = { ...wanted, key, tab, person: who() };
    storage.setItem(BULK_PREFIX + act.key, JSON.stringify(act));
    void deliver(act);
  }

  return {
    open,

    /** Boxes whose answer is not stored yet. */
    waitingIds: () => new Set(open.get().flatMap(({ act }) => act.boxIds ?? [])),

    start,

    /** @param {string} key */
    retry(key) {
      const entry = find(key);
      if (entry && entry.state !== "sending") void deliver(entry.act);
    },

    /** @param {string} key */
    giveUp(key) {
      const entry = find(key);
      if (!entry) return;
      drop(entry.act);
      events.onGivenUp(entry.act);
    },

    /** Try again what waits: the network is back, or somebody has signed in. */
    resume() {
      for (const { act, state } of open.get()) if (state === "waiting") void deliver(act);
    },

    /** @param {number} batchId @returns {Promise<boolean>} was it taken back? */
    async undo(batchId) {
      try {
        events.onUndone(batchId, await calls.undo(batchId));
        return true;
      } catch (error) {
        events.onError(error, batchId);
        return false;
      }
    },

    /** Take up what this person has left behind, in this tab or in closed ones. @param {ReadonlySet<string>} openTabs */
    adopt(openTabs) {
      for (const found of storedActs(storage)) {
        if (found.person !== who() || find(found.key)) continue;
        if (found.tab !== tab && openTabs.has(found.tab)) continue;
        const act = { ...found, tab };
        storage.setItem(BULK_PREFIX + act.key, JSON.stringify(act));
        open.set([...open.get(), waiting(act)]);
      }
    },
  };
}

/** @typedef {ReturnType<typeof createBulk>} Bulk */

/** @param {Act} act @returns {OpenAct} */
const waiting = (act) => ({ act, state: "waiting", text: "it was not sent before the page was closed" });

/** @param {Storage} storage @returns {Act[]} */
function storedActs(storage) {
  const names = Array.from({ length: storage.length }, (_, i) => storage.key(i) ?? "").filter((name) => name.startsWith(BULK_PREFIX));
  return names.flatMap((name) => {
    try {
      const act = JSON.parse(storage.getItem(name) ?? "");
      return typeof act?.key === "string" && typeof act.count === "number" ? [act] : [];
    } catch {
      return [];
    }
  });
}

/** One answer on many boxes, as they were seen. @param {Act} act @returns {Promise<BulkOut>} */
export function sendBulk({ key, dataset, verdict, boxIds, seen, filter, snapshot }) {
  const which = boxIds ? { box_ids: boxIds, seen_revisions: seen } : { filter, snapshot };
  return post("/reviews/bulk", { dataset, verdict, ...which }, key);
}

/** The same key for the same batch: a repeated request undoes once. @param {number} batchId @returns {Promise<UndoOut>} */
export const undoBulk = (batchId) => post(`/review-batches/${batchId}/undo`, {}, `undo-batch-${batchId}`);

const PREFIXES = ["unghost.outbox.v1.", "unghost.bulk.v1."];

/** @typedef {{name: string, item: {person?: string}}} Kept */

/** @param {Storage} storage @returns {Kept[]} */
export function unowned(storage) {
  const names = Array.from({ length: storage.length }, (_, i) => storage.key(i) ?? "");
  return names
    .filter((name) => PREFIXES.some((prefix) => name.startsWith(prefix)))
    .flatMap((name) => {
      try {
        const item = JSON.parse(storage.getItem(name) ?? "null");
        return item && !item.person ? [{ name, item }] : [];
      } catch {
        return [];
      }
    });
}

/** @param {Storage} storage @param {string} person  who says so */
export function own(storage, person) {
  for (const { name, item } of unowned(storage)) storage.setItem(name, JSON.stringify({ ...item, person }));
}

/** @typedef {"saved" | "saving" | "offline" | "signed-out" | "busy"} Phase */
/** @typedef {{phase: Phase, waiting: ReadonlySet<number>}} SaverState  `waiting`: the boxes */

/**
 * @typedef {object} SaverEvents
 * @property {(stored: StoredReview, isLatest: boolean) => void} onStored
 * @property {(item: QueuedAnswer, current: Decision | undefined) => void} onConflict  somebody else was first
 * @property {(item: QueuedAnswer, error: Error) => void} onRefused  will never be stored
 */

const FIRST_RETRY_S = 1;
const LONGEST_RETRY_S = 30;

/**
 * @param {Outbox} outbox
 * @param {(boxId: number, answer: {verdict: string, comment: string, seen_revision: number}, key: string) => Promise<StoredReview>} send
 * @param {SaverEvents} events
 * @param {(run: () => void, delayMs: number) => void} [later]
 */
export function createSaver(outbox, send, events, later = (run, delayMs) => void setTimeout(run, delayMs)) {
  /** @type {import("../core/observable.js").Value<SaverState>} */
  const state = createValue(stateNow("saved"));
  let isSending = false;
  /** Somebody said that it may work now, while an attempt from before was still failing. */
  let isWorthTrying = false;
  let retryS = FIRST_RETRY_S;
  let retries = 0;

  /** @param {Phase} phase @returns {SaverState} */
  function stateNow(phase) {
    const waiting = new Set(outbox.items().map(({ boxId }) => boxId));
    return { phase: waiting.size ? phase : "saved", waiting };
  }

  /** @param {Phase} phase */
  const show = (phase) => state.set(stateNow(phase));

  async function drain() {
    if (isSending) return;
    isSending = true;
    try {
      for (let item = outbox.items()[0]; item; item = outbox.items()[0]) {
        show("saving");
        if (!(await deliver(item))) return;
        retryS = FIRST_RETRY_S;
      }
      show("saved");
    } finally {
      isSending = false;
    }
  }

  /** @param {QueuedAnswer} item @returns {Promise<boolean>} go on with the next? */
  async function deliver(item) {
    const { boxId, verdict, comment, seenRevision: seen_revision } = item;
    outbox.markAttempted(item);
    try {
      const stored = await send(boxId, { verdict, comment, seen_revision }, item.key);
      outbox.remove(item);
      outbox.rebase(boxId, stored.revision);
      events.onStored(stored, !stateNow("saving").waiting.has(boxId));
      return true;
    } catch (error) {
      return settle(item, error);
    }
  }

  /** @param {QueuedAnswer} item @param {unknown} error */
  function settle(item, error) {
    if (error instanceof NoAnswer) return waitAndRetry("offline", retryS);
    if (!(error instanceof ApiError)) throw error;
    if (error.status === 401) {
      show("signed-out");
      return false;
    }
    if (error.isTemporary) return waitAndRetry("busy", error.retryAfterS ?? retryS);
    outbox.remove(item);
    if (error.status === 412) events.onConflict(item, error.problem.current);
    else events.onRefused(item, error);
    return true;
  }

  /** @param {Phase} phase @param {number} seconds */
  function waitAndRetry(phase, seconds) {
    show(phase);
    const mine = ++retries;
    const wait = isWorthTrying ? 0 : seconds;
    isWorthTrying = false;
    retryS = Math.min(retryS * 2, LONGEST_RETRY_S);
    later(() => mine === retries && void drain(), wait * 1000);
    return false;
  }

  return {
    state,

    /** @param {import("../boxes/store.js").Change} change */
    notice({ origin, before, after }) {
      if (origin === REMOTE) return;
      const verdict = after.review?.verdict ?? "clear";
      const comment = after.review?.comment ?? "";
      outbox.add({ boxId: after.box_id, frameId: after.frame_id, verdict, comment, seenRevision: seenRevision(before) });
      show(state.get().phase === "saved" ? "saving" : state.get().phase);
      if (state.get().phase !== "signed-out") void drain();
    },

    /** Try now: the network is back, or somebody has signed in. */
    resume() {
      isWorthTrying = isSending;
      retryS = FIRST_RETRY_S;
      return drain();
    },

    /** What waits for a frame's boxes, so that a reloaded page still shows it. @param {number} frameId */
    waitingFor: (frameId) => outbox.items().filter((item) => item.frameId === frameId),
  };
}

/** @typedef {ReturnType<typeof createSaver>} Saver */
