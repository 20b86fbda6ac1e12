// @ts-check
// Draws outlines, signs of answers, and labels on the canvas, fast enough for hundreds of boxes.

import { VERDICT_SIGN, shortText } from "../boxes/wording.js";

/** @import { Decision, Verdict, Xyxy } from "../boxes/box.js" */
/** @import { Inks } from "./paint.js" */
/** @typedef {{color: string, casing: string, dash: readonly number[]}} Pen  whole px; dash: on, off */
/** @typedef {{across: ImageBitmap, down: ImageBitmap}} Strips */

/** Width of a line, without and with the casing on both sides. */
const INK_PX = 2;
const LINE_PX = 4;

/** Length of a prepared piece of a dashed line, a multiple of every dash; longer edges repeat it. */
const STRIP_PX = 2 * 3 * 5 * 11 * 4;

/** @type {Map<string, Strips>} */
const known = new Map();

/**
 * Outlines on whole pixels. Dashes begin at each box's corner, so they move with it.
 * @param {CanvasRenderingContext2D} ctx @param {readonly Xyxy[]} rects @param {Pen} pen
 */
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
  return {
    x,
    y,
    width: Math.max(2 * line, Math.round(x1) + line / 2 - x),
    height: Math.max(2 * line, Math.round(y1) + line / 2 - y),
  };
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

const PADDING_PX = 6;

const FULL = { height: 22, font: "600 12px" };

const SHORT = { height: 16, font: "600 11px" };

const MOST_SHORT_LABELS = 80;
const SMALLEST_SIDE_PX = 18;

/** With more boxes than this, only boxes wide enough for their label get one. */
const CROWDED = 50;

/**
 * Above the box, or inside it at the stage's top; never past the stage's sides.
 * @param {CanvasRenderingContext2D} ctx
 * @param {{text: string, verdict: Verdict, rect: Xyxy, size: {width: number, height: number}, inks: Inks}} label
 */
export function paintLabel(ctx, { text, verdict, rect, size, inks }) {
  ctx.font = `${FULL.font} ${inks.font}`;
  const signed = `${VERDICT_SIGN[verdict]}  ${text}`;
  const lines = brokenToFit(ctx, signed, size.width - 4 * PADDING_PX);
  const width = Math.max(...lines.map((line) => ctx.measureText(line).width)) + 2 * PADDING_PX;
  const height = FULL.height * lines.length;
  const x = Math.min(Math.max(rect[0] - 1, PADDING_PX), Math.max(PADDING_PX, size.width - width - PADDING_PX));
  const above = rect[1] - height - 8;
  const below = Math.min(rect[3] + 8, size.height - height - PADDING_PX);
  const y = above >= PADDING_PX ? above : Math.max(PADDING_PX, below);
  paintPlate(ctx, { x, y, width, height }, inks.label[verdict], inks.halo);
  ctx.fillStyle = inks.text;
  ctx.textBaseline = "middle";
  for (const [i, line] of lines.entries()) ctx.fillText(line, x + PADDING_PX, y + FULL.height * (i + 0.5) + 0.5);
}

/**
 * Lines no wider than `width`: broken at " · ", and where that is not enough between words.
 * @param {Pick<CanvasRenderingContext2D, "measureText">} ctx @param {string} text @param {number} width
 * @returns {string[]}
 */
export function brokenToFit(ctx, text, width) {
  const fits = (/** @type {string} */ line) => ctx.measureText(line).width <= width;
  if (fits(text)) return [text];
  return text.split(" · ").flatMap((part) => {
    const [first = "", ...words] = part.split(/(?<=\S) (?=\S)/);
    const lines = [first];
    for (const word of words) {
      const longer = `${lines.at(-1)} ${word}`;
      if (fits(longer)) lines[lines.length - 1] = longer;
      else lines.push(word);
    }
    return lines;
  });
}

/**
 * @param {CanvasRenderingContext2D} ctx @param {{x: number, y: number, width: number, height: number}} at
 * @param {string} fill @param {string} [outline]
 */
function paintPlate(ctx, at, fill, outline) {
  ctx.beginPath();
  ctx.roundRect(at.x, at.y, at.width, at.height, 4);
  ctx.fillStyle = fill;
  ctx.fill();
  if (!outline) return;
  ctx.strokeStyle = outline;
  ctx.lineWidth = 1;
  ctx.stroke();
}

/**
 * Short labels, of the largest boxes first, each only where it covers no other label.
 * @param {CanvasRenderingContext2D} ctx @param {readonly import("./paint.js").Placed[]} placed
 * @param {{inks: Inks, size: {width: number, height: number}}} scene
 */
