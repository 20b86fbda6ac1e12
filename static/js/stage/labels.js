// @ts-check
// Texts on the stage: the full label of one box, and short ones where there is room.

import { shortText, VERDICT_SIGN } from "../wording.js";

/** @typedef {import("../types.js").Verdict} Verdict */
/** @typedef {import("../types.js").Xyxy} Xyxy */
/** @typedef {import("./paint.js").Inks} Inks */

const PADDING_PX = 6;
const FULL = { height: 22, font: "600 12px" };
const SHORT = { height: 16, font: "600 11px" };
const MOST_SHORT_LABELS = 80;
const SMALLEST_SIDE_PX = 18;
/** From here on labels would hide the scene: only boxes with room for theirs get one. */
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
  paintLines(ctx, lines, x + PADDING_PX, y, inks.text);
}

/**
 * Lines no wider than `width`: broken at " · ", and where that is not enough between words.
 * @param {Pick<CanvasRenderingContext2D, "measureText">} ctx @param {string} text @param {number} width @returns {string[]}
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

/** @param {CanvasRenderingContext2D} ctx @param {readonly string[]} lines @param {number} x @param {number} y @param {string} color */
function paintLines(ctx, lines, x, y, color) {
  ctx.fillStyle = color;
  ctx.textBaseline = "middle";
  for (const [i, line] of lines.entries()) ctx.fillText(line, x, y + FULL.height * (i + 0.5) + 0.5);
}

/** @param {CanvasRenderingContext2D} ctx @param {{x: number, y: number, width: number, height: number}} at @param {string} fill @param {string} [outline] */
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
 * Short labels of the largest boxes first, each only where no other is already.
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

/** Measured once per box: a pan asks for hundreds of them, frame after frame. @type {WeakMap<import("../types.js").Decision, {text: string, width: number, font: string}>} */
const shortLabels = new WeakMap();

/** @param {CanvasRenderingContext2D} ctx @param {import("../types.js").Decision} box */
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
