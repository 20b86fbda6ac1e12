// @ts-check
// Frames with their picture and segmentation, each loaded once for all who draw them, and some of them in advance.

import { blob, get, url } from "../core/api.js";
import { useEffect, useState } from "../core/html.js";
import { canvasOf, isPaintedAlready } from "./pixels.js";

/** @typedef {import("../core/openapi.js").Frame} Frame */

/**
 * Something that is loaded when it is first asked for.
 * @template T
 * @typedef {{value: T | undefined, get: (signal?: AbortSignal) => Promise<T>}} Lazy  `value` is undefined until it is there
 */

/**
 * @typedef {object} Media  what there is to draw of one frame
 * @property {Lazy<Frame>} frame
 * @property {Lazy<HTMLImageElement | null>} picture  null: the frame has none
 * @property {Lazy<HTMLCanvasElement | null>} segmentation  its stored pixels; null: the frame has none
 * @property {Lazy<CanvasImageSource | null>} mask  the segmentation in the colours of its palette
 */

/** How many frames are kept: those used last. */
const KEPT = 8;

/** How long a frame that was fetched ahead may be used where its boxes are shown: others may answer them meanwhile. */
const FRESH_MS = 20_000;

/** Each view makes one; what it has loaded is dropped with it. */
export function createMedia() {
  /** The frame used last comes last. @type {Map<number, Media>} */
  const known = new Map();
  /** Until when frames that were fetched ahead may be used where their boxes are shown, ms. @type {Map<number, number>} */
  const freshUntil = new Map();

  /** Loads nothing yet. @param {number} frameId */
  function of(frameId) {
    const media = known.get(frameId) ?? mediaOf(frameId);
    known.delete(frameId);
    known.set(frameId, media);
    for (const old of [...known.keys()].slice(0, -KEPT)) known.delete(old);
    return media;
  }

  /** @param {number} frameId */
  const isFresh = (frameId) => Date.now() < (freshUntil.get(frameId) ?? 0);

  return {
    of,

    /** A frame whose boxes are to be shown: the one that was fetched ahead, once; else a new one. @param {number} frameId @param {AbortSignal} signal */
    frame(frameId, signal) {
      if (!isFresh(frameId)) known.delete(frameId);
      freshUntil.delete(frameId);
      return of(frameId).frame.get(signal);
    },

    /** Fetch a frame whose boxes will be shown, and its picture. @param {number} frameId */
    fetchAhead(frameId) {
      if (isFresh(frameId)) return;
      known.delete(frameId);
      freshUntil.set(frameId, Date.now() + FRESH_MS);
      of(frameId).picture.get().catch(() => {});
    },

    /** The answers on the boxes of a frame have changed since it was fetched ahead. @param {number | null} frameId  null: those of any frame may have */
    forget(frameId) {
      if (frameId === null) freshUntil.clear();
      else freshUntil.delete(frameId);
    },
  };
}

/** @typedef {ReturnType<typeof createMedia>} MediaCache */

/** @param {Frame} frame @param {"image" | "segmentation"} kind */
const fileUrl = ({ id, files }, kind) =>
  files[kind]?.url ?? url("/api/v1/frames/{frame_id}/{kind}", { path: { frame_id: id, kind } });

/** The segmentation painted in its palette, whatever its file's encoding. @param {number} frameId */
const paintedUrl = (frameId) =>
  url("/api/v1/frames/{frame_id}/overlay", { path: { frame_id: frameId }, query: { layer: "segmentation", boxes: "" } });

/** A picture, decoded. @param {string} address @param {AbortSignal} [signal] */
async function imageAt(address, signal) {
  const image = new Image();
  // By fetch, because an <img> sends no session. A decoded image no longer needs its address.
  image.src = URL.createObjectURL(await blob(address, signal));
  try {
    await image.decode();
  } finally {
    URL.revokeObjectURL(image.src);
  }
  return image;
}

/** @param {number} frameId @returns {Media} */
function mediaOf(frameId) {
  const frame = createLazy((signal) => get("/api/v1/frames/{frame_id}", { path: { frame_id: frameId }, signal }));
  const picture = createLazy(async (signal) => {
    const found = await frame.get(signal);
    return found.has_image ? imageAt(fileUrl(found, "image"), signal) : null;
  });
  const segmentation = createLazy(async (signal) => {
    const found = await frame.get(signal);
    return found.has_segmentation ? canvasOf(await blob(fileUrl(found, "segmentation"), signal)) : null;
  });
  const mask = createLazy(async (signal) => {
    const { has_segmentation, segmentation: form } = await frame.get(signal);
    if (!has_segmentation) return null;
    return form && isPaintedAlready(form) ? segmentation.get(signal) : imageAt(paintedUrl(frameId), signal);
  });
  return { frame, picture, segmentation, mask };
}

/**
 * One request serves all who ask. It is aborted when everybody who asked has gone; after that,
 * or when it has failed, the next who asks starts another one.
 * @template T @param {(signal: AbortSignal) => Promise<T>} request @returns {Lazy<T>}
 */
export function createLazy(request) {
  /** @type {{coming: Promise<T>, stop: AbortController, askers: number} | null} */
  let running = null;

  function start() {
    const stop = new AbortController();
    const started = { coming: request(stop.signal), stop, askers: 0 };
    started.coming.then(
      (value) => void (lazy.value = value),
      () => end(started),
    );
    return started;
  }

  /** @param {typeof running} one */
  function end(one) {
    if (running === one) running = null;
  }

  const lazy = {
    value: /** @type {T | undefined} */ (undefined),

    /** @param {AbortSignal} [signal]  without one, the request is never aborted */
    get(signal) {
      const asked = (running ??= start());
      asked.askers += 1;
      signal?.addEventListener("abort", () => {
        asked.askers -= 1;
        if (asked.askers > 0 || lazy.value !== undefined) return;
        end(asked);
        asked.stop.abort();
      });
      return asked.coming;
    },
  };
  return lazy;
}

/**
 * Ask for something while the component is on the page. `value` is undefined until it is there.
 * @template T @param {Lazy<T> | null} lazy  null: it is not wanted
 */
export function useLazy(lazy) {
  const [settled, setSettled] = useState(/** @type {{lazy: Lazy<T> | null, error: Error | null}} */ ({ lazy: null, error: null }));
  const [attempt, setAttempt] = useState(0);
  const value = lazy?.value;
  useEffect(() => {
    if (!lazy || value !== undefined) return;
    const stop = new AbortController();
    /** @param {Error | null} error */
    const settle = (error) => !stop.signal.aborted && setSettled({ lazy, error });
    lazy.get(stop.signal).then(() => settle(null), settle);
    return () => stop.abort();
  }, [lazy, attempt]);
  const error = value === undefined && settled.lazy === lazy ? settled.error : null;
  return { value, error, retry: () => setAttempt((n) => n + 1) };
}
