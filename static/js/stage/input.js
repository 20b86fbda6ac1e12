// @ts-check
// Translates pointer and wheel events into pan, zoom, hover and click.

/** @import { Point } from "./geometry.js" */

/**
 * @typedef {object} Gestures
 * @property {(dx: number, dy: number) => void} pan
 * @property {(factor: number, at: Point) => void} zoom
 * @property {(at: Point | null) => void} hover
 * @property {(at: Point) => void} click
 * @property {(at: Point) => void} doubleClick
 * @property {() => boolean} canSwipe  whether one finger that moves swipes, and does not pan
 * @property {(dx: number, isEnd: boolean) => void} swipe  so many px to the right since it began; 0: it was given up
 */

/** A pointer that moved less than this has clicked. */
const CLICK_RADIUS_PX = 5;
const LINE_PX = 16;

/** @param {HTMLElement} host @param {Gestures} gestures @returns {() => void} stop listening */
export function listen(host, gestures) {
  /** @type {Map<number, Point>} */
  const pointers = new Map();
  let travelled = 0;
  let pinched = false;
  /** Where a finger that swipes has begun, px of the window: what it swipes may follow it. @type {number | null} */
  let swiped = null;
  const stop = new AbortController();

  /** @param {MouseEvent} event @returns {Point} */
  const at = (event) => {
    const corner = host.getBoundingClientRect();
    return { x: event.clientX - corner.left, y: event.clientY - corner.top };
  };

  /** @template {keyof HTMLElementEventMap} K @param {K} type @param {(event: HTMLElementEventMap[K]) => void} handle */
  const on = (type, handle) => host.addEventListener(type, handle, { signal: stop.signal, passive: false });

  on("pointerdown", (event) => {
    if (event.button !== 0 && event.button !== 1) return;
    host.setPointerCapture(event.pointerId);
    if (pointers.size === 0) {
      travelled = 0;
      pinched = false;
      swiped = event.pointerType === "touch" && gestures.canSwipe() ? event.clientX : null;
    } else endSwipe();
    pointers.set(event.pointerId, at(event));
  });

  on("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    const now = at(event);
    if (!before) return gestures.hover(now);
    if (swiped !== null) swipe(event.clientX - swiped, before, now);
    else if (pointers.size === 2) pinch(event.pointerId, before, now);
    else drag(before, now);
    pointers.set(event.pointerId, now);
  });

  /** A second finger, or the browser, has taken the gesture over. */
  function endSwipe() {
    if (swiped !== null) gestures.swipe(0, true);
    swiped = null;
  }

  /** @param {number} dx @param {Point} before @param {Point} now */
  function swipe(dx, before, now) {
    travelled += Math.hypot(now.x - before.x, now.y - before.y);
    if (travelled >= CLICK_RADIUS_PX) gestures.swipe(dx, false);
  }

  /** @param {Point} before @param {Point} now */
  function drag(before, now) {
    const wasClick = travelled < CLICK_RADIUS_PX;
    travelled += Math.hypot(now.x - before.x, now.y - before.y);
    if (travelled < CLICK_RADIUS_PX) return;
    if (wasClick) host.classList.add("is-dragging");
    gestures.pan(now.x - before.x, now.y - before.y);
  }

  /** @param {number} id @param {Point} before @param {Point} now */
  function pinch(id, before, now) {
    pinched = true;
    const other = [...pointers].find(([key]) => key !== id)?.[1];
    if (!other) return;
    const factor =
      Math.hypot(now.x - other.x, now.y - other.y) / Math.max(1, Math.hypot(before.x - other.x, before.y - other.y));
    gestures.zoom(factor, { x: (now.x + other.x) / 2, y: (now.y + other.y) / 2 });
    gestures.pan((now.x - before.x) / 2, (now.y - before.y) / 2);
  }

  on("pointerup", (event) => {
    const isLast = pointers.delete(event.pointerId) && pointers.size === 0;
    host.classList.remove("is-dragging");
    if (swiped !== null && travelled >= CLICK_RADIUS_PX) gestures.swipe(event.clientX - swiped, true);
    swiped = null;
    if (isLast && !pinched && travelled < CLICK_RADIUS_PX && event.button === 0) gestures.click(at(event));
  });

  on("pointercancel", (event) => {
    endSwipe();
    pointers.delete(event.pointerId);
    host.classList.remove("is-dragging");
  });
  on("pointerleave", () => gestures.hover(null));
  on("dblclick", (event) => gestures.doubleClick(at(event)));

  on("wheel", (event) => {
    event.preventDefault();
    const pixels = event.deltaY * (event.deltaMode === WheelEvent.DOM_DELTA_LINE ? LINE_PX : 1);
    // A pinch on a trackpad arrives as a wheel with Ctrl, in much smaller steps.
    gestures.zoom(Math.exp(-pixels * (event.ctrlKey ? 0.01 : 0.0016)), at(event));
  });

  return () => stop.abort();
}
