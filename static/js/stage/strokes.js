// @ts-check
// Outlines of many boxes, cheaply: an edge is a filled rectangle or a piece of a strip that has
// the dashes. Stroking 500 dashed paths takes the main thread several frames.

/** @typedef {import("../types.js").Xyxy} Xyxy */
/** @typedef {{color: string, casing: string, dash: readonly number[]}} Pen  whole px; dash: on, off */
/** @typedef {{across: ImageBitmap, down: ImageBitmap}} Strips */

/** The ink, and with the casing on both sides of it. */
const INK_PX = 2;
export const LINE_PX = 4;
/** Longer edges go on with the next piece; a multiple of every dash. */
const STRIP_PX = 2 * 3 * 5 * 11 * 4;

/** @type {Map<string, Strips>} */
const known = new Map();

/** Outlines on whole pixels. Dashes begin at each box's corner, so they move with it. @param {CanvasRenderingContext2D} ctx @param {readonly Xyxy[]} rects @param {Pen} pen */
export function outline(ctx, rects, pen) {
  if (rects.length === 0) return;
  if (pen.dash.length) dashedLines(ctx, rects, stripsOf(pen));
  else {
    solidLines(ctx, rects, LINE_PX, pen.casing);
    solidLines(ctx, rects, INK_PX, pen.color);
  }
}

/** @param {CanvasRenderingContext2D} ctx @param {readonly Xyxy[]} rects @param {number} line @param {string} color */
export function solidLines(ctx, rects, line, color) {
  ctx.fillStyle = color;
  for (const rect of rects) {
    const { x, y, width, height } = onPixels(rect, line);
    ctx.fillRect(x, y, width, line);
    ctx.fillRect(x, y + height - line, width, line);
    ctx.fillRect(x, y + line, line, height - 2 * line);
    ctx.fillRect(x + width - line, y + line, line, height - 2 * line);
  }
}

/** @param {CanvasRenderingContext2D} ctx @param {readonly Xyxy[]} rects @param {Strips} strips */
function dashedLines(ctx, rects, { across, down }) {
  ctx.imageSmoothingEnabled = false;
  for (const rect of rects) {
    const { x, y, width, height } = onPixels(rect, LINE_PX);
    for (let at = 0; at < width; at += STRIP_PX) {
      const length = Math.min(width - at, STRIP_PX);
      ctx.drawImage(across, 0, 0, length, LINE_PX, x + at, y, length, LINE_PX);
      ctx.drawImage(across, 0, 0, length, LINE_PX, x + at, y + height - LINE_PX, length, LINE_PX);
    }
    for (let at = 0; at < height; at += STRIP_PX) {
      const length = Math.min(height - at, STRIP_PX);
      ctx.drawImage(down, 0, 0, LINE_PX, length, x, y + at, LINE_PX, length);
      ctx.drawImage(down, 0, 0, LINE_PX, length, x + width - LINE_PX, y + at, LINE_PX, length);
    }
  }
}

/** The outer rectangle of a line around a box. @param {Xyxy} rect @param {number} line */
function onPixels([x0, y0, x1, y1], line) {
  const x = Math.round(x0) - line / 2;
  const y = Math.round(y0) - line / 2;
  return { x, y, width: Math.max(2 * line, Math.round(x1) + line / 2 - x), height: Math.max(2 * line, Math.round(y1) + line / 2 - y) };
}

/** @param {Pen} pen @returns {Strips} */
function stripsOf({ color, casing, dash: [on = 0, off = 0] }) {
  const key = `${color} ${casing} ${on} ${off}`;
  const found = known.get(key);
  if (found) return found;
  const strips = { across: strip(color, casing, on, on + off, false), down: strip(color, casing, on, on + off, true) };
  known.set(key, strips);
  return strips;
}

/** @param {string} color @param {string} casing @param {number} on @param {number} period @param {boolean} isDown */
function strip(color, casing, on, period, isDown) {
  const canvas = isDown ? new OffscreenCanvas(LINE_PX, STRIP_PX) : new OffscreenCanvas(STRIP_PX, LINE_PX);
  const ctx = /** @type {OffscreenCanvasRenderingContext2D} */ (canvas.getContext("2d"));
  /** @param {string} fill @param {number} at @param {number} width */
  const lines = (fill, at, width) => {
    ctx.fillStyle = fill;
    for (let from = 0; from < STRIP_PX; from += period) {
      if (isDown) ctx.fillRect(at, from, width, on);
      else ctx.fillRect(from, at, on, width);
    }
  };
  lines(casing, 0, LINE_PX);
  lines(color, (LINE_PX - INK_PX) / 2, INK_PX);
  return canvas.transferToImageBitmap();
}
