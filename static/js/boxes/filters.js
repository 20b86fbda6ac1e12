// @ts-check
// Filters of boxes: as parts of the address, as parameters of the API, and as a test of one box.

import { linkTo } from "../core/router.js";
import { answerOf, isUnanswered } from "./box.js";

/** @import { App } from "../core/app.js" */
/** @import { BoxSelection } from "../core/openapi.js" */
/** @import { Query } from "../core/router.js" */
/** @import { Decision } from "./box.js" */

/**
 * The filters that live in the address; a list of frames and a frame share them. `verdict` is the one in force, as
 * every box is drawn: a person's, else the filter's. `by_filter` is the filter's, whatever people say.
 */
export const FILTER_KEYS = /** @type {const} */ (["verdict", "by_filter", "reason", "class", "review"]);

/** Where, how and by what the frames of boxes were recorded. */
export const PLACE_KEYS = /** @type {const} */ (["map", "weather", "camera", "sequence"]);

const DISTANCE_KEYS = /** @type {const} */ (["distance_min", "distance_max"]);

/** What lists of frames and of boxes filter by, beside the filters of a frame. */
export const LIST_KEYS = /** @type {readonly string[]} */ ([...FILTER_KEYS, ...PLACE_KEYS, ...DISTANCE_KEYS]);

/** The verdict filters that the key V switches between. */
export const VERDICT_CYCLE = /** @type {const} */ (["", "kept", "rejected"]);

