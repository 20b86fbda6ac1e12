// @ts-check
// Frames with their picture and segmentation, loaded in advance for the queue; the eight used last are kept.

import { blob, get } from "../core/api.js";
import { fileUrl, imageAt, paintedUrl } from "../core/pictures.js";
import { canvasOf, isPaintedAlready } from "./pixels.js";

/** @typedef {import("../core/openapi.js").Frame} Frame */

/**
 * @typedef {object} Media
 * @property {Frame} frame
 * @property {HTMLImageElement | null} picture  null: there is none, or it cannot be shown
 * @property {HTMLCanvasElement | null} segmentation  null until it was requested
 */

const KEPT = 8;

export function createMedia() {
  /** The one used last comes last. @type {Map<number, {ready: Media | null, coming: Promise<Media>}>} */
  const known = new Map();
  /** @type {Map<number, Promise<HTMLCanvasElement | null>>} */
  const segmentations = new Map();

  /** @param {number} frameId @returns {Promise<Media>} */
  async function load(frameId) {
    const frame = await get("/api/v1/frames/{frame_id}", { path: { frame_id: frameId } });
    const picture = frame.has_image ? await imageAt(fileUrl(frame, "image")).catch(() => null) : null;
    return { frame, picture, segmentation: null };
  }

  /** @param {number} frameId */
  function want(frameId) {
    const found = known.get(frameId);
    if (found) {
      known.delete(frameId);
      known.set(frameId, found);
      return found.coming;
    }
    const entry = { ready: /** @type {Media | null} */ (null), coming: load(frameId) };
    known.set(frameId, entry);
    entry.coming.then(
      (media) => void (entry.ready ??= media),
      () => known.delete(frameId),
    );
    for (const old of [...known.keys()].slice(0, -KEPT)) {
      known.delete(old);
      segmentations.delete(old);
    }
    return entry.coming;
  }

  /** @param {number} frameId @returns {Promise<HTMLCanvasElement | null>} */
  async function segmentation(frameId) {
    const { frame } = await want(frameId);
    if (!frame.has_segmentation || !frame.segmentation) return null;
    const known = segmentations.get(frameId);
    if (known) return known;
    const coming = blob(fileUrl(frame, "segmentation")).then(canvasOf);
    segmentations.set(frameId, coming);
    coming.catch(() => segmentations.delete(frameId));
    return coming;
  }

  return {
    /** What can be drawn at once. @param {number} frameId */
    ready: (frameId) => known.get(frameId)?.ready ?? null,
    want,

    /** With its segmentation. @param {number} frameId @returns {Promise<Media>} */
    async wantAll(frameId) {
      const media = await want(frameId);
      const canvas = await segmentation(frameId).catch(() => null);
      const all = { ...media, segmentation: canvas };
      const entry = known.get(frameId);
      if (entry) entry.ready = all;
      return all;
    },

    /** The segmentation as a picture in its palette's colours. @param {Media} media @returns {Promise<CanvasImageSource | null>} */
    async mask({ frame, segmentation: canvas }) {
      if (!frame.has_segmentation || !frame.segmentation) return null;
      return isPaintedAlready(frame.segmentation) ? canvas : imageAt(paintedUrl(frame.id));
    },

    /** A frame that could not be loaded may be there now. @param {number} frameId */
    forget: (frameId) => void known.delete(frameId),
  };
}

/** @typedef {ReturnType<typeof createMedia>} MediaCache */
