// @ts-check
// Which crops are selected, and what clicks and keys make of it. Pure and immutable.

/**
 * @typedef {object} Selection
 * @property {boolean} all  everything that the filters select, however much of it was seen
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

/** A click with Ctrl, or Space. @param {Selection} before @param {number} index @param {number} id @returns {Selection} */
export function toggled(before, index, id) {
  const ids = new Set(before.ids);
  if (!ids.delete(id)) ids.add(id);
  return { all: false, ids, focus: index, anchor: index };
}

/** A click or an arrow with Shift. @param {Selection} before @param {number} index @param {readonly number[]} range ids from the anchor to here @param {boolean} [adds] to what is selected already @returns {Selection} */
export function extended(before, index, range, adds = false) {
  const ids = new Set([...(adds ? before.ids : []), ...range]);
  return { all: false, ids, focus: index, anchor: before.anchor };
}

/** A rectangle was drawn. @param {Selection} before as it was when the drawing began @param {readonly number[]} inside ids @param {number} index of the last one @param {boolean} adds @returns {Selection} */
export function lassoed(before, inside, index, adds) {
  return { all: false, ids: new Set([...(adds ? before.ids : []), ...inside]), focus: index, anchor: index };
}

/** Arrows move; what is selected stays. @param {Selection} before @param {number} index @returns {Selection} */
export const focused = (before, index) => ({ ...before, focus: index, anchor: index });

/** @param {Selection} before @returns {Selection} */
export const everything = (before) => ({ ...before, all: true, ids: new Set() });

/** @param {Selection} before @returns {Selection} */
export const nothing = (before) => ({ ...before, all: false, ids: new Set() });

/** From everything to all that are known but one. @param {Selection} before @param {readonly number[]} known @param {number} index @param {number} id @returns {Selection} */
export function allBut(before, known, index, id) {
  const ids = new Set(known);
  ids.delete(id);
  return { ...before, all: false, ids, focus: index, anchor: index };
}
