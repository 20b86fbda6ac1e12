// @ts-check
// The boxes that are on show: of the open frame, of the queue, of the grid. Who changes one tells all of them.

import { useValue } from "../core/hooks.js";
import { useEffect, useMemo, useState } from "../core/html.js";
import { fetchAhead } from "../core/pictures.js";
import { seen } from "./box.js";

/** @typedef {import("../core/types.js").Decision} Decision */
/** @typedef {import("../core/types.js").Frame} Frame */
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
/** @typedef {{get: (boxId: number) => Decision | undefined, apply: (box: Decision, origin: Origin) => void}} AnyStore */

/** @param {() => AnyStore | undefined} frameStore the open frame's */
export function createOpenStores(frameStore) {
  /** Stores, and whether a person answers there. @type {Map<AnyStore, boolean>} */
  const lent = new Map();
  const all = () => [...lent.keys(), frameStore()].filter((store) => store !== undefined);
  return {
    /** @param {AnyStore} store @param {{takesAnswers?: boolean}} [how] @returns {() => void} take it back */
    lend(store, { takesAnswers = false } = {}) {
      lent.set(store, takesAnswers);
      return () => lent.delete(store);
    },

    /** How a box is, wherever it is on show. @param {number} boxId */
    find: (boxId) => all().find((store) => store.get(boxId))?.get(boxId),

    /** The store that a person's answer on this box goes to. @param {number} boxId */
    answering: (boxId) => all().find((store) => lent.get(store) !== false && store.get(boxId)),

    /** What the server says of a box. @param {number} boxId @param {(box: Decision) => Decision} change */
    tell(boxId, change) {
      for (const store of all()) {
        const box = store.get(boxId);
        if (box) store.apply(change(box), REMOTE);
      }
    },
  };
}

/** @typedef {ReturnType<typeof createOpenStores>} OpenStores */

/** @typedef {{frame: Frame, store: Store}} Open */

/** A frame fetched ahead is only used while it is fresh: others may be answering. */
const FRESH_MS = 20_000;

/** In the sender's order, but what cannot be looked at comes last. @param {readonly Decision[]} boxes */
const visibleFirst = (boxes) => [...boxes.filter((box) => box.xyxy), ...boxes.filter((box) => !box.xyxy)];

/** @param {import("../core/api.js").Api} api */
export function createFrames(api) {
  /** @type {Map<number, {frame: Promise<Frame>, at: number}>} */
  const ahead = new Map();
  /** @type {Open | null} */
  let open = null;

  /** @param {number} boxId */
  const boxOnShow = (boxId) => open?.store.get(boxId);

  return {
    current: () => open,
    boxOnShow,

    /** @param {Frame} frame @returns {Open} */
    open(frame) {
      open = { frame, store: createStore(visibleFirst(frame.boxes)) };
      return open;
    },

    /** @param {number} id @param {AbortSignal} signal @returns {Promise<Frame>} */
    load(id, signal) {
      const known = ahead.get(id);
      ahead.delete(id);
      return known && Date.now() - known.at < FRESH_MS ? known.frame : api.frame(id, signal);
    },

    /** @param {number | null} id */
    fetchAhead(id) {
      if (id === null || ahead.has(id)) return;
      ahead.clear();
      const frame = api.frame(id);
      ahead.set(id, { frame, at: Date.now() });
      frame.then(
        (found) => found.has_image && fetchAhead(api.fileUrl(found, "image")),
        () => ahead.delete(id),
      );
    },

    /** What was fetched ahead is no longer true. @param {number | undefined} id */
    forget(id) {
      if (id !== undefined) ahead.delete(id);
    },

    forgetAll: () => ahead.clear(),

    /** Ask the server how a box is now. @param {number} boxId */
    async refresh(boxId) {
      const decision = await api.box(boxId).catch(() => null);
      if (decision && boxOnShow(boxId)) open?.store.apply(decision, REMOTE);
    },
  };
}

/** @typedef {ReturnType<typeof createFrames>} Frames */

/** @param {Store} store */
export function useBoxes(store) {
  const [boxes, setBoxes] = useState(() => store.all());
  useEffect(() => {
    setBoxes(store.all());
    return store.observe(() => setBoxes(store.all()));
  }, [store]);
  return boxes;
}

/** Boxes as they may be shown: veiled where the person re-checks blindly. @param {import("../core/app.js").App} app @param {readonly import("../core/types.js").Decision[]} boxes */
export function useSeen(app, boxes) {
  const { blind } = useValue(app.prefs);
  return useMemo(() => (blind ? boxes.map((box) => seen(box, true)) : boxes), [boxes, blind]);
}
