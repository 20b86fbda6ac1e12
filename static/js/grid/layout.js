// @ts-check
// Where the cells of a long grid are: pure functions.

/**
 * @typedef {object} Layout
 * @property {number} count  cells
 * @property {number} columns
 * @property {number} cell  px, both sides of the picture
 * @property {number} pitch  px, from one row to the next
 * @property {number} rows
 * @property {number} full  px, of all rows
 * @property {number} height  px, of the scrolled element
 */

/** @typedef {{x0: number, y0: number, x1: number, y1: number}} Rect  px from the grid's own corner */

export const GAP_PX = 8;
const CAPTION_PX = 56;
const MOST_PX = 16_000_000;

/** Room at the start, for the ring around a selected cell. */
export const HEAD_PX = 12;

/** Room at the end, so that the bar of answers never covers the last row. */
const FOOT_PX = 72;

/**
 * @param {{count: number, width: number, size: number}} wanted `size`: about how wide a cell shall be
 * @returns {Layout}
 */
export function layoutOf({ count, width, size }) {
  const columns = Math.max(1, Math.round((width + GAP_PX) / (size + GAP_PX)));
  const cell = Math.max(1, Math.floor((width - GAP_PX * (columns - 1)) / columns));
  const pitch = cell + CAPTION_PX + GAP_PX;
  const rows = Math.ceil(count / columns);
  const full = HEAD_PX + rows * pitch + FOOT_PX;
  return { count, columns, cell, pitch, rows, full, height: Math.min(full, MOST_PX) };
}

/**
 * The offset of the visible part in the whole grid, px. It differs from `scrollTop` where the grid is higher than a
 * browser allows an element to be.
 * @param {Layout} layout @param {number} scrollTop @param {number} view px
 */
export function offsetAt({ full, height }, scrollTop, view) {
  if (height === full) return scrollTop;
  return (scrollTop * Math.max(0, full - view)) / Math.max(1, height - view);
}

/** The inverse of `offsetAt`. @param {Layout} layout @param {number} offset @param {number} view px */
export function scrollTopFor({ full, height }, offset, view) {
  if (height === full) return offset;
  return (offset * Math.max(1, height - view)) / Math.max(1, full - view);
}

/**
 * Rows from `first` up to, and without, `end`.
 * @param {Layout} layout @param {number} offset @param {number} view px
 * @param {number} spare rows on both sides
 */
export function rowsInSight({ pitch, rows }, offset, view, spare) {
  const first = Math.floor((offset - HEAD_PX) / pitch) - spare;
  const end = Math.ceil((offset + view - HEAD_PX) / pitch) + spare;
  return { first: Math.max(0, Math.min(first, rows)), end: Math.max(0, Math.min(end, rows)) };
}

/**
 * The nearest offset at which a cell is wholly visible.
 * @param {Layout} layout @param {number} index @param {number} offset @param {number} view px
 */
export function offsetToShow({ columns, pitch, full }, index, offset, view) {
  const top = Math.floor(index / columns) * pitch;
  const most = Math.max(0, full - view);
  const least = Math.min(HEAD_PX + top + pitch + FOOT_PX - view, most);
  return Math.max(0, Math.min(Math.max(offset, least), top));
}

/** Every cell that a rectangle touches, in order. @param {Layout} layout @param {Rect} rect @returns {number[]} */
export function cellsIn({ count, columns, cell, pitch, rows }, rect) {
  const picture = pitch - GAP_PX;
  const left = spanned(rect.x0, rect.x1, cell, cell + GAP_PX, columns);
  const down = spanned(rect.y0, rect.y1, picture, pitch, rows);
  const found = [];
  for (let row = down.first; row < down.end; row++) {
    for (let column = left.first; column < left.end; column++) {
      const index = row * columns + column;
      if (index < count) found.push(index);
    }
  }
  return found;
}

/**
 * Which of the bars of `length`, one every `pitch`, does an interval touch?
 * @param {number} a @param {number} b @param {number} length @param {number} pitch @param {number} most
 */
function spanned(a, b, length, pitch, most) {
  const [low, high] = a < b ? [a, b] : [b, a];
  const first = Math.floor(low / pitch) + (mod(low, pitch) > length ? 1 : 0);
  return { first: Math.max(0, first), end: Math.min(most, Math.floor(high / pitch) + 1) };
}

/** @param {number} a @param {number} n */
const mod = (a, n) => ((a % n) + n) % n;

export const MOVES = /** @type {const} */ (["left", "right", "up", "down", "pageUp", "pageDown", "first", "last"]);

/** @typedef {(typeof MOVES)[number]} Move  by the names of the keymap */

/**
 * The index of the cell that a key moves to.
 * @param {Layout} layout @param {number} index @param {Move} move @param {number} page rows of one
 */
export function moved({ count, columns }, index, move, page) {
  if (move === "first") return 0;
  if (move === "last") return Math.max(0, count - 1);
  const step = { right: 1, left: -1, down: columns, up: -columns, pageDown: columns * page, pageUp: -columns * page }[
    move
  ];
  const next = index + step;
  if (Math.abs(step) === 1 || (next >= 0 && next < count)) return Math.max(0, Math.min(next, count - 1));
  if (move.startsWith("page")) return next < 0 ? index % columns : Math.max(0, count - 1);
  // From the last full row down into one that ends earlier; at an edge, stay.
  const isAboveLast = Math.floor(index / columns) < Math.floor((count - 1) / columns);
  return step > 0 && isAboveLast ? count - 1 : index;
}
