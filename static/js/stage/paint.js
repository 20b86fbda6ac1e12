// @ts-check
// Paints the two layers of the stage. While one pans, the boxes are painted once and then copied.

import { answerOf } from "../boxes/box.js";
import { distanceText, isFar, labelText } from "../boxes/wording.js";
import { areaOf, isOnStage, toStage } from "./geometry.js";
import { outline, paintLabel, paintMark, paintShortLabels, solidLines } from "./shapes.js";

/** @import { Decision, Verdict, Xyxy } from "../boxes/box.js" */
/** @import { View } from "./geometry.js" */
/** @import { Highlight } from "./pixels.js" */
/** @import { Snapshot } from "./stage.js" */
/**
 * @typedef {{stroke: Record<Verdict, string>, label: Record<Verdict, string>, text: string, casing: string, halo:
 *   string, edge: string, matching: string, unsure: string, font: string}} Inks
 */

/**
 * @typedef {object} Scene
 * @property {Snapshot} snapshot
 * @property {View} view
 * @property {{width: number, height: number}} size
 * @property {Decision | null} hovered
 * @property {ReadonlySet<Decision>} neighbours  of the selected box
 * @property {Inks} inks
 */

/** @typedef {{box: Decision, rect: Xyxy}} Placed */

/** @type {readonly Verdict[]} */
const VERDICTS = ["withheld", "unmeasured", "rejected", "kept"];

/** @type {Record<Verdict, number[]>} solid, dashed, dotted */
const DASHES = { kept: [], rejected: [7, 4], unmeasured: [2, 3], withheld: [] };

/** Opacity of the other boxes while one is selected: those that overlap it are dimmed less; and of far ones. */
const DIMMED = { neighbours: 0.62, others: 0.28, far: 0.3 };

const HIDER_LABEL_PX = 36;

/** From this scale on, pixels are drawn as sharp squares. */
const CRISP_FROM = 8;

/** The canvas takes its colours from the style sheet. @param {HTMLElement} host @returns {Inks} */
export function readInks(host) {
  const style = getComputedStyle(host);
  /** @param {string} name */
  const token = (name) => style.getPropertyValue(name).trim();
  return {
    stroke: {
      kept: token("--ink-kept"),
      rejected: token("--ink-rejected"),
      unmeasured: token("--ink-unmeasured"),
      withheld: token("--ink-unmeasured"),
    },
    label: {
      kept: token("--ink-kept-fill"),
      rejected: token("--ink-rejected-fill"),
      unmeasured: token("--ink-unmeasured-fill"),
      withheld: token("--ink-unmeasured-fill"),
    },
    text: token("--ink-text"),
    casing: token("--ink-casing"),
    halo: token("--ink-halo"),
    edge: token("--ink-edge"),
    matching: token("--ink-matching"),
    unsure: token("--ink-unsure-fill"),
    font: style.fontFamily,
  };
}

/**
 * @param {CanvasRenderingContext2D} ctx @param {Scene} scene
 * @param {(ctx: CanvasRenderingContext2D, scene: Scene) => void} [paintBoxes]
 */
export function paintBase(ctx, scene, paintBoxes = paintAllBoxes) {
  const { snapshot, size } = scene;
  ctx.clearRect(0, 0, size.width, size.height);
  paintPicture(ctx, snapshot.picture, scene);
  if (snapshot.mask && !snapshot.isBare) {
    ctx.globalAlpha = snapshot.opacity;
    paintPicture(ctx, snapshot.mask, scene, false);
  }
  ctx.globalAlpha = 1;
  if (!snapshot.isBare) paintBoxes(ctx, scene);
}

/**
 * All but the selected one, and short labels where there is room.
 * @param {CanvasRenderingContext2D} ctx @param {Scene} scene
 */
