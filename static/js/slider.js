// @ts-check
// How a threshold moves: by pointer, by key, by typing. Percent, 0 to 100. Pure.

const STEP = 0.5;
const LARGE_STEP = 5;
const PAGE_STEP = 10;

/** @param {number} value */
export const clampPercent = (value) => Math.min(100, Math.max(0, value));

/** Two digits, so that steps never leave 10.499999. @param {number} value */
const rounded = (value) => Math.round(value * 100) / 100;

/** @type {Record<string, (value: number, isLarge: boolean) => number>} */
const MOVES = {
  ArrowRight: (value, isLarge) => value + (isLarge ? LARGE_STEP : STEP),
  ArrowUp: (value, isLarge) => value + (isLarge ? LARGE_STEP : STEP),
  ArrowLeft: (value, isLarge) => value - (isLarge ? LARGE_STEP : STEP),
  ArrowDown: (value, isLarge) => value - (isLarge ? LARGE_STEP : STEP),
  PageUp: (value) => value + PAGE_STEP,
  PageDown: (value) => value - PAGE_STEP,
  Home: () => 0,
  End: () => 100,
};

/** Where a key moves the threshold; null when the key is not one of the slider's. @param {number} value @param {{key: string, shiftKey: boolean}} press */
export function movedByKey(value, { key, shiftKey }) {
  const move = MOVES[key];
  return move ? rounded(clampPercent(move(value, shiftKey))) : null;
}

/** The threshold under a pointer, in steps of half a percent. @param {number} x px @param {number} left px @param {number} width px */
export function valueAt(x, left, width) {
  const share = width > 0 ? (x - left) / width : 0;
  return clampPercent(Math.round((100 * share) / STEP) * STEP);
}

/** What was typed, or null when it is no percentage. @param {string} text */
export function typedPercent(text) {
  const value = Number(text.replace(",", ".").replace("%", "").trim() || NaN);
  return Number.isFinite(value) && value >= 0 && value <= 100 ? value : null;
}
