// @ts-check
// Frames with their picture and segmentation, each loaded once for all who draw them, and some of them in advance.
// Their boxes are in the store.

import { ApiError, blob, get, pictureUrl, url } from "../core/api.js";
import { useLayoutEffect, useMemo } from "../core/html.js";
import { createLazy } from "../core/observable.js";
import { PAINTED, canvasOf, createObjects, isPaintedAlready } from "./pixels.js";
import { isOpaque, storedImage } from "./stored.js";

/** @import { Boxes } from "../boxes/store.js" */
/** @import { Objects } from "./pixels.js" */
/** @typedef {Omit<import("../core/openapi.js").Frame, "boxes"> & {boxIds: readonly number[]}} Frame */
/** @template T @typedef {import("../core/observable.js").Lazy<T>} Lazy */

/**
 * @typedef {object} Media  what there is to draw of one frame
 * @property {Lazy<Frame>} frame
 * @property {Lazy<HTMLImageElement | null>} picture  null: the frame has none
 * @property {Lazy<Pixels | null>} segmentation  its pixels, and what they mean; null: the frame has none
 * @property {Lazy<CanvasImageSource | null>} mask  the segmentation in the colours of its palette
 * @property {Lazy<Objects | null>} objects  by the instance image; null: the frame has none
 * @property {() => void} release  its boxes need not stay in the store
 */

/** @typedef {{canvas: HTMLCanvasElement, form: Frame["segmentation"]}} Pixels */

/** How many frames are kept: those used last. */
const KEPT = 8;

/** How long a frame that was fetched ahead may be used where its boxes are shown: others may answer them meanwhile. */
const FRESH_MS = 20_000;

/** Each view makes one, and ends it when it is closed. @param {Boxes} boxes */
export function createMedia(boxes) {
  /** The frame used last comes last. @type {Map<number, Media>} */
  const known = new Map();
  /**
   * Until when frames that were fetched ahead may be used where their boxes are shown, ms.
   * @type {Map<number, number>}
   */
  const freshUntil = new Map();
  // Answers are in the store as soon as they are given, but for bulk answers on boxes that the page does not know.
  const stop = boxes.reloads.observe(() => freshUntil.clear());

  /** Loads nothing yet. @param {number} frameId */
  function of(frameId) {
    const media = known.get(frameId) ?? mediaOf(frameId, boxes);
    known.delete(frameId);
    known.set(frameId, media);
    for (const old of [...known.keys()].slice(0, -KEPT)) drop(old);
    return media;
  }

  /** @param {number} frameId */
  function drop(frameId) {
    known.get(frameId)?.release();
    known.delete(frameId);
  }

  /** @param {number} frameId */
  const isFresh = (frameId) => Date.now() < (freshUntil.get(frameId) ?? 0);

  return {
    of,

    /**
     * A frame whose boxes are to be shown: the one that was fetched ahead, once; else a new one.
     * @param {number} frameId @param {AbortSignal} signal
     */
    frame(frameId, signal) {
      if (!isFresh(frameId)) drop(frameId);
      freshUntil.delete(frameId);
      return of(frameId).frame.get(signal);
    },

    /** Fetch a frame whose boxes will be shown, and its picture. @param {number} frameId */
    fetchAhead(frameId) {
      if (isFresh(frameId)) return;
      drop(frameId);
      freshUntil.set(frameId, Date.now() + FRESH_MS);
      of(frameId)
        .picture.get()
        .catch(() => {});
    },

    /** Drop everything. */
    end() {
      stop();
      [...known.keys()].forEach(drop);
    },
  };
}

/** @typedef {ReturnType<typeof createMedia>} MediaCache */

/** What a view has loaded, until it is closed. @param {Boxes} boxes */
export function useMedia(boxes) {
  const media = useMemo(() => createMedia(boxes), [boxes]);
  useLayoutEffect(() => media.end, [media]);
  return media;
}

