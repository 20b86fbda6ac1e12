// @ts-check
// Counts in equal bins, and the scale that they are drawn on. Pure.

/** Neighbouring bins together. @param {readonly number[]} counts @param {number} wanted  how many bins; divides their number */
export function rebinned(counts, wanted) {
  const size = Math.max(1, Math.round(counts.length / wanted));
  return Array.from({ length: Math.ceil(counts.length / size) }, (_, bin) => sum(counts.slice(bin * size, (bin + 1) * size)));
}

/** @param {readonly number[]} counts */
export const sum = (counts) => counts.reduce((total, n) => total + n, 0);

/** All classes as one. @param {readonly (readonly number[])[]} perClass */
export function together(perClass) {
  const bins = Math.max(0, ...perClass.map((counts) => counts.length));
  return Array.from({ length: bins }, (_, bin) => sum(perClass.map((counts) => counts[bin] ?? 0)));
}

/** As many bins as there is room for bars one can see. @param {number} width px @param {number} most  a multiple of 4 */
export function binsFor(width, most) {
  if (width >= most * 4) return most;
  return width >= most * 2 ? most / 2 : most / 4;
}

/** Height of a count on the axis; nothing is 0 on either scale. @param {number} count @param {boolean} isLog */
export const heightOf = (count, isLog) => (isLog ? Math.log10(1 + count) : count);

/**
 * Round counts for the axis, 0 first, the last one at or above the tallest bar.
 * @param {number} tallest @param {boolean} isLog @param {number} [most]
 */
export function countTicks(tallest, isLog, most = 5) {
  if (tallest <= 0) return [0, 1];
  return isLog ? logTicks(tallest, most) : linearTicks(tallest, most);
}

/** @param {number} tallest @param {number} most */
function logTicks(tallest, most) {
  const top = Math.ceil(Math.log10(tallest + 1));
  const step = Math.ceil(top / Math.max(1, most - 1));
  const ticks = [0];
  for (let power = step; power < top + step; power += step) ticks.push(10 ** power);
  return ticks;
}

/** @param {number} tallest @param {number} most */
function linearTicks(tallest, most) {
  const raw = tallest / Math.max(1, most - 1);
  const size = 10 ** Math.floor(Math.log10(raw));
  const step = Math.max(1, ([1, 2, 5, 10].find((nice) => nice * size >= raw) ?? 10) * size);
  return Array.from({ length: Math.ceil(tallest / step) + 1 }, (_, i) => i * step);
}

/** 12 000 as 12k, for axes. @param {number} count */
export function shortCount(count) {
  if (count >= 1e6) return `${count / 1e6}M`;
  return count >= 1e4 ? `${count / 1e3}k` : String(count);
}