export function paintAllBoxes(ctx, scene) {
  const { snapshot, view, size, neighbours } = scene;
  const { selected } = snapshot;
  const placed = placedBoxes(snapshot.boxes, view, size).filter(({ box }) => box.box_id !== selected?.box_id);
  const others = placed.filter(({ box }) => !neighbours.has(box));
  const isFaint = (/** @type {Placed} */ { box }) => !snapshot.hasFar && isFar(box);
  ctx.globalAlpha = selected ? DIMMED.others * DIMMED.far : DIMMED.far;
  paintSome(ctx, others.filter(isFaint), scene.inks);
  ctx.globalAlpha = selected ? DIMMED.others : 1;
  paintSome(
    ctx,
    others.filter((one) => !isFaint(one)),
    scene.inks,
  );
  ctx.globalAlpha = selected ? DIMMED.neighbours : 1;
  paintSome(
    ctx,
    placed.filter(({ box }) => neighbours.has(box)),
    scene.inks,
  );
  if (!selected)
    paintShortLabels(
      ctx,
      placed.filter((one) => !isFaint(one)),
      scene,
    );
  ctx.globalAlpha = 1;
}

/** @param {CanvasRenderingContext2D} ctx @param {readonly Placed[]} placed @param {Inks} inks */
function paintSome(ctx, placed, inks) {
  for (const verdict of VERDICTS) {
    const rects = placed.filter(({ box }) => box.effective_verdict === verdict).map(({ rect }) => rect);
    outline(ctx, rects, { color: inks.stroke[verdict], casing: inks.casing, dash: DASHES[verdict] });
  }
  for (const { box, rect } of placed) paintMark(ctx, answerOf(box), rect, inks);
}

/**
 * @param {CanvasRenderingContext2D} ctx @param {CanvasImageSource | null} picture @param {Scene} scene
 * @param {boolean} [smooth]
 */
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
  const { selected, highlight, hider } = snapshot;
  ctx.clearRect(0, 0, size.width, size.height);
  if (snapshot.isBare) return;
  if (hovered?.xyxy && hovered.box_id !== selected?.box_id) paintForward(ctx, hovered, scene);
  if (!selected?.xyxy) return;
  if (hider?.xyxy) {
    const rect = toStage(view, hider.xyxy);
    outline(ctx, [rect], { color: inks.edge, casing: inks.casing, dash: [] });
    const away = distanceText(hider);
    // Below it: the selected box has its label above.
    const below = /** @type {Xyxy} */ ([rect[0], rect[3] + HIDER_LABEL_PX, rect[2], rect[3] + HIDER_LABEL_PX]);
    paintLabel(ctx, {
      text: `${hider.class} ${hider.id}${away ? ` at ${away}` : ""}`,
      verdict: "withheld",
      rect: below,
      size,
      inks,
    });
  }
  if (highlight) paintOutline(ctx, highlight, view, inks);
  if (snapshot.edges && selected.edges) paintEdges(ctx, selected.edges, view, inks);
  paintForward(ctx, selected, scene);
}

/**
 * The matching pixels, outlined: what they show stays visible.
 * @param {CanvasRenderingContext2D} ctx @param {Highlight} highlight
 * @param {View} view @param {Inks} inks
 */
function paintOutline(ctx, { outline }, { scale, x, y }, inks) {
  ctx.save();
  ctx.translate(x, y);
  ctx.scale(scale, scale);
  for (const [color, width] of /** @type {const} */ ([
    [inks.casing, 4],
    [inks.matching, 2],
  ])) {
    ctx.strokeStyle = color;
    ctx.lineWidth = width / scale;
    ctx.stroke(outline);
  }
  ctx.restore();
}

/**
 * A box in front of the others, with its full label.
 * @param {CanvasRenderingContext2D} ctx @param {Decision} box @param {Scene} scene
 */
