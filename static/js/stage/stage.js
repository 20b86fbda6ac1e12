// @ts-check
// The stage: two layers of canvas, drawn in requestAnimationFrame from a snapshot and a view. Changes of the view are
// animated.

import {
  boxesAt,
  clamp,
  clampView,
  cropView,
  fitView,
  inClickOrder,
  nextOfStack,
  overlapping,
  panBy,
  revealView,
  toImage,
  zoomAt,
} from "./geometry.js";
import { listen } from "./input.js";
import { createDrawnBoxes, paintAllBoxes, paintBase, paintTop, readInks } from "./paint.js";

/** @import { Decision, Xyxy } from "../boxes/box.js" */
/** @import { Point, View } from "./geometry.js" */
/** @import { Highlight, Objects } from "./pixels.js" */

/**
 * @typedef {object} Snapshot  everything that is drawn
 * @property {{width: number, height: number}} image  its size, px
 * @property {CanvasImageSource | null} picture
 * @property {CanvasImageSource | null} mask  the segmentation, painted
 * @property {number} opacity  of the mask
 * @property {readonly Decision[]} boxes
 * @property {Decision | null} selected  one of `boxes`
 * @property {Highlight | null} highlight
 * @property {boolean} edges
 * @property {boolean} isWhole  the picture is there, or the frame has none
 * @property {boolean} crop  show the selected box's surroundings rather than the frame
 * @property {boolean} [isBare]  show the picture alone
 * @property {Decision | null} [hider]  the box that most likely hides the selected one
 * @property {Objects | null} [objects]  what the picture shows, for clicks
 * @property {boolean} [hasFar]  draw far boxes as strong as others
 * @property {number} [scene]  a changed number means another scene: the view jumps there without an animation
 */

/**
 * @typedef {object} StageEvents
 * @property {(boxId: number | null) => void} onSelect
 * @property {(scale: number) => void} onZoom
 * @property {(isOnBox: boolean) => void} onCrop  a double click
 * @property {((dx: number, isEnd: boolean) => void) | null} onSwipe  as `swipe` of a gesture; null: a finger pans
 */

const CLICK_SLACK_PX = 4;

/** The longest look that an answer can say: a day. */
const MOST_LOOKED_MS = 86_400_000;

/** After such a pause of a pan, the boxes are painted again in full quality. */
const REST_MS = 100;

