// @ts-check
// Which boxes of the grid are selected, and how clicks, keys and the lasso change that.

/** @import { GridActions } from "./grid.js" */
/** @import { Rect } from "./layout.js" */
/** @import { Place } from "./pager.js" */

/**
 * @typedef {object} Selection
 * @property {boolean} all  all boxes that match the filters, whether loaded or not
 * @property {ReadonlySet<number>} ids  of boxes
 * @property {number} focus  index of the cell that the keys act on
 * @property {number} anchor  index from which a range is spanned
 */

/** @type {Selection} */
export const NOTHING = Object.freeze({ all: false, ids: new Set(), focus: 0, anchor: 0 });

/** @param {Selection} selection @param {number} id */
export const isSelected = ({ all, ids }, id) => all || ids.has(id);

/** @param {Selection} selection @param {number | null} total */
export const sizeOf = ({ all, ids }, total) => (all ? (total ?? 0) : ids.size);

/** A click: this one alone. @param {number} index @param {number} id @returns {Selection} */
export const only = (index, id) => ({ all: false, ids: new Set([id]), focus: index, anchor: index });

/**
 * A click with Ctrl, or Space.
 * @param {Selection} before @param {number} index @param {number} id @returns {Selection}
 */
export function toggled(before, index, id) {
  const ids = new Set(before.ids);
  if (!ids.delete(id)) ids.add(id);
  return { all: false, ids, focus: index, anchor: index };
}

/**
 * A click or an arrow with Shift.
 * @param {Selection} before @param {number} index @param {readonly number[]} range ids from the anchor to here
 * @param {boolean} [adds] to what is selected already
 * @returns {Selection}
 */
export function extended(before, index, range, adds = false) {
  const ids = new Set([...(adds ? before.ids : []), ...range]);
  return { all: false, ids, focus: index, anchor: before.anchor };
}

/**
 * A rectangle was drawn.
 * @param {Selection} before as it was when the drawing began
 * @param {readonly number[]} inside ids
 * @param {number} index of the last one
 * @param {boolean} adds @returns {Selection}
 */
export function lassoed(before, inside, index, adds) {
  return { all: false, ids: new Set([...(adds ? before.ids : []), ...inside]), focus: index, anchor: index };
}

/** Arrows move; what is selected stays. @param {Selection} before @param {number} index @returns {Selection} */
export const focused = (before, index) => ({ ...before, focus: index, anchor: index });

/** @param {Selection} before @returns {Selection} */
export const everything = (before) => ({ ...before, all: true, ids: new Set() });

/** @param {Selection} before @returns {Selection} */
export const nothing = (before) => ({ ...before, all: false, ids: new Set() });

/**
 * From everything to all that are known but one.
 * @param {Selection} before @param {readonly number[]} known @param {number} index @param {number} id
 * @returns {Selection}
 */
export function allBut(before, known, index, id) {
  const ids = new Set(known);
  ids.delete(id);
  return { ...before, all: false, ids, focus: index, anchor: index };
}

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

/** What the mouse does to the selection as it is at that moment. @param {Place} place @param {GridActions} actions */
export function createPicking({ pager, selection }, actions) {
  return {
    /** @param {MouseEvent} event @param {number} index */
    onPick(event, index) {
      const id = pager.idAt(index);
      if (id === undefined) return;
      const before = selection.get();
      const isTouch = /** @type {{pointerType?: string}} */ (event).pointerType === "touch";
      if (event.shiftKey)
        selection.set(extended(before, index, pager.idsBetween(before.anchor, index), event.ctrlKey || event.metaKey));
      else if (event.ctrlKey || event.metaKey || isTouch) actions.toggle(index);
      else selection.set(only(index, id));
    },

    /** @param {number} index */
    onOpen(index) {
      selection.set(focused(selection.get(), index));
      actions.open();
    },
  };
}
