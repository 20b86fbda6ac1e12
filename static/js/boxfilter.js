// @ts-check
// Which boxes of a frame are shown, and in what order one goes through them. Pure.

import { answerOf, isUndecided } from "./reviews.js";

/** @typedef {import("./types.js").Decision} Decision */
/** @typedef {import("./router.js").Query} Query */

/** The filters that live in the address; a list of frames and a frame share them. */
export const FILTER_KEYS = /** @type {const} */ (["verdict", "reason", "class", "review"]);

/** What V goes through. */
export const VERDICT_CYCLE = /** @type {const} */ (["", "kept", "rejected"]);

/** @type {readonly {value: string, text: string}[]} */
export const REVIEW_CHOICES = [
  { value: "undecided", text: "Undecided" },
  { value: "decided", text: "Decided" },
  { value: "keep", text: "Answered keep" },
  { value: "reject", text: "Answered reject" },
  { value: "unsure", text: "Unsure" },
];

/** @param {Decision} box @param {Query} query */
export function isShown(box, query) {
  return (
    (!query.verdict || box.verdict === query.verdict) &&
    (!query.reason || box.reason === query.reason) &&
    (!query.class || box.class === query.class) &&
    (!query.review || matchesReview(box, query.review))
  );
}

/** @param {Decision} box @param {string} wanted */
function matchesReview(box, wanted) {
  const answer = answerOf(box);
  if (wanted === "none" || wanted === "any") return (answer === null) === (wanted === "none");
  const isDecided = answer === "keep" || answer === "reject";
  if (wanted === "undecided" || wanted === "decided") return isDecided === (wanted === "decided");
  return answer === wanted;
}

/** @param {readonly Decision[]} boxes @param {Query} query */
export const shownBoxes = (boxes, query) => boxes.filter((box) => isShown(box, query));

/** Only the filters, without what else is in the address. @param {Query} query @returns {Query} */
export function filtersOf(query) {
  return Object.fromEntries(FILTER_KEYS.flatMap((key) => (query[key] ? [[key, query[key]]] : [])));
}

/**
 * The box `step` further in the frame's order, among those shown; null past an end.
 * A box that a filter has meanwhile hidden still has its place.
 * @param {readonly Decision[]} boxes @param {Query} query @param {number | null} selected @param {1 | -1} step
 * @returns {Decision | null}
 */
export function neighbour(boxes, query, selected, step) {
  return search(boxes, selected, step, (box) => isShown(box, query));
}

/** The next one that nobody has answered, from the start again when the end is reached. @param {readonly Decision[]} boxes @param {Query} query @param {number | null} selected @returns {Decision | null} */
export function nextUndecided(boxes, query, selected) {
  /** @param {Decision} box */
  const wanted = (box) => box.box_id !== selected && isUndecided(box) && isShown(box, query);
  return search(boxes, selected, 1, wanted) ?? boxes.find(wanted) ?? null;
}

/**
 * @param {readonly Decision[]} boxes @param {number | null} selected @param {1 | -1} step
 * @param {(box: Decision) => boolean} wanted
 */
function search(boxes, selected, step, wanted) {
  const at = boxes.findIndex((box) => box.box_id === selected);
  const start = at >= 0 ? at + step : step > 0 ? 0 : boxes.length - 1;
  for (let i = start; i >= 0 && i < boxes.length; i += step) {
    const box = boxes[i];
    if (box && wanted(box)) return box;
  }
  return null;
}

/** How many boxes have each value of a key: what a filter's choices say. @param {readonly Decision[]} boxes @param {"verdict" | "reason" | "class"} key @returns {Map<string, number>} */
export function countsBy(boxes, key) {
  /** @type {Map<string, number>} */
  const counts = new Map();
  for (const box of boxes) counts.set(box[key], (counts.get(box[key]) ?? 0) + 1);
  return new Map([...counts].sort(([a], [b]) => a.localeCompare(b)));
}