/** @param {Frame} frame @param {"segmentation" | "instances"} kind */
const fileUrl = ({ id, files }, kind) =>
  files[kind]?.url ?? url("/api/v1/frames/{frame_id}/{kind}", { path: { frame_id: id, kind } });

/** The widest picture that the service draws: none is wider. */
const LARGEST_PX = 16_383;

/** The segmentation painted in its palette, whatever its file's encoding. @param {number} frameId */
const paintedUrl = (frameId) =>
  // `url` leaves out what is empty, and then all boxes would be drawn.
  `${url("/api/v1/frames/{frame_id}/overlay", { path: { frame_id: frameId }, query: { layer: "segmentation" } })}&boxes=`;

/** A picture, decoded. @param {Blob} file */
async function decoded(file) {
  const image = new Image();
  // Fetched before, because an <img> sends no session. A decoded image no longer needs its address.
  image.src = URL.createObjectURL(file);
  try {
    await image.decode();
  } finally {
    URL.revokeObjectURL(image.src);
  }
  return image;
}

/**
 * A frame's image as crops and thumbnails show it, in its full size; null: it has none.
 * @param {number} frameId @param {AbortSignal} [signal]
 */
async function pictureOf(frameId, signal) {
  const address = pictureUrl("/api/v1/frames/{frame_id}/thumbnail", {
    path: { frame_id: frameId },
    query: { width: LARGEST_PX },
  });
  try {
    return await decoded(await blob(address, signal));
  } catch (error) {
    if (error instanceof ApiError && error.status === 404) return null;
    throw error;
  }
}

/** @param {Frame} frame @param {AbortSignal} [signal] @returns {Promise<Pixels>} */
async function pixelsOf(frame, signal) {
  const { file, mayHaveAlpha } = await storedImage(await blob(fileUrl(frame, "segmentation"), signal));
  const mayHide = frame.segmentation && mayHaveAlpha;
  const [canvas, opaque] = await Promise.all([canvasOf(file), !mayHide || isOpaque(file)]);
  if (opaque) return { canvas, form: frame.segmentation };
  // What is transparent has lost its values in the canvas.
  return { canvas: await canvasOf(await blob(paintedUrl(frame.id), signal)), form: PAINTED };
}

/** @param {number} frameId @param {Boxes} boxes @returns {Media} */
function mediaOf(frameId, boxes) {
  let isReleased = false;
  /** @type {(() => void) | undefined} */
  let releaseBoxes;
  const frame = createLazy(async (signal) => {
    const { boxes: came, ...rest } = await get("/api/v1/frames/{frame_id}", { path: { frame_id: frameId }, signal });
    const boxIds = boxes.receive(came);
    releaseBoxes = boxes.hold(boxIds);
    if (isReleased) releaseBoxes();
    return { ...rest, boxIds };
  });
  // It is asked for together with its frame, not after it.
  const picture = createLazy(async (signal) => (await Promise.all([frame.get(signal), pictureOf(frameId, signal)]))[1]);
  const segmentation = createLazy(async (signal) => {
    const found = await frame.get(signal);
    return found.has_segmentation ? pixelsOf(found, signal) : null;
  });
  const mask = createLazy(async (signal) => {
    const { has_segmentation, segmentation: form } = await frame.get(signal);
    if (!has_segmentation) return null;
    if (form && isPaintedAlready(form)) return (await segmentation.get(signal))?.canvas ?? null;
    return decoded(await blob(paintedUrl(frameId), signal));
  });
  const objects = createLazy(async (signal) => {
    const found = await frame.get(signal);
    if (!found.files?.instances) return null;
    const { file, mayHaveAlpha } = await storedImage(await blob(fileUrl(found, "instances"), signal));
    // What is transparent has lost its values in a canvas.
    return mayHaveAlpha && !(await isOpaque(file)) ? null : createObjects(await canvasOf(file));
  });
  function release() {
    isReleased = true;
    releaseBoxes?.();
  }
  return { frame, picture, segmentation, mask, objects, release };
}
