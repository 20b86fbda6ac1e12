// @ts-check
// The stored pixels of a segmentation, and the highlighted matching pixels of a box.

import { pixelBounds } from "./geometry.js";

/** @typedef {import("../core/openapi.js").AcceptedTag} AcceptedTag */
/** @typedef {import("../boxes/box.js").Decision} Decision */
/** @typedef {import("../core/openapi.js").AcceptedTag["rgb"]} Rgb */
/** @typedef {import("../core/openapi.js").SegmentationReport} SegmentationReport */
/** @typedef {{x: number, y: number, width: number, height: number}} Bounds */
/** @typedef {{canvas: HTMLCanvasElement, bounds: Bounds, count: number}} Highlight */

/** RGBA of highlighted pixels, a colour that no CARLA scene has; and below, a shade for all other pixels of the box. */
const MATCHING = [255, 221, 51, 168];

const OTHERS = [8, 10, 14, 96];

/**
 * A canvas with the stored values: no colour management, no premultiplication.
 * @param {Blob} blob @returns {Promise<HTMLCanvasElement>}
 */
export async function canvasOf(blob) {
  const bitmap = await createImageBitmap(blob, { premultiplyAlpha: "none", colorSpaceConversion: "none" });
  const canvas = document.createElement("canvas");
  canvas.width = bitmap.width;
  canvas.height = bitmap.height;
  contextOf(canvas).drawImage(bitmap, 0, 0);
  bitmap.close();
  return canvas;
}

/** @param {HTMLCanvasElement} canvas */
function contextOf(canvas) {
  return /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { willReadFrequently: true }));
}

/**
 * A drawing of the matching pixels of a box; null if there is nothing to highlight.
 * @param {HTMLCanvasElement} segmentation @param {SegmentationReport} form @param {Decision} box
 * @returns {Highlight | null}
 */
export function highlightOf(segmentation, form, box) {
  if (!box.xyxy || !box.accepted_tags?.length) return null;
  const bounds = pixelBounds(box.xyxy, segmentation);
  const pixels = contextOf(segmentation).getImageData(bounds.x, bounds.y, bounds.width, bounds.height);
  const count = highlightPixels(pixels.data, tagMatcher(box.accepted_tags, form), MATCHING, OTHERS);
  const canvas = document.createElement("canvas");
  canvas.width = bounds.width;
  canvas.height = bounds.height;
  contextOf(canvas).putImageData(pixels, 0, 0);
  return { canvas, bounds, count };
}

/** How the server paints a segmentation. @type {SegmentationReport} */
export const PAINTED = { palette: "", encoding: "palette", channel_order: "rgb", lossy: false, unknown_percent: 0, notes: [] };

/** Whether the file itself can be shown as the mask; raw tags and swapped colours must be painted by the server. @param {SegmentationReport} form */
export const isPaintedAlready = (form) => form.encoding === "palette" && form.channel_order === "rgb";

/** How far a JPEG may have moved a colour, per channel: the server's own tolerance. */
const LOSSY_TOLERANCE = 32;

/**
 * A test for one pixel: do these three stored channels carry an accepted tag?
 * @param {readonly AcceptedTag[]} accepted @param {Pick<SegmentationReport, "encoding" | "channel_order" | "lossy">} form
 * @returns {(c0: number, c1: number, c2: number) => boolean}
 */
export function tagMatcher(accepted, form) {
  const swapped = form.channel_order === "bgr";
  if (form.encoding === "raw") {
    const tags = new Set(accepted.map(({ tag }) => tag));
    return swapped ? (_0, _1, c2) => tags.has(c2) : (c0) => tags.has(c0);
  }
  const colors = accepted.map(({ rgb }) => (swapped ? [rgb[2], rgb[1], rgb[0]] : rgb));
  if (form.lossy) {
    return (c0, c1, c2) =>
      colors.some(([a = 0, b = 0, c = 0]) => isNear(c0, a) && isNear(c1, b) && isNear(c2, c));
  }
  const packed = new Set(colors.map(([a = 0, b = 0, c = 0]) => (a << 16) | (b << 8) | c));
  return (c0, c1, c2) => packed.has((c0 << 16) | (c1 << 8) | c2);
}

/** @param {number} found @param {number} wanted */
const isNear = (found, wanted) => Math.abs(found - wanted) <= LOSSY_TOLERANCE;

/**
 * Colour the pixels: `matching` where the tag is accepted, `others` elsewhere.
 * @param {Uint8ClampedArray} rgba of the segmentation; replaced in place
 * @param {(c0: number, c1: number, c2: number) => boolean} matches
 * @param {readonly number[]} matching rgba @param {readonly number[]} others rgba
 * @returns {number} how many pixels match
 */
export function highlightPixels(rgba, matches, matching, others) {
  let count = 0;
  for (let i = 0; i < rgba.length; i += 4) {
    const isMatch = matches(rgba[i] ?? 0, rgba[i + 1] ?? 0, rgba[i + 2] ?? 0);
    if (isMatch) count++;
    rgba.set(isMatch ? matching : others, i);
  }
  return count;
}
