// @ts-check
// Texts for scores, intervals and truths, and links to the boxes that were counted. Pure functions.

import { countOf, countText } from "../core/numbers.js";
import { linkTo } from "../core/router.js";

/**
 * @typedef {"kept_keep" | "kept_reject" | "rejected_keep" | "rejected_reject"} Cell the filter's verdict, then the
 *   truth
 */
/** @import { Measure, Plan } from "../core/openapi.js" */
/** @typedef {import("../core/openapi.js").Quality["truth"]} Truth */

/** With fewer answers of a class, a suggested threshold is marked. */
export const FEW_ANSWERS = 100;

/**
 * @type {readonly {cell: Cell, filter: "kept" | "rejected", person: "keep" | "reject", isAgreed: boolean, text:
 *   string}[]}
 */
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

/**
 * Which boxes a cell counts, as filters of the grid.
 * @param {"kept" | "rejected"} filter @param {"keep" | "reject"} person @returns {Record<string, string>}
 */
export const cellQuery = (filter, person) => ({ by_filter: filter, review: person });

/** 0.947 as 94.7. @param {number} share */
export const percentOf = (share) => Math.round(1000 * share) / 10;

/** @param {number | null | undefined} share */
export const shareText = (share) => (share === null || share === undefined ? "–" : `${percentOf(share)} %`);

/** @param {Measure | null} measure */
export const intervalText = (measure) =>
  measure ? `${percentOf(measure.low)}–${percentOf(measure.high)} %` : "cannot be told";

/** Why there are no scores. @param {number} answers @param {number} random  of them, those in random order */
export function refusalText(answers, random) {
  if (random > 0)
    return `${countOf(random, "random answer")} ${random === 1 ? "is" : "are"} too few to say how good the filter is.`;
  const were =
    answers === 1 ? "This answer was on a box that was" : `These ${countText(answers)} answers were on boxes that were`;
  return `${were} not chosen at random, such as doubtful ones: they cannot say how good the filter is.`;
}

/** @param {Plan} plan @param {number} answered  of its boxes */
export function planText({ boxes, half_width: half }, answered) {
  const result = half > 0 ? `to about ± ${Math.ceil(100 * half)} %` : "exactly";
  return `${answered > 0 ? "With" : "Answer"} ${countOf(boxes, "random box", "random boxes")}${answered > 0 ? " it is known" : " to know it"} ${result}.`;
}

/** The usual words for values of kappa (Landis and Koch). @param {number | null} kappa */
export function kappaText(kappa) {
  if (kappa === null) return "not known";
  const bounds = /** @type {const} */ ([
    [0, "poor"],
    [0.2, "slight"],
    [0.4, "fair"],
    [0.6, "moderate"],
    [0.8, "substantial"],
  ]);
  return bounds.find(([most]) => kappa <= most)?.[1] ?? "almost perfect";
}

/** "0-50" with its unit. @param {string} band */
export function bandText(band) {
  if (band === "unknown") return "unknown";
  return `${band.replace("-", "–").replace(">", "> ")} m`;
}

/**
 * The limits of a band, as filters of the grid; null where the grid has none.
 * @param {string} band @returns {Record<string, string> | null}
 */
export function bandQuery(band) {
  const between = /^(\d+)-(\d+)$/.exec(band);
  if (between) return { distance_min: between[1] ?? "", distance_max: between[2] ?? "" };
  const above = /^>\s*(\d+)$/.exec(band);
  return above ? { distance_min: above[1] ?? "" } : null;
}

/** What the columns of errors count. */
export const COUNTED = {
  kept: "Boxes that were kept although they should be rejected",
  lost: "Boxes that were rejected although they should be kept",
};

/** @typedef {typeof CELLS[number]} CellAbout */

/**
 * @typedef {object} Words
 * @property {(n: number) => string} head  after "the filter against"
 * @property {string} all  heading of the comparison as a whole
 * @property {(n: number) => string} counted  what was counted for it
 * @property {(n: number) => string} some  the same number, in fewer words
 * @property {string} column  heading of their number
 * @property {string} keep  heading of what should be kept
 * @property {string} reject
 * @property {string} said  what the columns are, for screen readers
 * @property {string} precision  what it is a share of
 * @property {string} recall
 * @property {Record<string, string>} goals  what is suggested, by target
 * @property {string} both  what is needed before anything can be suggested
 */

export const TRUTHS = [
  { value: "people", text: "People" },
  { value: "instances", text: "Instances" },
];

/** @type {Record<Truth, Words>} */
export const WORDS = {
  people: {
    head: (n) => `${countOf(n, "answer")} of people`,
    all: "All boxes that were answered",
    counted: (n) => `${countOf(n, "answer")}, the latest of each box`,
    some: (n) => countOf(n, "answer"),
    column: "Answers",
    keep: "people keep",
    reject: "people reject",
    said: "what people said",
    precision: "of the boxes that the filter keeps, people keep",
    recall: "of the boxes that people keep, the filter keeps",
    goals: {
      f1: "the ones that agree best with the answered boxes",
      recall: "the highest ones that keep what people keep of the answered boxes",
    },
    both: "Answers on both sides are needed before a threshold can be suggested: some boxes to keep and some to reject, of the same class.",
  },
  instances: {
    head: (n) => `instance images, ${countOf(n, "box", "boxes")}`,
    all: "All boxes with an instance image",
    counted: (n) => `${countOf(n, "box", "boxes")}; visible is what has a pixel of its own`,
    some: (n) => countOf(n, "box", "boxes"),
    column: "Boxes",
    keep: "is visible",
    reject: "is not visible",
    said: "what instances show",
    precision: "of the boxes that the filter keeps, are visible",
    recall: "of the boxes that are visible, the filter keeps",
    goals: {
      f1: "the ones that agree best with what is visible",
      recall: "the highest ones that keep what is visible",
    },
    both: "Boxes on both sides are needed before a threshold can be suggested: some visible and some not, of the same class.",
  },
};

/**
 * A link to the boxes that a cell of the matrix counts; null if the truth is instances, for which the grid has no
 * filter.
 * @param {string} dataset @param {Truth} truth @param {CellAbout} cell @param {Record<string, string>} [more]
 */
export const boxesOf = (dataset, truth, { filter, person }, more = {}) =>
  truth === "people" ? linkTo("grid", { dataset }, { ...more, ...cellQuery(filter, person) }) : null;