/** @param {HTMLElement} host @param {StageEvents} events */
export function createStage(host, events) {
  const base = layerIn(host, "base");
  const top = layerIn(host, "top");
  const size = { width: 0, height: 0 };
  /** @type {Snapshot | null} */
  let snapshot = null;
  /** @type {View} */
  let view = { scale: 1, x: 0, y: 0 };
  /** @type {Decision | null} */
  let hovered = null;
  /** What overlaps the selected box. @type {ReadonlySet<Decision>} */
  let neighbours = new Set();
  /**
   * What a resize or another selection restores: the whole frame, the box, or the person's own view.
   * @type {"fit" | "crop" | "free"}
   */
  let mode = "fit";
  let inks = readInks(host);
  let dirty = { base: false, top: false };
  let hadTop = true;
  let isPanning = false;
  let rest = 0;
  /** The selected box, and since when it is painted with the picture (ms); null until then. */
  let painted = { boxId: /** @type {number | null} */ (null), since: 0 };
  const copyBoxes = createDrawnBoxes(paintAllBoxes);
  let request = 0;

  /** @param {"all" | "top"} what */
  function invalidate(what) {
    dirty = { base: dirty.base || what === "all", top: true };
    request ||= requestAnimationFrame(draw);
  }

  function draw() {
    request = 0;
    if (!snapshot || size.width === 0) return;
    const scene = { snapshot, view, size, hovered, neighbours, inks };
    if (dirty.base) paintBase(base, scene, isPanning ? copyBoxes : undefined);
    // An empty layer stays empty: clearing it would make the browser copy it.
    const hasTop = hovered !== null || snapshot.selected !== null;
    if (dirty.top && (hasTop || hadTop)) paintTop(top, scene);
    hadTop = hasTop;
    dirty = { base: false, top: false };
    const boxId = snapshot.isWhole ? (snapshot.selected?.box_id ?? null) : null;
    if (boxId !== painted.boxId) painted = { boxId, since: performance.now() };
    host.dataset.painted = String(boxId ?? "");
    host.dataset.view = `${view.scale} ${view.x} ${view.y}`;
    host.dataset.drawn = String(Number(host.dataset.drawn ?? 0) + 1);
  }

  /** @param {View} next */
  function show(next) {
    if (!snapshot) return;
    if (next.scale !== view.scale) events.onZoom(next.scale);
    view = clampView(next, snapshot.image, size);
    invalidate("all");
  }

  const glide = createGlide(() => view, show);
  const minScale = () => (snapshot ? Math.min(fitView(snapshot.image, size).scale, 1) * 0.5 : 0.1);

  /** @param {boolean} smoothly */
  function fit(smoothly) {
    mode = "fit";
    if (snapshot) glide.to(fitView(snapshot.image, size), smoothly);
  }

  /** @param {Xyxy} xyxy @param {boolean} smoothly */
  function crop(xyxy, smoothly) {
    mode = "crop";
    if (snapshot) glide.to(cropView(xyxy, size, snapshot.image, snapshot.hider?.xyxy), smoothly);
  }

  /** Show again what the mode says: the box in crop mode, the whole image in fit mode. @param {boolean} smoothly */
  function restore(smoothly) {
    const xyxy = snapshot?.selected?.xyxy;
    if (mode === "free") show(view);
    else if (snapshot?.crop && xyxy) crop(xyxy, smoothly);
    else fit(smoothly);
  }

  /**
   * Move the view when another box is selected or the crop is switched.
   * @param {Snapshot} before @param {Snapshot} next
   */
  function follow(before, next) {
    const isMove = before.selected?.box_id !== next.selected?.box_id;
    if (before.crop !== next.crop || (isMove && mode === "crop" && next.selected)) {
      mode = next.crop ? "crop" : "fit";
      restore(true);
    } else if (isMove && mode === "free" && next.selected?.xyxy) {
      glide.to(revealView(view, next.selected.xyxy, size), true);
    }
  }

  /** @param {Point} at */
  function hitsAt(at) {
    if (!snapshot) return [];
    const place = toImage(view, at);
    const hits = boxesAt(snapshot.boxes, place, CLICK_SLACK_PX / view.scale);
    return hits.length > 1 ? inClickOrder(hits, snapshot.objects?.at(place) ?? null) : hits;
  }

  /** @param {Decision | null} box */
  function hover(box) {
    if (box?.box_id === hovered?.box_id) return;
    hovered = box;
    host.classList.toggle("is-over-box", box !== null);
    invalidate("top");
  }

  const stopListening = listen(host, {
    pan(dx, dy) {
      mode = "free";
      glide.stop();
      isPanning = true;
      clearTimeout(rest);
      rest = setTimeout(() => {
        isPanning = false;
        invalidate("all");
      }, REST_MS);
      show(panBy(view, dx, dy));
    },
    zoom(factor, at) {
      mode = "free";
      isPanning = false;
      glide.stop();
      show(zoomAt(view, factor, at, minScale()));
    },
    hover: (at) => hover(at ? (hitsAt(at)[0] ?? null) : null),
    click(at) {
      const hits = hitsAt(at);
      const current = hits.find(({ box_id }) => box_id === snapshot?.selected?.box_id);
      events.onSelect(nextOfStack(hits, current)?.box_id ?? null);
    },
    canSwipe: () => events.onSwipe !== null && mode !== "free",
    swipe: (dx, isEnd) => events.onSwipe?.(dx, isEnd),
    doubleClick(at) {
      events.onCrop(hitsAt(at)[0] !== undefined);
    },
  });

  const resizes = new ResizeObserver(() => {
    size.width = host.clientWidth;
    size.height = host.clientHeight;
    for (const layer of [base, top]) fitLayer(layer, size);
    restore(false);
    // A canvas of a new size is empty: it is painted before the browser shows it.
    cancelAnimationFrame(request);
    draw();
  });
  resizes.observe(host);

  return {
    /** @param {Snapshot} next */
    update(next) {
      const before = snapshot;
      const isNewScene = next.scene !== before?.scene;
      const isNewImage =
        isNewScene || next.image.width !== before?.image.width || next.image.height !== before?.image.height;
      if (isNewScene) mode = next.crop ? "crop" : "fit";
      if (next.boxes !== before?.boxes || next.selected !== before.selected) {
        neighbours = new Set(next.selected ? overlapping(next.boxes, next.selected) : []);
      }
      snapshot = next;
      if (hovered) hovered = next.boxes.find(({ box_id }) => box_id === hovered?.box_id) ?? null;
      if (before && !isNewImage) follow(before, next);
      else restore(false);
      const keys = /** @type {(keyof Snapshot)[]} */ (Object.keys(next));
      const isHighlight = before && keys.every((key) => key === "highlight" || Object.is(before[key], next[key]));
      invalidate(isHighlight ? "top" : "all");
    },
    fit: () => fit(true),
    mode: () => mode,
    /** For how long a person has been shown this box with its picture (ms); null: not yet. @param {number} boxId */
    lookedMs: (boxId) =>
      painted.boxId === boxId ? Math.round(clamp(performance.now() - painted.since, 0, MOST_LOOKED_MS)) : null,
    /** Crop again after a pan or a zoom. */
    recrop() {
      mode = "crop";
      restore(true);
    },
    /** @param {number} factor */
    zoomBy(factor) {
      mode = "free";
      const centre = { x: size.width / 2, y: size.height / 2 };
      glide.to(zoomAt(glide.target(), factor, centre, minScale()), true);
    },
    /** Colours come from the style sheet: read them again after a change of theme. */
    restyle() {
      inks = readInks(host);
      invalidate("all");
    },
    destroy() {
      cancelAnimationFrame(request);
      clearTimeout(rest);
      glide.stop();
      resizes.disconnect();
      stopListening();
      host.replaceChildren();
    },
  };
}

