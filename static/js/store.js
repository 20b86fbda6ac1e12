// @ts-check
// State as immutable snapshots that can be observed. No DOM, no network.

/** @typedef {import("./types.js").Decision} Decision */
/** @typedef {"local" | "undo" | "remote"} Origin  this reviewer; this reviewer taking back; the server */
/** @typedef {{origin: Origin, before: Decision, after: Decision}} Change */

export const LOCAL = "local";
export const UNDO = "undo";
export const REMOTE = "remote";

/**
 * The boxes of a frame, or of a queue, in their order.
 * @param {readonly Decision[]} decisions
 */
export function createStore(decisions) {
  let byId = new Map(decisions.map((box) => [box.box_id, Object.freeze(box)]));
  /** @type {readonly Decision[] | null} */
  let all = null;
  /** @type {Set<(change: Change) => void>} */
  const observers = new Set();
  return {
    /** @param {number} boxId */
    get: (boxId) => byId.get(boxId),

    /** One array per state: the same until something changes. */
    all: () => (all ??= Object.freeze([...byId.values()])),

    /** More boxes, at the end; those that are here stay as they are. @param {readonly Decision[]} more */
    add(more) {
      const unknown = more.filter((box) => !byId.has(box.box_id));
      byId = new Map([...byId, ...unknown.map((box) => /** @type {const} */ ([box.box_id, Object.freeze(box)]))]);
      all = null;
    },

    /** Replaces a box by its next state. @param {Decision} after @param {Origin} origin */
    apply(after, origin) {
      const key = after.box_id;
      const before = byId.get(key);
      if (before === undefined) throw new RangeError(`no box ${key} here`);
      byId = new Map([...byId, [key, Object.freeze(after)]]);
      all = null;
      const change = { origin, before, after };
      // A copy: who listens may stop listening while being told.
      [...observers].forEach((tell) => tell(change));
    },

    /** @param {(change: Change) => void} notify @returns {() => void} stop observing */
    observe(notify) {
      observers.add(notify);
      return () => observers.delete(notify);
    },
  };
}

/** @typedef {ReturnType<typeof createStore>} Store */

/**
 * One observable value.
 * @template T
 * @param {T} initial
 */
export function createValue(initial) {
  let value = initial;
  /** @type {Set<(value: T) => void>} */
  const observers = new Set();
  return {
    get: () => value,

    /** @param {T} next */
    set(next) {
      if (Object.is(next, value)) return;
      value = next;
      for (const notify of [...observers]) notify(next);
    },

    /** @param {(value: T) => void} notify @returns {() => void} stop observing */
    observe(notify) {
      observers.add(notify);
      return () => observers.delete(notify);
    },
  };
}

/**
 * @template T
 * @typedef {{get: () => T, set: (next: T) => void, observe: (notify: (value: T) => void) => () => void}} Value
 */