export function paintShortLabels(ctx, placed, { inks, size }) {
  ctx.font = `${SHORT.font} ${inks.font}`;
  /** @type {Xyxy[]} */
  const taken = [];
  for (const { box, rect } of placed) {
    if (taken.length >= MOST_SHORT_LABELS) return;
    if (rect[3] - rect[1] < SMALLEST_SIDE_PX) continue;
    const { text, width } = shortLabel(ctx, box);
    if (placed.length > CROWDED && rect[2] - rect[0] < width) continue;
    const x = Math.max(rect[0] - 1, 0);
    const y = rect[1] - SHORT.height >= 0 ? rect[1] - SHORT.height : Math.max(rect[1], 0);
    /** @type {Xyxy} */
    const area = [x, y, x + width, y + SHORT.height];
    if (area[2] > size.width || taken.some((other) => overlap(area, other))) continue;
    taken.push(area);
    paintPlate(ctx, { x, y, width, height: SHORT.height }, inks.label[box.effective_verdict]);
    ctx.fillStyle = inks.text;
    ctx.textBaseline = "middle";
    ctx.fillText(text, x + 4, y + SHORT.height / 2 + 0.5);
  }
}

/**
 * Measured once per box: a pan asks for hundreds of them, frame after frame.
 * @type {WeakMap<Decision, {text: string, width: number, font: string}>}
 */
const shortLabels = new WeakMap();

/** @param {CanvasRenderingContext2D} ctx @param {Decision} box */
function shortLabel(ctx, box) {
  const known = shortLabels.get(box);
  if (known?.font === ctx.font) return known;
  const text = `${VERDICT_SIGN[box.effective_verdict]} ${shortText(box)}`;
  const label = { text, width: ctx.measureText(text).width + 8, font: ctx.font };
  shortLabels.set(box, label);
  return label;
}

/** @param {Xyxy} a @param {Xyxy} b */
const overlap = (a, b) => a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];

/** @typedef {"keep" | "reject" | "unsure"} Given */

const RADIUS_PX = 7;
const SIDE_PX = 2 * RADIUS_PX + 4;

/** Sharp on every screen, and when the browser is zoomed. */
const DENSITY = 3;

/** @type {Map<string, HTMLCanvasElement>} */
const signs = new Map();

/**
 * The sign of an answer, on the top right corner of its box.
 * @param {CanvasRenderingContext2D} ctx @param {Given | null} answer @param {Xyxy} rect
 * @param {Inks} inks
 */
export function paintMark(ctx, answer, [, y0, x1], inks) {
  if (!answer) return;
  ctx.imageSmoothingEnabled = true;
  ctx.drawImage(signOf(answer, inks), x1 - SIDE_PX / 2, y0 - SIDE_PX / 2, SIDE_PX, SIDE_PX);
}

/** @param {Given} answer @param {Inks} inks */
function signOf(answer, inks) {
  const fill = { keep: inks.label.kept, reject: inks.label.rejected, unsure: inks.unsure }[answer];
  const key = `${answer} ${fill} ${inks.text}`;
  const known = signs.get(key);
  if (known) return known;
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = SIDE_PX * DENSITY;
  const ctx = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  ctx.setTransform(DENSITY, 0, 0, DENSITY, canvas.width / 2, canvas.height / 2);
  ctx.beginPath();
  ctx.arc(0, 0, RADIUS_PX, 0, 2 * Math.PI);
  ctx.fillStyle = fill;
  ctx.fill();
  ctx.strokeStyle = inks.text;
  ctx.lineWidth = 1.5;
  ctx.stroke();
  paintSign(ctx, answer, inks);
  signs.set(key, canvas);
  return canvas;
}

/** Around the origin. @param {CanvasRenderingContext2D} ctx @param {Given} answer @param {Inks} inks */
function paintSign(ctx, answer, inks) {
  ctx.beginPath();
  if (answer === "keep") {
    ctx.moveTo(-3, 0.2);
    ctx.lineTo(-0.8, 2.6);
    ctx.lineTo(3.2, -2.4);
  } else if (answer === "reject") {
    ctx.moveTo(-2.4, -2.4);
    ctx.lineTo(2.4, 2.4);
    ctx.moveTo(2.4, -2.4);
    ctx.lineTo(-2.4, 2.4);
  } else {
    ctx.font = `700 10px ${inks.font}`;
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    ctx.fillStyle = inks.text;
    ctx.fillText("?", 0, 0.5);
  }
  ctx.lineCap = "round";
  ctx.lineWidth = 1.75;
  ctx.stroke();
}
