// @ts-check
// A rectangle drawn with the mouse over something that scrolls.

/** @typedef {import("./layout.js").Rect} Rect */

const BEGINS_AFTER_PX = 6;
/** Nearer to an edge than this, the view scrolls along. */
const EDGE_PX = 48;
const FASTEST_PX = 28;

/**
 * @typedef {object} LassoEvents
 * @property {() => {left: number, top: number}} corner  of the content, from the element's own, px
 * @property {() => void} begin
 * @property {(rect: Rect, adds: boolean) => void} change  px from the content's corner
 * @property {() => void} end
 */

/** @param {HTMLElement} element @param {LassoEvents} events @returns {() => void} stop listening */
export function listenToLasso(element, events) {
  const stop = new AbortController();
  /** @type {{x0: number, y0: number, pointer: PointerEvent, isDrawing: boolean} | null} */
  let drawn = null;
  let request = 0;

  /** @param {PointerEvent} event */
  function point(event) {
    const box = element.getBoundingClientRect();
    const corner = events.corner();
    return { x: event.clientX - box.left - corner.left, y: event.clientY - box.top - corner.top };
  }

  function tell() {
    if (!drawn) return;
    const { x, y } = point(drawn.pointer);
    const { ctrlKey, metaKey, shiftKey } = drawn.pointer;
    events.change({ x0: drawn.x0, y0: drawn.y0, x1: x, y1: y }, ctrlKey || metaKey || shiftKey);
  }

  /** As long as the pointer is at an edge. */
  function scroll() {
    if (!drawn?.isDrawing) return;
    const { top, bottom } = element.getBoundingClientRect();
    const y = drawn.pointer.clientY;
    const past = Math.min(0, y - top - EDGE_PX) || Math.max(0, y - bottom + EDGE_PX);
    if (past) {
      element.scrollTop += Math.max(-FASTEST_PX, Math.min(past / 2, FASTEST_PX));
      tell();
    }
    request = requestAnimationFrame(scroll);
  }

  function finish() {
    cancelAnimationFrame(request);
    if (drawn?.isDrawing) {
      events.end();
      // The click that ends a drawing is not one on a cell.
      addEventListener("click", swallow, { capture: true, once: true });
      setTimeout(() => removeEventListener("click", swallow, { capture: true }));
    }
    drawn = null;
  }

  element.addEventListener(
    "pointerdown",
    (event) => {
      const isOnScrollbar = event.offsetX >= element.clientWidth && event.target === element;
      if (event.button !== 0 || event.pointerType === "touch" || isOnScrollbar) return;
      const { x, y } = point(event);
      drawn = { x0: x, y0: y, pointer: event, isDrawing: false };
    },
    { signal: stop.signal },
  );
  addEventListener(
    "pointermove",
    (event) => {
      if (!drawn) return;
      const { x, y } = point(event);
      drawn.pointer = event;
      if (!drawn.isDrawing && Math.hypot(x - drawn.x0, y - drawn.y0) < BEGINS_AFTER_PX) return;
      if (!drawn.isDrawing) {
        drawn.isDrawing = true;
        events.begin();
        request = requestAnimationFrame(scroll);
      }
      tell();
    },
    { signal: stop.signal },
  );
  addEventListener("pointerup", finish, { signal: stop.signal });
  addEventListener("pointercancel", finish, { signal: stop.signal });
  return () => {
    finish();
    stop.abort();
  };
}

/** @param {Event} event */
function swallow(event) {
  event.stopPropagation();
  event.preventDefault();
}
