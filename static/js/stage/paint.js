// @ts-check
// What the two layers look like. Base: image, mask, all boxes but the selected one. Top: lit
// pixels, hovered and selected box, labels. Verdicts differ in stroke and sign, not only in colour.

import { areaOf, isOnStage, toStage } from "../geometry.js";
import { answerOf } from "../reviews.js";
import { labelText } from "../wording.js";
import { paintLabel, paintShortLabels } from "./labels.js";

/** @typedef {import("../types.js").Decision} Decision */
/** @typedef {import("../types.js").Verdict} Verdict */
/** @typedef {import("../types.js").Xyxy} Xyxy */
/** @typedef {{stroke: Record<Verdict, string>, label: Record<Verdict, string>, text: string, casing: string, halo: string, edge: string, unsure: string, font: string}} Inks */
/**
 * @typedef {object} Scene
 * @property {import("./stage.js").Snapshot} snapshot
 * @property {import("../geometry.js").View} view
 * @property {{width: number, height: number}} size
 * @property {Decision | null} hovered
 * @property {Inks} inks
 */
/** @typedef {{box: Decision, rect: Xyxy}} Placed */

/** @type {readonly Verdict[]} */
const VERDICTS = ["unmeasured", "rejected", "kept"];

/** @type {Record<Verdict, number[]>} solid, dashed, dotted */
const DASHES = { kept: [], rejected: [7, 4], unmeasured: [1.5, 3.5] };

const DIMMED = 0.38;
/** Closer than this one looks at pixels, not at the scene. */
const CRISP_FROM = 8;
const MARK_RADIUS_PX = 7;

/** The canvas takes its colours from the style sheet. @param {HTMLElement} host @returns {Inks} */
export function readInks(host) {
  const style = getComputedStyle(host);
  /** @param {string} name */
  const token = (name) => style.getPropertyValue(name).trim();
  return {
    stroke: { kept: token("--ink-kept"), rejected: token("--ink-rejected"), unmeasured: token("--ink-unmeasured") },
    label: { kept: token("--ink-kept-fill"), rejected: token("--ink-rejected-fill"), unmeasured: token("--ink-unmeasured-fill") },
    text: token("--ink-text"),
    casing: token("--ink-casing"),
    halo: token("--ink-halo"),
    edge: token("--ink-edge"),
    unsure: token("--ink-unsure-fill"),
    font: style.fontFamily,
  };
}

/** @param {CanvasRenderingContext2D} ctx @param {Scene} scene */
export function paintBase(ctx, scene) {
  const { snapshot, view, size } = scene;
  ctx.clearRect(0, 0, size.width, size.height);
  paintPicture(ctx, snapshot.picture, scene);
  if (snapshot.mask) {
    ctx.globalAlpha = snapshot.opacity;
    paintPicture(ctx, snapshot.mask, scene, false);
  }
  const selectedId = snapshot.selected?.box_id;
  const placed = placedBoxes(snapshot.boxes, view, size).filter(({ box }) => box.box_id !== selectedId);
  ctx.globalAlpha = snapshot.selected ? DIMMED : 1;
  for (const verdict of VERDICTS) {
    strokeBoxes(ctx, placed.filter(({ box }) => box.effective_verdict === verdict), verdict, scene.inks);
  }
  for (const { box, rect } of placed) paintMark(ctx, box, rect, scene.inks);
  if (!snapshot.selected) paintShortLabels(ctx, placed, scene);
  ctx.globalAlpha = 1;
}

/** @param {CanvasRenderingContext2D} ctx @param {CanvasImageSource | null} picture @param {Scene} scene @param {boolean} [smooth] */
function paintPicture(ctx, picture, { snapshot, view }, smooth = view.scale < CRISP_FROM) {
  if (!picture) return;
  ctx.imageSmoothingEnabled = smooth;
  ctx.imageSmoothingQuality = "medium";
  const { width, height } = snapshot.image;
  ctx.drawImage(picture, view.x, view.y, width * view.scale, height * view.scale);
}

/** @param {CanvasRenderingContext2D} ctx @param {Scene} scene */
export function paintTop(ctx, scene) {
  const { snapshot, view, size, hovered, inks } = scene;
  const { selected, lit } = snapshot;
  ctx.clearRect(0, 0, size.width, size.height);
  if (hovered?.xyxy && hovered.box_id !== selected?.box_id) paintForward(ctx, hovered, scene);
  if (!selected?.xyxy) return;
  if (lit) paintLit(ctx, lit, view);
  if (snapshot.edges && selected.edges) paintEdges(ctx, selected.edges, view, inks);
  paintForward(ctx, selected, scene);
}

/** @param {CanvasRenderingContext2D} ctx @param {import("./pixels.js").Lit} lit @param {import("../geometry.js").View} view */
function paintLit(ctx, { canvas, bounds }, view) {
  ctx.imageSmoothingEnabled = false;
  const { scale, x, y } = view;
  ctx.drawImage(canvas, bounds.x * scale + x, bounds.y * scale + y, bounds.width * scale, bounds.height * scale);
}

