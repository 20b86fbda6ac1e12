// @ts-check
// What people said and the server has not confirmed: answers on one box and acts on many, in one
// line, kept in localStorage, sent one after the other in the order in which they were given.

import { seenRevision } from "../boxes/box.js";
import { ApiError, NoAnswer, post } from "../core/api.js";
import { createValue } from "../core/observable.js";

/** @typedef {import("../boxes/box.js").Answer} Answer */
/** @typedef {import("../boxes/box.js").Decision} Decision */
/** @typedef {import("../core/openapi.js").Review} StoredReview */

/**
 * @typedef {object} QueuedAnswer  on one box
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

/** @typedef {import("../core/openapi.js").BoxSelection} Filter */

/**
 * @typedef {object} Act  one answer on many boxes
 * @property {string} key  also the Idempotency-Key
 * @property {string} person  who did it: it is sent under no other name
 * @property {string} tab  that sends it
 * @property {number} order
 * @property {string} dataset
 * @property {Answer} verdict
 * @property {number[]} [boxIds]
 * @property {number[]} [seen]  the revision of each of these boxes that the person saw
 * @property {Filter} [filter]  all that it selects, as long as they are as in the snapshot
 * @property {string} [snapshot]  of the list that the person saw
 * @property {number} count
 */

/** @typedef {QueuedAnswer | Act} Item */
/** @typedef {Omit<Act, "key" | "tab" | "person" | "order">} WantedAct */

const ANSWER_PREFIX = "unghost.outbox.v1.";
const ACT_PREFIX = "unghost.bulk.v1.";

/** @param {string} name */
const isOurs = (name) => name.startsWith(ANSWER_PREFIX) || name.startsWith(ACT_PREFIX);

/** @param {Item} item @returns {item is Act} */
const isAct = (item) => "count" in item;

/** @param {Item} item */
const nameOf = (item) => (isAct(item) ? ACT_PREFIX : ANSWER_PREFIX) + item.key;

/** May this act answer the box? Of a filter nobody knows here which boxes it selects. @param {Act} act @param {number} boxId */
const mayAnswer = (act, boxId) => act.boxIds === undefined || act.boxIds.includes(boxId);

