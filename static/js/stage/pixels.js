// @ts-check
// The pixels of a segmentation file, exactly as they are stored, and the lit ones of a box.

import { pixelBounds } from "../geometry.js";
import { lightPixels, tagMatcher } from "../palette.js";

/** @typedef {import("../types.js").Decision} Decision */
/** @typedef {import("../types.js").SegmentationReport} SegmentationReport */
/** @typedef {{x: number, y: number, width: number, height: number}} Bounds */
/** @typedef {{canvas: HTMLCanvasElement, bounds: Bounds, count: number}} Lit */

/** On the image: a light that no CARLA scene has, and a shade that makes it stand out. */
const LIT = [255, 221, 51, 168];
const UNLIT = [8, 10, 14, 96];

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
 * The matching pixels of a box; null when nothing can be lit.
 * @param {HTMLCanvasElement} segmentation @param {SegmentationReport} form @param {Decision} box
 * @returns {Lit | null}
 */
export function litPixels(segmentation, form, box) {
  if (!box.xyxy || !box.accepted_tags?.length) return null;
  const bounds = pixelBounds(box.xyxy, segmentation);
  const pixels = contextOf(segmentation).getImageData(bounds.x, bounds.y, bounds.width, bounds.height);
  const count = lightPixels(pixels.data, tagMatcher(box.accepted_tags, form), LIT, UNLIT);
  const canvas = document.createElement("canvas");
  canvas.width = bounds.width;
  canvas.height = bounds.height;
  contextOf(canvas).putImageData(pixels, 0, 0);
  return { canvas, bounds, count };
}

/** Can the file itself be shown as the mask? Raw tags and swapped colours must be painted. @param {SegmentationReport} form */
export const isPaintedAlready = (form) => form.encoding === "palette" && form.channel_order === "rgb";
