// @ts-check
// Geometry of the stage, pure functions: view transform, hit test, stacked boxes, overlaps.

/** @import { Decision, Xyxy } from "../boxes/box.js" */
/** @typedef {{width: number, height: number}} Size */
/** @typedef {{x: number, y: number}} Point */
/** @typedef {{scale: number, x: number, y: number}} View  stage = image * scale + (x, y) */

export const MAX_SCALE = 40;
const KEEP_VISIBLE_PX = 64;

/** Room for the bars over the stage, so that a fitted image is never covered. */
const INSETS = { side: 4, top: 56, bottom: 68 };

/**
 * The whole image, centred between the bars.
 * @param {Size} image @param {Size} stage @param {{side: number, top: number, bottom: number}} [insets] @returns {View}
 */
export function fitView(image, stage, insets = INSETS) {
  const { side, top, bottom } = insets;
  const scale = Math.min(
    Math.max(stage.width - 2 * side, 1) / image.width,
    Math.max(stage.height - top - bottom, 1) / image.height,
  );
  const view = centredOn({ x: image.width / 2, y: image.height / 2 }, scale, stage);
  return { ...view, y: view.y + (top - bottom) / 2 };
}

/** So much of the image is seen around a small box, px, or nobody would recognise the place. */
const LEAST_CONTEXT_PX = 96;

/** So far from the box's middle its hider is shown, px. */
const HIDER_REACH_PX = 96;

/**
 * How much of the image a close-up of a box shows, px: as much again on each side, enough to recognise the place, and
 * what hides the box, as far as it is near.
 * @param {Xyxy} xyxy @param {Xyxy | null} [hider] @returns {Size}
 */
export function contextOf([x0, y0, x1, y1], hider = null) {
  const margin = 1.5 * Math.max(x1 - x0, y1 - y0);
  /** @param {number} low @param {number} high @param {number} first @param {number} last  of the hider */
  const side = (low, high, first, last) => {
    const reach = Math.max((low + high) / 2 - first, last - (low + high) / 2);
    return Math.max(high - low + margin, LEAST_CONTEXT_PX, 2 * Math.min(reach + 4, HIDER_REACH_PX));
  };
  const [hx0, hy0, hx1, hy1] = hider ?? [x0, y0, x1, y1];
  return { width: side(x0, x1, hx0, hx1), height: side(y0, y1, hy0, hy1) };
}

/**
 * A box with its surroundings: in the middle, but for boxes near the edge of the image.
 * @param {Xyxy} xyxy @param {Size} stage @param {Size} image @param {Xyxy | null} [hider] @returns {View}
 */
export function cropView(xyxy, stage, image, hider = null) {
  const [x0, y0, x1, y1] = xyxy;
  const { width, height } = contextOf(xyxy, hider);
  const scale = Math.min(stage.width / width, stage.height / height, MAX_SCALE);
  const { x, y } = centredOn({ x: (x0 + x1) / 2, y: (y0 + y1) / 2 }, scale, stage);
  /**
   * Where the image is larger than the stage, it fills it.
   * @param {number} at @param {number} whole @param {number} room
   */
  const filled = (at, whole, room) => (whole < room ? at : clamp(at, room - whole, 0));
  return { scale, x: filled(x, image.width * scale, stage.width), y: filled(y, image.height * scale, stage.height) };
}

/**
 * The same view if a box is wholly on the stage; otherwise one with the same zoom that centres the box.
 * @param {View} view @param {Xyxy} xyxy @param {Size} stage @returns {View}
 */
export function revealView(view, xyxy, stage) {
  const [x0, y0, x1, y1] = toStage(view, xyxy);
  if (x0 >= 0 && y0 >= 0 && x1 <= stage.width && y1 <= stage.height) return view;
  return centredOn({ x: (xyxy[0] + xyxy[2]) / 2, y: (xyxy[1] + xyxy[3]) / 2 }, view.scale, stage);
}

/** @param {Point} centre image px @param {number} scale @param {Size} stage @returns {View} */
function centredOn(centre, scale, stage) {
  return { scale, x: stage.width / 2 - centre.x * scale, y: stage.height / 2 - centre.y * scale };
}

/**
 * Zoom so that the image point under `at` stays under it.
 * @param {View} view @param {number} factor @param {Point} at stage px @param {number} minScale
 * @returns {View}
 */
export function zoomAt(view, factor, at, minScale) {
  const scale = Math.min(Math.max(view.scale * factor, minScale), MAX_SCALE);
  const ratio = scale / view.scale;
  return { scale, x: at.x - (at.x - view.x) * ratio, y: at.y - (at.y - view.y) * ratio };
}

/** @param {View} view @param {number} dx @param {number} dy @returns {View} */
export const panBy = (view, dx, dy) => ({ ...view, x: view.x + dx, y: view.y + dy });

/**
 * The nearest view that still shows a corner of the image.
 * @param {View} view @param {Size} image @param {Size} stage @returns {View}
 */
export function clampView(view, image, stage) {
  const keep = Math.min(KEEP_VISIBLE_PX, image.width * view.scale, image.height * view.scale);
  return {
    scale: view.scale,
    x: Math.min(Math.max(view.x, keep - image.width * view.scale), stage.width - keep),
    y: Math.min(Math.max(view.y, keep - image.height * view.scale), stage.height - keep),
  };
}

/** @param {View} view @param {Xyxy} xyxy @returns {Xyxy} stage px */
export function toStage(view, [x0, y0, x1, y1]) {
  const { scale, x, y } = view;
  return [x0 * scale + x, y0 * scale + y, x1 * scale + x, y1 * scale + y];
}

