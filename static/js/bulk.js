// @ts-check
// Bulk acts: one answer on many boxes, sent as one and taken back as one. An act that cannot be
// sent is kept in the browser's storage and says so, until it is sent or given up.

import { ApiError, NoAnswer } from "./api.js";
import { createValue } from "./store.js";

/** @typedef {import("./types.js").Answer} Answer */
/** @typedef {import("./types.js").Decision} Decision */
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

const PREFIX = "unghost.bulk.v1.";

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
    storage.removeItem(PREFIX + act.key);
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
    storage.setItem(PREFIX + act.key, JSON.stringify(act));
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
        storage.setItem(PREFIX + act.key, JSON.stringify(act));
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
  const names = Array.from({ length: storage.length }, (_, i) => storage.key(i) ?? "").filter((name) => name.startsWith(PREFIX));
  return names.flatMap((name) => {
    try {
      const act = JSON.parse(storage.getItem(name) ?? "");
      return typeof act?.key === "string" && typeof act.count === "number" ? [act] : [];
    } catch {
      return [];
    }
  });
}