function paintForward(ctx, box, { view, size, inks, snapshot }) {
  if (!box.xyxy) return;
  const rect = toStage(view, box.xyxy);
  const isSelected = box.box_id === snapshot.selected?.box_id;
  const verdict = box.effective_verdict;
  if (isSelected) solidLines(ctx, [rect], 6, inks.halo);
  outline(ctx, [rect], {
    color: inks.stroke[verdict],
    casing: isSelected ? inks.halo : inks.casing,
    dash: DASHES[verdict],
  });
  paintMark(ctx, answerOf(box), rect, inks);
  paintLabel(ctx, { text: labelText(box), verdict, rect, size, inks });
}

/**
 * @param {readonly Decision[]} boxes @param {View} view
 * @param {{width: number, height: number}} size @returns {Placed[]} those on the stage, large ones first
 */
function placedBoxes(boxes, view, size) {
  const placed = [];
  for (const box of largeFirst(boxes)) {
    if (!box.xyxy) continue;
    const rect = toStage(view, box.xyxy);
    if (isOnStage(rect, size)) placed.push({ box, rect });
  }
  return placed;
}

/**
 * The order does not depend on the view: sorted once for as long as the boxes are the same.
 * @type {WeakMap<readonly Decision[], readonly Decision[]>}
 */
const orders = new WeakMap();

/** @param {readonly Decision[]} boxes */
function largeFirst(boxes) {
  const known = orders.get(boxes);
  if (known) return known;
  /** @param {Decision} box */
  const area = ({ xyxy }) => (xyxy ? areaOf(xyxy) : 0);
  const order = [...boxes].sort((a, b) => area(b) - area(a));
  orders.set(boxes, order);
  return order;
}

/** @param {CanvasRenderingContext2D} ctx @param {readonly Xyxy[]} edges @param {View} view @param {Inks} inks */
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

const MARGIN_PX = 256;

/** @param {(ctx: CanvasRenderingContext2D, scene: Scene) => void} paint  draws the boxes of a scene */
export function createDrawnBoxes(paint) {
  const canvas = document.createElement("canvas");
  const own = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  /** What is on the canvas. @type {Scene | null} */
  let drawn = null;

  /** @param {Scene} scene @param {number} density */
  function holds(scene, density) {
    return (
      drawn !== null &&
      canvas.width === Math.round((scene.size.width + 2 * MARGIN_PX) * density) &&
      canvas.height === Math.round((scene.size.height + 2 * MARGIN_PX) * density) &&
      drawn.snapshot === scene.snapshot &&
      drawn.inks === scene.inks &&
      drawn.view.scale === scene.view.scale &&
      Math.abs(drawn.view.x - scene.view.x) <= MARGIN_PX &&
      Math.abs(drawn.view.y - scene.view.y) <= MARGIN_PX
    );
  }

  /** @param {Scene} scene @param {number} density */
  function draw(scene, density) {
    const size = { width: scene.size.width + 2 * MARGIN_PX, height: scene.size.height + 2 * MARGIN_PX };
    canvas.width = Math.round(size.width * density);
    canvas.height = Math.round(size.height * density);
    own.setTransform(density, 0, 0, density, 0, 0);
    const { scale, x, y } = scene.view;
    paint(own, { ...scene, size, view: { scale, x: x + MARGIN_PX, y: y + MARGIN_PX } });
    drawn = scene;
  }

  /**
   * Copy the boxes of a moving scene, shifted by whole pixels.
   * @param {CanvasRenderingContext2D} ctx @param {Scene} scene
   */
  return function copy(ctx, scene) {
    const density = ctx.getTransform().a;
    if (!holds(scene, density)) draw(scene, density);
    const from = /** @type {Scene} */ (drawn).view;
    const x = Math.round((scene.view.x - from.x) * density) / density - MARGIN_PX;
    const y = Math.round((scene.view.y - from.y) * density) / density - MARGIN_PX;
    ctx.imageSmoothingEnabled = false;
    ctx.drawImage(canvas, x, y, canvas.width / density, canvas.height / density);
  };
}

/** @typedef {ReturnType<typeof createDrawnBoxes>} DrawnBoxes */