/** @param {View} view @param {Point} at stage px @returns {Point} image px */
export const toImage = (view, at) => ({ x: (at.x - view.x) / view.scale, y: (at.y - view.y) / view.scale });

/** @param {Xyxy} xyxy @param {Size} stage */
export function isOnStage([x0, y0, x1, y1], stage) {
  return x1 > 0 && y1 > 0 && x0 < stage.width && y0 < stage.height;
}

/** @param {Xyxy} xyxy */
export const areaOf = ([x0, y0, x1, y1]) => Math.max(0, x1 - x0) * Math.max(0, y1 - y0);

/**
 * All boxes under a point, the smallest first, because it is the hardest to click otherwise.
 * @template {{xyxy: Xyxy | null}} B
 * @param {readonly B[]} boxes @param {Point} at image px @param {number} slack image px
 * @returns {B[]}
 */
export function boxesAt(boxes, at, slack) {
  /** @param {B} box */
  const isHit = ({ xyxy }) =>
    xyxy !== null &&
    at.x >= xyxy[0] - slack &&
    at.x <= xyxy[2] + slack &&
    at.y >= xyxy[1] - slack &&
    at.y <= xyxy[3] + slack;
  return boxes
    .filter(isHit)
    .sort((a, b) => areaOf(/** @type {Xyxy} */ (a.xyxy)) - areaOf(/** @type {Xyxy} */ (b.xyxy)));
}

/**
 * Boxes that overlap this one, those that share most with it first.
 * @template {{xyxy: Xyxy | null}} B
 * @param {readonly B[]} boxes @param {B} box
 * @returns {B[]}
 */
export function overlapping(boxes, box) {
  const mine = box.xyxy;
  if (!mine) return [];
  /** @param {B} other */
  const shared = ({ xyxy }) =>
    xyxy
      ? areaOf([
          Math.max(mine[0], xyxy[0]),
          Math.max(mine[1], xyxy[1]),
          Math.min(mine[2], xyxy[2]),
          Math.min(mine[3], xyxy[3]),
        ])
      : 0;
  const found = boxes.filter((other) => other !== box && shared(other) > 0);
  return found.sort((a, b) => shared(b) - shared(a));
}

/** Of a box, this share is covered by what it is behind, or inside of. */
const COVERED = { behind: 0.3, inside: 0.95 };

/**
 * The box that most likely hides another one: nearer, kept, and over the largest part of it.
 * @param {readonly Decision[]} boxes @param {Decision} box
 * @returns {{box: Decision, where: "inside" | "behind"} | null}
 */
export function hiderOf(boxes, box) {
  const { xyxy, distance } = box;
  if (!xyxy || distance === null) return null;
  const nearer = overlapping(boxes, box).find(
    (other) => other.effective_verdict === "kept" && (other.distance ?? Infinity) < distance,
  );
  if (!nearer?.xyxy) return null;
  const [x0, y0, x1, y1] = nearer.xyxy;
  const shared = areaOf([Math.max(xyxy[0], x0), Math.max(xyxy[1], y0), Math.min(xyxy[2], x1), Math.min(xyxy[3], y1)]);
  const share = shared / Math.max(areaOf(xyxy), 1e-9);
  if (share < COVERED.behind) return null;
  return { box: nearer, where: share < COVERED.inside ? "behind" : "inside" };
}

/** A box belongs to what was clicked if their rectangles share so much of both together. */
const LEAST_SHARED = 0.25;

/**
 * Boxes under a point in the order in which clicks select them: that of the clicked object, then kept ones, then
 * others.
 * @param {readonly Decision[]} hits  the smallest first
 * @param {Xyxy | null} object  the rectangle around the pixels of the clicked object, where that is known
 */
export function inClickOrder(hits, object) {
  const visible = [
    ...hits.filter((box) => box.effective_verdict === "kept"),
    ...hits.filter((box) => box.effective_verdict !== "kept"),
  ];
  if (!object) return visible;
  /** @param {Decision} box */
  const fit = ({ tight_xyxy: tight, xyxy }) => {
    const [x0, y0, x1, y1] = tight ?? /** @type {Xyxy} */ (xyxy);
    const both = areaOf([
      Math.max(x0, object[0]),
      Math.max(y0, object[1]),
      Math.min(x1, object[2]),
      Math.min(y1, object[3]),
    ]);
    return both / (areaOf([x0, y0, x1, y1]) + areaOf(object) - both);
  };
  const [best] = visible.filter((box) => fit(box) >= LEAST_SHARED).sort((a, b) => fit(b) - fit(a));
  return best ? [best, ...visible.filter((box) => box !== best)] : visible;
}

/**
 * The next of the stacked boxes: clicking again on the same place goes one deeper.
 * @template B
 * @param {readonly B[]} hits @param {B | undefined} current
 * @returns {B | undefined}
 */
export function nextOfStack(hits, current) {
  const i = current === undefined ? -1 : hits.indexOf(current);
  return hits[(i + 1) % hits.length];
}

/** Every pixel that a box touches; a box thinner than a pixel still has one. @param {Xyxy} xyxy @param {Size} image */
export function pixelBounds([x0, y0, x1, y1], image) {
  const left = clamp(Math.floor(x0), 0, image.width - 1);
  const top = clamp(Math.floor(y0), 0, image.height - 1);
  const right = clamp(Math.ceil(x1), left + 1, image.width);
  const bottom = clamp(Math.ceil(y1), top + 1, image.height);
  return { x: left, y: top, width: right - left, height: bottom - top };
}

/** @param {number} value @param {number} low @param {number} high */
export const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