/** @param {Decision} box @param {Query} query */
export function isShown(box, query) {
  return (
    (!query.verdict || box.effective_verdict === query.verdict) &&
    (!query.by_filter || box.verdict === query.by_filter) &&
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

/** Only the filters of an address that lists share. @param {Query} query @returns {Query} */
export function filtersOf(query) {
  return Object.fromEntries(LIST_KEYS.flatMap((key) => (query[key] ? [[key, query[key]]] : [])));
}

/** Orders of the list of a frame's boxes; without one, as they came in. */
export const LIST_ORDERS = [
  { value: "doubt", text: "Most doubtful first" },
  { value: "size", text: "Largest first" },
  { value: "distance", text: "Nearest first" },
];

/** @type {Record<string, (box: Decision) => number>} the least first */
const RANKS = {
  doubt: ({ doubt }) => -(doubt ?? 0),
  size: ({ xyxy }) => (xyxy ? -(xyxy[2] - xyxy[0]) * (xyxy[3] - xyxy[1]) : 0),
  distance: ({ distance, distance_range: range }) => distance ?? range?.[0] ?? Infinity,
};

/**
 * The boxes of a frame in the order of the list: those outside the image come last.
 * @param {readonly Decision[]} boxes @param {string} [by]  one of `LIST_ORDERS`
 */
export function inListOrder(boxes, by = "") {
  const rank = RANKS[by] ?? (() => 0);
  return [...boxes].sort((a, b) => Number(!a.xyxy) - Number(!b.xyxy) || rank(a) - rank(b) || 0);
}

/**
 * The next (1) or previous (-1) shown box in the frame's order; null past an end.
 * A selected box that the filters have hidden since keeps its place.
 * @param {readonly Decision[]} boxes @param {Query} query @param {number | null} selected @param {1 | -1} step
 * @returns {Decision | null}
 */
export function neighbour(boxes, query, selected, step) {
  return search(boxes, selected, step, (box) => isShown(box, query));
}

/**
 * The next shown box without an answer, continuing at the start after the end.
 * @param {readonly Decision[]} boxes @param {Query} query @param {number | null} selected @returns {Decision | null}
 */
export function nextUnanswered(boxes, query, selected) {
  /** @param {Decision} box */
  const wanted = (box) => box.box_id !== selected && isUnanswered(box) && isShown(box, query);
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

/**
 * How many boxes have each value of a key, for the choices of a filter.
 * @param {readonly Decision[]} boxes @param {"verdict" | "reason" | "class"} key @returns {Map<string, number>}
 */
export function countsBy(boxes, key) {
  /** @type {Map<string, number>} */
  const counts = new Map();
  for (const box of boxes) counts.set(box[key], (counts.get(box[key]) ?? 0) + 1);
  return new Map([...counts].sort(([a], [b]) => a.localeCompare(b)));
}

const FLAGS = /** @type {const} */ (["toss_up", "conflict"]);

const NUMBERS = /** @type {const} */ (["match_min", "match_max", ...DISTANCE_KEYS]);

/** Filters in the menu "More". */
const MORE_KEYS = /** @type {readonly string[]} */ ([...FLAGS, ...NUMBERS, ...PLACE_KEYS]);

export const BOX_FILTER_KEYS = /** @type {readonly string[]} */ ([...FILTER_KEYS, "bin", ...MORE_KEYS]);

/** What is to be done about boxes, as the server says of each. */
export const BINS = /** @type {const} */ ([
  { value: "ask", text: "To review", left: "to review" },
  { value: "sure", text: "Left to the filter", left: "left to the filter, which is as good as certain" },
  { value: "small", text: "Too small to see", left: "too small to decide by eye" },
  { value: "wall", text: "Nothing of it seen", left: "without a single pixel of their class" },
]);

export const SORTS = /** @type {const} */ ([
  { value: "doubt", text: "Most doubtful first" },
  { value: "match_percent", text: "Lowest match first" },
  { value: "-match_percent", text: "Highest match first" },
  { value: "crowding", text: "Most crowded first" },
  { value: "id", text: "As they came in" },
]);

/** @param {Query} query */
export const sortOf = (query) => SORTS.find(({ value }) => value === query.sort)?.value ?? "doubt";

const VERDICTS = /** @type {const} */ (["kept", "rejected", "unmeasured"]);
const REVIEWS = /** @type {const} */ (["undecided", "decided", "keep", "reject", "unsure", "none", "any"]);

/**
 * The filters of an address as parameters of the API; invalid values are left out.
 * @param {Query} query @returns {BoxSelection}
 */
export function selectionOf(query) {
  /** @type {BoxSelection} */
  const found = {};
  const effective = VERDICTS.find((one) => one === query.verdict);
  const verdict = VERDICTS.find((one) => one === query.by_filter);
  const review = REVIEWS.find((one) => one === query.review);
  if (effective) found.effective = effective;
  if (verdict) found.verdict = verdict;
  if (query.reason) found.reason = query.reason;
  if (query.class) found.class = query.class;
  if (review) found.review = review;
  for (const key of PLACE_KEYS) if (query[key]) found[key] = query[key];
  const bin = BINS.find(({ value }) => value === query.bin)?.value;
  if (bin) found.bin = bin;
  for (const key of FLAGS) if (query[key] === "true") found[key] = true;
  for (const key of NUMBERS) {
    const value = query[key]?.trim() ? Number(query[key]) : NaN;
    if (Number.isFinite(value) && value >= 0) found[key] = value;
  }
  return found;
}

/** @param {Query} query */
export const isFiltered = (query) => Object.keys(selectionOf(query)).length > 0;

/** How many filters of the menu "More" are set. @param {Query} query */
export const countOfMore = (query) => MORE_KEYS.filter((key) => key in selectionOf(query)).length;

/** @param {Query} query @param {readonly string[]} keys @returns {Query} */
const without = (query, keys) => Object.fromEntries(Object.entries(query).filter(([key]) => !keys.includes(key)));

/** @param {Query} query @returns {Query} without any filter; the order stays */
export const withoutFilters = (query) => without(query, BOX_FILTER_KEYS);

/**
 * @param {Query} query
 * @returns {Query} without the filters that a frame has; those of the grid alone stay for the way back
 */
export const withoutFrameFilters = (query) => without(query, FILTER_KEYS);

const MOST = 50;

/**
 * The ids of single boxes that an address lists; invalid ones are left out.
 * @param {Query} query @returns {number[]}
 */
export function listedOf(query) {
  const ids = (query.boxes ?? "")
    .split(",")
    .map(Number)
    .filter((id) => Number.isSafeInteger(id) && id > 0);
  return [...new Set(ids)].slice(0, MOST);
}

/** @param {readonly number[]} ids @returns {Query} */
export const listQuery = (ids) => ({ boxes: ids.slice(0, MOST).join(",") });

/** @param {Query} query @returns {Query} */
export const withoutList = ({ boxes: _, ...rest }) => rest;

/** Shows kept, rejected or all boxes, in turn. @param {App} app */
export function cycleVerdict(app) {
  const { name, params, query } = app.router.route.get();
  const at = VERDICT_CYCLE.findIndex((verdict) => verdict === (query.verdict ?? ""));
  const verdict = VERDICT_CYCLE[(at + 1) % VERDICT_CYCLE.length] ?? "";
  app.router.replace(linkTo(name, params, { ...query, verdict }));
  app.announcement.set(`Showing ${verdict || "all"} boxes`);
}
