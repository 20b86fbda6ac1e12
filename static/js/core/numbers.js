// @ts-check
// Counts, percentages, sizes, distances and times as text.

/** "3 min 20 s". @param {string | null} from @param {string | null} to */
export function tookText(from, to) {
  if (!from || !to) return "";
  const seconds = Math.max(0, (Date.parse(to) - Date.parse(from)) / 1000);
  if (seconds < 0.1) return "under 0.1 s";
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 60) return `${Math.round(seconds)} s`;
  return `${Math.floor(seconds / 60)} min ${Math.round(seconds % 60)} s`;
}

const GROUPED = new Intl.NumberFormat("en", { useGrouping: true });

/** 12 345 with thin spaces. @param {number} n */
export const countText = (n) => GROUPED.format(n).replaceAll(",", "\u2009");

/** @param {string} text */
export const capital = (text) => `${text[0]?.toUpperCase() ?? ""}${text.slice(1)}`;

/** @param {number} n @param {string} one @param {string} [many] */
export const countOf = (n, one, many = `${one}s`) => `${countText(n)} ${n === 1 ? one : many}`;

/**
 * Three digits are enough to compare. More are shown where the rounded number would be 0, 100 or `against`, or beyond
 * it, and the exact one is not: 9.96 % is never shown as the 10 % that are needed.
 * @param {number | null | undefined} percent @param {number | null} [against]
 */
export function percentText(percent, against = null) {
  if (percent === null || percent === undefined || Number.isNaN(percent)) return "–";
  return roundedText(percent, Math.abs(percent) < 1 ? 2 : 1, against);
}

/** Rounded to whole percent, but not to 0 or 100. @param {number} percent */
export const wholePercentText = (percent) => roundedText(percent, percent < 1 ? 2 : 0);

/**
 * Not rounded, but for what a sum of decimals leaves behind: 0.30000000000000004 is "0.3 %".
 * @param {number} percent
 */
export const exactPercentText = (percent) => `${Number(percent.toPrecision(15))} %`;

/**
 * With at least so many decimals, less zeros at the end.
 * @param {number} percent @param {number} decimals @param {number | null} [against]
 */
function roundedText(percent, decimals, against = null) {
  const marks = against === null ? [0, 100] : [0, 100, against];
  const isOnItsSides = (/** @type {number} */ shown) =>
    marks.every((mark) => Math.sign(shown - mark) === Math.sign(percent - mark));
  let shown = Number(percent.toFixed(decimals));
  while (!isOnItsSides(shown) && decimals < 15) shown = Number(percent.toFixed(++decimals));
  return `${shown} %`;
}

/** @param {number | null} bytes */
export function sizeText(bytes) {
  if (bytes === null) return "–";
  if (bytes < 1000) return `${bytes} B`;
  const units = ["kB", "MB", "GB", "TB"];
  const power = Math.min(units.length, Math.floor(Math.log10(bytes) / 3));
  const size = bytes / 1000 ** power;
  return `${size.toFixed(size < 10 ? 1 : 0)} ${units[power - 1]}`;
}

/** @param {number | null | undefined} metres */
export const metresText = (metres) =>
  metres === null || metres === undefined ? "–" : `${metres.toFixed(metres < 10 ? 1 : 0)} m`;

/** A number and its sign stay on one line. @param {string} text */
export const unbroken = (text) => text.replaceAll(" %", "\u00a0%");

/** @param {string} iso @param {number} [now] ms */
export function agoText(iso, now = Date.now()) {
  const seconds = Math.max(0, Math.round((now - Date.parse(iso)) / 1000));
  if (seconds < 45) return "just now";
  if (seconds < 3600) return `${Math.max(1, Math.round(seconds / 60))} min ago`;
  if (seconds < 86400) return `${Math.round(seconds / 3600)} h ago`;
  return new Date(iso).toLocaleDateString("en", { day: "numeric", month: "short", year: "numeric" });
}