/** @param {Storage} storage @param {string} tab @param {() => string} who  answers now @param {() => string} [newKey] */
export function createOutbox(storage, tab, who, newKey = () => crypto.randomUUID()) {
  /** @param {Item} item */
  const write = (item) => storage.setItem(nameOf(item), JSON.stringify(item));

  const everyone = () => storedItems(storage);

  const mine = () => everyone().filter((item) => item.tab === tab && item.person === who());

  /** @param {Item[]} waiting */
  const nextOrder = (waiting) => Math.max(0, ...waiting.map((item) => item.order)) + 1;

  return {
    /** What this person said in this tab, in the order in which it was said. */
    items: mine,

    /** What was said of each box last. Of an act on a whole filter nobody knows here which boxes it selects. @returns {Map<number, {verdict: Answer, comment: string}>} */
    given() {
      /** @type {Map<number, {verdict: Answer, comment: string}>} */
      const last = new Map();
      for (const item of mine()) {
        if (!isAct(item)) last.set(item.boxId, { verdict: item.verdict, comment: item.comment });
        else for (const boxId of item.boxIds ?? []) last.set(boxId, { verdict: item.verdict, comment: "" });
      }
      return last;
    },

    /** The acts on many boxes among them. @returns {Act[]} */
    acts: () => mine().filter(isAct),

    /**
     * An answer that has not been sent is replaced, unless the box was part of an act since; one that may have arrived is followed.
     * @param {{boxId: number, frameId: number, verdict: Answer, comment: string, seenRevision: number}} answer  of whoever answers now
     */
    add(answer) {
      const waiting = mine();
      const last = waiting.findLast((item) => (isAct(item) ? mayAnswer(item, answer.boxId) : item.boxId === answer.boxId));
      if (last && !isAct(last) && !last.attempted) {
        storage.removeItem(nameOf(last));
        write({ ...last, key: newKey(), verdict: answer.verdict, comment: answer.comment });
        return;
      }
      write({ ...answer, key: newKey(), person: who(), tab, order: nextOrder(waiting), attempted: false });
    },

    /** @param {WantedAct} act @param {string} [key] */
    addAct: (act, key = newKey()) => write({ ...act, key, person: who(), tab, order: nextOrder(mine()) }),

    /** How many answers of each person are kept in this browser, by any tab. @returns {Map<string, number>} */
    kept() {
      /** @type {Map<string, number>} */
      const counts = new Map();
      for (const item of everyone()) if (item.person) counts.set(item.person, (counts.get(item.person) ?? 0) + (isAct(item) ? item.count : 1));
      return counts;
    },

    /** @param {QueuedAnswer} item */
    markAttempted: (item) => write({ ...item, attempted: true }),

    /** It was not stored: once more, having seen this revision. @param {QueuedAnswer} item @param {number} revision */
    again(item, revision) {
      storage.removeItem(nameOf(item));
      write({ ...item, key: newKey(), seenRevision: revision, attempted: false });
    },

    /** @param {Item} item */
    remove: (item) => storage.removeItem(nameOf(item)),

    /** What was said of this box later has now seen that revision. @param {Item} than @param {number} boxId @param {number} revision */
    rebase(than, boxId, revision) {
      for (const item of mine()) {
        if (item.order <= than.order) continue;
        if (!isAct(item)) {
          if (item.boxId === boxId) write({ ...item, seenRevision: revision });
          continue;
        }
        const at = item.boxIds?.indexOf(boxId) ?? -1;
        if (at >= 0 && item.seen) write({ ...item, seen: item.seen.with(at, revision) });
      }
    },

    /** Take over what closed tabs have left behind. @param {ReadonlySet<string>} openTabs */
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
    // Acts that an earlier version of the page has kept have no order: they go first.
    return typeof item?.key === "string" && typeof item.count === "number" ? { order: 0, ...item } : null;
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
/** @typedef {"sending" | "waiting" | "changed" | "refused"} ActState  `changed` and `refused` wait for the person to decide */
/** @typedef {{act: Act, state: ActState, text: string}} OpenAct */
/** @typedef {{batchId: number, act: Act, skipped: number[], stale: number[]}} DoneAct */
/** @typedef {"saved" | "saving" | "offline" | "signed-out" | "busy"} Phase */
/** @typedef {{phase: Phase, waiting: ReadonlySet<number>, count: number}} SenderState  `waiting`: boxes with an answer of their own; `count`: answers in all */

/**
 * @typedef {object} SenderCalls
 * @property {(boxId: number, answer: {verdict: Answer, comment: string, seen_revision: number}, key: string) => Promise<StoredReview>} answer
 * @property {(act: Act) => Promise<BulkOut>} act
 */

/**
 * @typedef {object} SenderEvents
 * @property {(stored: StoredReview) => void} onStored
 * @property {(item: QueuedAnswer, current: Decision | null) => void} onConflict  somebody else was first
 * @property {(item: QueuedAnswer, error: Error) => void} onRefused  will never be stored
 * @property {(done: DoneAct) => void} onDone
 * @property {(act: Act) => void} onGivenUp
 * @property {() => void} onSignedOut  the server takes nothing before somebody signs in
 */

const FIRST_RETRY_S = 1;
const LONGEST_RETRY_S = 30;

/**
 * Sends what is in the outbox, oldest first, one at a time. An act that the person has to decide about
 * steps aside; everything else waits until what is before it is stored.
 * @param {Outbox} outbox @param {SenderCalls} calls @param {SenderEvents} events
 * @param {(run: () => void, delayMs: number) => void} [later]
 */
export function createSender(outbox, calls, events, later = (run, delayMs) => void setTimeout(run, delayMs)) {
  /** What became of acts that are not stored, by their keys. @type {Map<string, {state: ActState, text: string}>} */
  const told = new Map();
  const open = createValue(/** @type {readonly OpenAct[]} */ ([]));
  /** @type {import("../core/observable.js").Value<SenderState>} */
  const state = createValue(stateNow("saved"));
  let isSending = false;
  /** Somebody said that it may work now, while an attempt from before was still failing. */
  let isWorthTrying = false;
  let retryS = FIRST_RETRY_S;
  let retries = 0;
  /** The place in the line of the last act on all of a filter that was stored. */
  let filterActs = 0;

  /** Is it the person's turn? @param {Item} item */
  function isAside(item) {
    return ["changed", "refused"].includes(told.get(item.key)?.state ?? "");
  }

  /** @param {Phase} phase @returns {SenderState} */
  function stateNow(phase) {
    const items = outbox.items().filter((item) => !isAside(item));
    const waiting = new Set(items.flatMap((item) => (isAct(item) ? [] : [item.boxId])));
    const count = waiting.size + items.reduce((sum, item) => sum + (isAct(item) ? item.count : 0), 0);
    return { phase: items.length ? phase : "saved", waiting, count };
  }

  /** @param {Phase} phase */
  function show(phase) {
    state.set(stateNow(phase));
    open.set(outbox.acts().map((act) => ({ act, ...(told.get(act.key) ?? { state: "sending", text: "" }) })));
  }

  /** Acts wait as well, and say why. @param {string} text */
  function sayWaiting(text) {
    for (const act of outbox.acts()) if (!isAside(act)) told.set(act.key, { state: "waiting", text });
  }

  async function drain() {
    if (isSending) return;
    isSending = true;
    try {
      for (let item = next(); item; item = next()) {
        told.delete(item.key);
        show("saving");
        if (!(await deliver(item))) return;
        retryS = FIRST_RETRY_S;
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
      if (isAct(item)) await sendAct(item);
      else await sendAnswer(item);
      return true;
    } catch (error) {
      return settle(item, error);
    }
  }

  /** @param {QueuedAnswer} item */
  async function sendAnswer(item) {
    const { boxId, verdict, comment, seenRevision: seen_revision } = item;
    outbox.markAttempted(item);
    const stored = await calls.answer(boxId, { verdict, comment, seen_revision }, item.key);
    outbox.remove(item);
    outbox.rebase(item, boxId, stored.revision);
    events.onStored(stored);
  }

  /** @param {Act} act */
  async function sendAct(act) {
    const out = await calls.act(act);
    outbox.remove(act);
    if (act.filter) filterActs = act.order;
    act.boxIds?.forEach((boxId, i) => out.stale.includes(boxId) || outbox.rebase(act, boxId, (act.seen?.[i] ?? 0) + 1));
    events.onDone({ batchId: out.id, act, skipped: out.skipped, stale: out.stale });
  }

  /** @param {Item} item @param {unknown} error @returns {boolean} go on with the next? */
  function settle(item, error) {
    if (error instanceof NoAnswer) return waitAndRetry("offline", retryS, "the server does not answer");
    if (!(error instanceof ApiError)) throw error;
    if (error.status === 401) {
      sayWaiting("you are signed out");
      show("signed-out");
      events.onSignedOut();
      return false;
    }
    if (error.isTemporary) return waitAndRetry("busy", error.retryAfterS ?? retryS, error.message);
    if (isAct(item)) {
      told.set(item.key, { state: error.problem.code === "stale_snapshot" ? "changed" : "refused", text: error.message });
      leftOut(item);
      return true;
    }
    const current = error.status === 412 ? (error.problem.current ?? null) : null;
    if (current && isOwn(item, current)) {
      outbox.again(item, seenRevision(current));
      return true;
    }
    outbox.remove(item);
    leftOut(item);
    if (error.status === 412) events.onConflict(item, current);
    else events.onRefused(item, error);
    return true;
  }

  /** Was it this person's own act, on all of a filter, that was faster? Which boxes it answers, the page did not know. @param {QueuedAnswer} item @param {Decision} current */
  function isOwn(item, current) {
    return filterActs > 0 && item.order > filterActs && current.review?.reviewer === item.person;
  }

  /** It is not stored, so what was said later of its boxes has seen no more than it had. @param {Item} item */
  function leftOut(item) {
    if (!isAct(item)) return outbox.rebase(item, item.boxId, item.seenRevision);
    return item.boxIds?.forEach((boxId, i) => outbox.rebase(item, boxId, item.seen?.[i] ?? 0));
  }

  /** @param {Phase} phase @param {number} seconds @param {string} text */
  function waitAndRetry(phase, seconds, text) {
    sayWaiting(text);
    show(phase);
    const mine = ++retries;
    const wait = isWorthTrying ? 0 : seconds;
    isWorthTrying = false;
    retryS = Math.min(retryS * 2, LONGEST_RETRY_S);
    later(() => mine === retries && void drain(), wait * 1000);
    return false;
  }

  /** Something more waits: try, unless nobody is signed in. */
  function more() {
    const { phase } = state.get();
    if (phase === "signed-out") sayWaiting("you are signed out");
    show(phase === "saved" ? "saving" : phase);
    if (phase !== "signed-out") void drain();
  }

  /** Try now: the network is back, or somebody has signed in. */
  function resume() {
    isWorthTrying = isSending;
    retryS = FIRST_RETRY_S;
    return drain();
  }

  show("saved");

  return {
    state,
    /** The acts that are not stored. */
    open,
    resume,

    /** An answer that a person has given. @param {Parameters<Outbox["add"]>[0]} answer */
    answer(answer) {
      outbox.add(answer);
      more();
    },

    /** @param {WantedAct} act @param {string} [key] */
    start(act, key) {
      outbox.addAct(act, key);
      more();
    },

    /** An act that stood aside, once more. @param {string} key */
    retry(key) {
      told.delete(key);
      return resume();
    },

    /** Forget an act. @param {string} key */
    giveUp(key) {
      const act = outbox.acts().find((one) => one.key === key);
      if (!act) return;
      outbox.remove(act);
      leftOut(act);
      told.delete(key);
      show(state.get().phase);
      events.onGivenUp(act);
    },

    /** Boxes of acts that are not stored. */
    waitingIds: () => new Set(open.get().flatMap(({ act }) => act.boxIds ?? [])),

    /** Take up what this person has left behind, in this tab or in closed ones; `resume` sends it. @param {ReadonlySet<string>} openTabs */
    adopt(openTabs) {
      outbox.adopt(openTabs);
      for (const act of outbox.acts()) {
        if (!told.has(act.key)) told.set(act.key, { state: "waiting", text: "it was not sent before the page was closed" });
      }
      show(state.get().phase);
    },
  };
}

/** @typedef {ReturnType<typeof createSender>} Sender */

/** One answer on many boxes, as they were seen. @param {Act} act @returns {Promise<BulkOut>} */
export function sendBulk({ key, dataset, verdict, boxIds, seen, filter, snapshot }) {
  const which = boxIds ? { box_ids: boxIds, seen_revisions: seen } : { filter, snapshot };
  return post("/api/v1/reviews/bulk", { body: { dataset, verdict, ...which }, key });
}

/** The same key for the same batch: a repeated request undoes once. @param {number} batchId @returns {Promise<UndoOut>} */
export const undoBulk = (batchId) => post("/api/v1/review-batches/{batch_id}/undo", { path: { batch_id: batchId }, key: `undo-batch-${batchId}` });

/** @typedef {{name: string, item: {person?: string}}} Kept */

/** @param {Storage} storage @returns {Kept[]} */
export function unowned(storage) {
  const names = Array.from({ length: storage.length }, (_, i) => storage.key(i) ?? "");
  return names
    .filter((name) => isOurs(name))
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
