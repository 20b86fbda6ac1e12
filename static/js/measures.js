// @ts-check
// How well the filter does, in words and places on a scale. Pure.

/** @typedef {import("./types_quality.js").Confusion} Confusion */
/** @typedef {import("./types_quality.js").Cell} Cell */
/** @typedef {import("./types_quality.js").Measure} Measure */

/** With fewer answers than this an interval is wider than most differences. */
export const FEW_ANSWERS = 100;

/** @type {readonly {cell: Cell, filter: "kept" | "rejected", person: "keep" | "reject", isAgreed: boolean, text: string}[]} */
export const CELLS = [
  { cell: "kept_keep", filter: "kept", person: "keep", isAgreed: true, text: "rightly kept" },
  { cell: "kept_reject", filter: "kept", person: "reject", isAgreed: false, text: "ghosts that were kept" },
  { cell: "rejected_keep", filter: "rejected", person: "keep", isAgreed: false, text: "real boxes that were rejected" },
  { cell: "rejected_reject", filter: "rejected", person: "reject", isAgreed: true, text: "rightly rejected" },
];

/** @param {Record<Cell, number>} confusion */
export const answersIn = (confusion) => CELLS.reduce((total, { cell }) => total + confusion[cell], 0);

/** @param {Record<Cell, number>} confusion @param {Cell} cell  0 to 1, of all answers */
export const shareOf = (confusion, cell) => confusion[cell] / Math.max(1, answersIn(confusion));

/** Which boxes a cell counts, as filters of the grid. @param {"kept" | "rejected"} filter @param {"keep" | "reject"} person @returns {Record<string, string>} */
export const cellQuery = (filter, person) => ({ verdict: filter, review: person });

/** 0.947 as 94.7; nothing is certain with a finite number of answers. @param {number} share */
export const percentOf = (share) => Math.round(1000 * share) / 10;

/** @param {number | null | undefined} share */
export const shareText = (share) => (share === null || share === undefined ? "–" : `${percentOf(share)} %`);

/** @param {Measure | null} measure */
export const intervalText = (measure) => (measure ? `${percentOf(measure.low)}–${percentOf(measure.high)} %` : "too few answers");

/** How people speak of kappa (Landis and Koch). @param {number | null} kappa */
export function kappaText(kappa) {
  if (kappa === null) return "not known";
  const bounds = /** @type {const} */ ([[0, "poor"], [0.2, "slight"], [0.4, "fair"], [0.6, "moderate"], [0.8, "substantial"]]);
  return bounds.find(([most]) => kappa <= most)?.[1] ?? "almost perfect";
}

/** "0-50" with its unit. @param {string} band */
export function bandText(band) {
  if (band === "unknown") return "unknown";
  return `${band.replace("-", "–").replace(">", "> ")} m`;
}

/** The limits of a band, as filters of the grid; null where the grid has none. @param {string} band @returns {Record<string, string> | null} */
export function bandQuery(band) {
  const between = /^(\d+)-(\d+)$/.exec(band);
  if (between) return { distance_min: between[1] ?? "", distance_max: between[2] ?? "" };
  const above = /^>\s*(\d+)$/.exec(band);
  return above ? { distance_min: above[1] ?? "" } : null;
}

/**
 * Which suggestions are worth a change: another value that scores better, or that holds what was asked for.
 * @template {{current: number, suggested: number, f1_current: number | null, f1_suggested: number | null}} T
 * @param {readonly T[]} suggested @param {string} [target] @returns {T[]}
 */
export const worthTrying = (suggested, target = "f1") =>
  suggested.filter((one) => one.suggested !== one.current && (target !== "f1" || (one.f1_suggested ?? 0) > (one.f1_current ?? 0)));
