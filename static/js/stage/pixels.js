// @ts-check
// The stored pixels of a segmentation, and the highlighted matching pixels of a box.

import { pixelBounds } from "./geometry.js";

/** @import { Decision, Xyxy } from "../boxes/box.js" */
/** @import { AcceptedTag, SegmentationReport } from "../core/openapi.js" */
/** @import { Point } from "./geometry.js" */
/** @typedef {AcceptedTag["rgb"]} Rgb */
/** @typedef {{x: number, y: number, width: number, height: number}} Bounds */
/**
 * @typedef {{outline: Path2D, count: number}} Highlight the outline of the pixels, in px of the image; how many they
 *   are
 */

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
 * The outline of the matching pixels of a box; null if there is nothing to highlight.
 * @param {HTMLCanvasElement} segmentation @param {SegmentationReport} form @param {Decision} box
 * @returns {Highlight | null}
 */
export function highlightOf(segmentation, form, box) {
  if (!box.xyxy || !box.accepted_tags?.length) return null;
  const bounds = pixelBounds(box.xyxy, segmentation);
  const pixels = contextOf(segmentation).getImageData(bounds.x, bounds.y, bounds.width, bounds.height);
  const mask = matchingPixels(pixels.data, tagMatcher(box.accepted_tags, form));
  const outline = new Path2D();
  for (const [x0, y0, x1, y1] of outlinesOf(mask, bounds.width)) {
    outline.moveTo(bounds.x + x0, bounds.y + y0);
    outline.lineTo(bounds.x + x1, bounds.y + y1);
  }
  return { outline, count: mask.reduce((count, one) => count + one, 0) };
}

/** How the server paints a segmentation. @type {SegmentationReport} */
export const PAINTED = {
  palette: "",
  encoding: "palette",
  channel_order: "rgb",
  lossy: false,
  unknown_percent: 0,
  notes: [],
};

/**
 * Whether the file itself can be shown as the mask; raw tags and swapped colours must be painted by the server.
 * @param {SegmentationReport} form
 */
export const isPaintedAlready = (form) => form.encoding === "palette" && form.channel_order === "rgb";

/** How far a JPEG may have moved a colour, per channel: the server's own tolerance. */
const LOSSY_TOLERANCE = 32;

/**
 * A test for one pixel: do these three stored channels carry an accepted tag?
 * @param {readonly AcceptedTag[]} accepted
 * @param {Pick<SegmentationReport, "encoding" | "channel_order" | "lossy">} form
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
    return (c0, c1, c2) => colors.some(([a = 0, b = 0, c = 0]) => isNear(c0, a) && isNear(c1, b) && isNear(c2, c));
  }
  const packed = new Set(colors.map(([a = 0, b = 0, c = 0]) => (a << 16) | (b << 8) | c));
  return (c0, c1, c2) => packed.has((c0 << 16) | (c1 << 8) | c2);
}

/** @param {number} found @param {number} wanted */
const isNear = (found, wanted) => Math.abs(found - wanted) <= LOSSY_TOLERANCE;

/**
 * Which pixels match, 1 or 0.
 * @param {Uint8ClampedArray} rgba @param {(c0: number, c1: number, c2: number) => boolean} matches
 */
export const matchingPixels = (rgba, matches) =>
  Uint8Array.from({ length: rgba.length / 4 }, (_, i) =>
    Number(matches(rgba[4 * i] ?? 0, rgba[4 * i + 1] ?? 0, rgba[4 * i + 2] ?? 0)),
  );

/**
 * The lines between pixels of a mask and others, each as long as it is straight: x0, y0, x1, y1.
 * @param {Uint8Array} mask  of whole rows @param {number} width
 * @returns {[number, number, number, number][]}
 */
export function outlinesOf(mask, width) {
  const height = mask.length / width;
  /** @param {number} x @param {number} y */
  const at = (x, y) => (x >= 0 && x < width && y >= 0 && y < height ? (mask[y * width + x] ?? 0) : 0);
  /** @type {[number, number, number, number][]} */
  const lines = [];
  for (let y = 0; y <= height; y++) {
    for (let x = 0, from = -1; x <= width; x++) {
      const isEdge = x < width && at(x, y - 1) !== at(x, y);
      if (isEdge && from < 0) from = x;
      if (!isEdge && from >= 0) {
        lines.push([from, y, x, y]);
        from = -1;
      }
    }
  }
  for (let x = 0; x <= width; x++) {
    for (let y = 0, from = -1; y <= height; y++) {
      const isEdge = y < height && at(x - 1, y) !== at(x, y);
      if (isEdge && from < 0) from = y;
      if (!isEdge && from >= 0) {
        lines.push([x, from, x, y]);
        from = -1;
      }
    }
  }
  return lines;
}

/**
 * The rectangle around the pixels of the object at a place of an instance image, in which each object has a colour.
 * @param {HTMLCanvasElement} instances
 */
export function createObjects(instances) {
  const { width, height } = instances;
  const colors = new Uint32Array(contextOf(instances).getImageData(0, 0, width, height).data.buffer);
  /** @type {Map<number, Xyxy>} */
  const known = new Map();
  return {
    /** @param {Point} at  image px @returns {Xyxy | null} */
    at({ x, y }) {
      if (x < 0 || y < 0 || x >= width || y >= height) return null;
      const color = colors[Math.floor(y) * width + Math.floor(x)] ?? 0;
      const found = known.get(color) ?? extentOf(colors, width, color);
      known.set(color, found);
      return found;
    },
  };
}

/** @typedef {ReturnType<typeof createObjects>} Objects */

/** @param {Uint32Array} colors @param {number} width @param {number} color one of them @returns {Xyxy} */
export function extentOf(colors, width, color) {
  let [x0, y0, x1, y1] = [Infinity, Infinity, 0, 0];
  for (let i = colors.indexOf(color); i >= 0; i = colors.indexOf(color, i + 1)) {
    const [x, y] = [i % width, Math.floor(i / width)];
    [x0, y0, x1, y1] = [Math.min(x0, x), Math.min(y0, y), Math.max(x1, x + 1), Math.max(y1, y + 1)];
  }
  return [x0, y0, x1, y1];
}