/** A box in front of the others, with everything that is known about it. @param {CanvasRenderingContext2D} ctx @param {Decision} box @param {Scene} scene */
function paintForward(ctx, box, { view, size, inks, snapshot }) {
  if (!box.xyxy) return;
  const rect = toStage(view, box.xyxy);
  const isSelected = box.box_id === snapshot.selected?.box_id;
  const verdict = box.effective_verdict;
  strokeRects(ctx, [rect], { color: isSelected ? inks.halo : inks.casing, width: isSelected ? 6 : 4, dash: [] });
  strokeRects(ctx, [rect], { color: inks.stroke[verdict], width: 2.5, dash: DASHES[verdict] });
  paintMark(ctx, box, rect, inks);
  paintLabel(ctx, { text: labelText(box), verdict, rect, size, inks });
}

/** @param {readonly Decision[]} boxes @param {import("../geometry.js").View} view @param {{width: number, height: number}} size @returns {Placed[]} those on the stage, large ones first */
function placedBoxes(boxes, view, size) {
  const placed = [];
  for (const box of boxes) {
    if (!box.xyxy) continue;
    const rect = toStage(view, box.xyxy);
    if (isOnStage(rect, size)) placed.push({ box, rect });
  }
  return placed.sort((a, b) => areaOf(b.rect) - areaOf(a.rect));
}

/** @param {CanvasRenderingContext2D} ctx @param {readonly Placed[]} placed @param {Verdict} verdict @param {Inks} inks */
function strokeBoxes(ctx, placed, verdict, inks) {
  const rects = placed.map(({ rect }) => rect);
  strokeRects(ctx, rects, { color: inks.casing, width: 3.5, dash: DASHES[verdict] });
  strokeRects(ctx, rects, { color: inks.stroke[verdict], width: 1.75, dash: DASHES[verdict] });
}

/** All rectangles of one pen in one path: a frame with 500 boxes needs six strokes. @param {CanvasRenderingContext2D} ctx @param {readonly Xyxy[]} rects @param {{color: string, width: number, dash: number[]}} pen */
function strokeRects(ctx, rects, pen) {
  if (rects.length === 0) return;
  ctx.beginPath();
  for (const [x0, y0, x1, y1] of rects) ctx.rect(x0, y0, x1 - x0, y1 - y0);
  ctx.strokeStyle = pen.color;
  ctx.lineWidth = pen.width;
  ctx.lineCap = pen.dash === DASHES.unmeasured ? "round" : "butt";
  ctx.setLineDash(pen.dash);
  ctx.stroke();
  ctx.setLineDash([]);
}

/** @param {CanvasRenderingContext2D} ctx @param {readonly Xyxy[]} edges @param {import("../geometry.js").View} view @param {Inks} inks */
function paintEdges(ctx, edges, view, inks) {
  ctx.beginPath();
  for (const edge of edges) {
    const [x0, y0, x1, y1] = toStage(view, edge);
    ctx.moveTo(x0, y0);
    ctx.lineTo(x1, y1);
  }
  ctx.lineCap = "round";
  ctx.strokeStyle = inks.casing;
  ctx.lineWidth = 3;
  ctx.stroke();
  ctx.strokeStyle = inks.edge;
  ctx.lineWidth = 1.25;
  ctx.stroke();
}

/** A person's answer: a filled sign on the top right corner. @param {CanvasRenderingContext2D} ctx @param {Decision} box @param {Xyxy} rect @param {Inks} inks */
function paintMark(ctx, box, [, y0, x1], inks) {
  const answer = answerOf(box);
  if (!answer) return;
  const fill = { keep: inks.label.kept, reject: inks.label.rejected, unsure: inks.unsure }[answer];
  ctx.beginPath();
  ctx.arc(x1, y0, MARK_RADIUS_PX, 0, 2 * Math.PI);
  ctx.fillStyle = fill;
  ctx.fill();
  ctx.strokeStyle = inks.text;
  ctx.lineWidth = 1.5;
  ctx.stroke();
  paintSign(ctx, answer, x1, y0, inks);
}

/** @param {CanvasRenderingContext2D} ctx @param {"keep" | "reject" | "unsure"} answer @param {number} x @param {number} y @param {Inks} inks */
function paintSign(ctx, answer, x, y, inks) {
  ctx.beginPath();
  if (answer === "keep") {
    ctx.moveTo(x - 3, y + 0.2);
    ctx.lineTo(x - 0.8, y + 2.6);
    ctx.lineTo(x + 3.2, y - 2.4);
  } else if (answer === "reject") {
    ctx.moveTo(x - 2.4, y - 2.4);
    ctx.lineTo(x + 2.4, y + 2.4);
    ctx.moveTo(x + 2.4, y - 2.4);
    ctx.lineTo(x - 2.4, y + 2.4);
  } else {
    ctx.font = `700 10px ${inks.font}`;
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    ctx.fillStyle = inks.text;
    ctx.fillText("?", x, y + 0.5);
    ctx.textAlign = "left";
  }
  ctx.lineCap = "round";
  ctx.lineWidth = 1.75;
  ctx.stroke();
}
