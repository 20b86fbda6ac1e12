// @ts-check
// The frame on show with its store, and the next one fetched ahead with its picture.

import { fetchAhead } from "./pictures.js";
import { REMOTE, createStore } from "./store.js";

/** @typedef {import("./types.js").Decision} Decision */
/** @typedef {import("./types.js").Frame} Frame */
/** @typedef {import("./store.js").Store} Store */
/** @typedef {{frame: Frame, store: Store}} Open */

/** A frame fetched ahead is only used while it is fresh: others may be answering. */
const FRESH_MS = 20_000;

/** In the sender's order, but what cannot be looked at comes last. @param {readonly Decision[]} boxes */
const visibleFirst = (boxes) => [...boxes.filter((box) => box.xyxy), ...boxes.filter((box) => !box.xyxy)];

/** @param {import("./api.js").Api} api */
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