/** @typedef {ReturnType<typeof createStage>} Stage */

/** @param {HTMLElement} host @param {string} name */
function layerIn(host, name) {
  const canvas = document.createElement("canvas");
  canvas.className = `stage__layer stage__layer--${name}`;
  canvas.setAttribute("aria-hidden", "true");
  host.append(canvas);
  return /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
}

/** @param {CanvasRenderingContext2D} layer @param {{width: number, height: number}} size */
function fitLayer(layer, size) {
  const density = Math.min(devicePixelRatio || 1, 2);
  layer.canvas.width = Math.round(size.width * density);
  layer.canvas.height = Math.round(size.height * density);
  layer.setTransform(density, 0, 0, density, 0, 0);
}

const DURATION_MS = 160;

/** @param {() => View} current @param {(view: View) => void} show */
function createGlide(current, show) {
  /** @type {View | null} */
  let goal = null;
  let request = 0;

  function stop() {
    cancelAnimationFrame(request);
    goal = null;
  }

  /** @param {View} target @param {boolean} smoothly */
  function to(target, smoothly) {
    stop();
    if (!smoothly || matchMedia("(prefers-reduced-motion: reduce)").matches) {
      show(target);
      return;
    }
    goal = target;
    const from = current();
    const start = performance.now();
    /** @param {number} now */
    const step = (now) => {
      const share = Math.min(Math.max(0, now - start) / DURATION_MS, 1);
      show(between(from, target, 1 - (1 - share) ** 3));
      if (share < 1) request = requestAnimationFrame(step);
      else goal = null;
    };
    request = requestAnimationFrame(step);
  }

  return { to, stop, target: () => goal ?? current() };
}

/**
 * Scale moves geometrically, so that zooming feels even.
 * @param {View} a @param {View} b @param {number} share @returns {View}
 */
function between(a, b, share) {
  if (share === 1) return b;
  const scale = a.scale * (b.scale / a.scale) ** share;
  const same = Math.abs(b.scale - a.scale) < 1e-9;
  const t = same ? share : (scale - a.scale) / (b.scale - a.scale);
  return { scale, x: a.x + (b.x - a.x) * t, y: a.y + (b.y - a.y) * t };
}
