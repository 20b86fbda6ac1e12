// @ts-check
// The grid's filters: how they stand in the address, and how the server is asked. Pure.

import { FILTER_KEYS } from "../boxfilter.js";

/** @typedef {import("../router.js").Query} Query */

const FLAGS = /** @type {const} */ (["toss_up", "conflict"]);
const NUMBERS = /** @type {const} */ (["match_min", "match_max", "distance_min", "distance_max"]);

/** Filters that a popover keeps. */
export const MORE_KEYS = /** @type {readonly string[]} */ ([...FLAGS, ...NUMBERS]);
export const BOX_FILTER_KEYS = /** @type {readonly string[]} */ ([...FILTER_KEYS, ...MORE_KEYS]);

/** @type {readonly {value: string, text: string}[]} */
export const SORTS = [
  { value: "doubt", text: "Most doubtful first" },
  { value: "match_percent", text: "Lowest match first" },
  { value: "-match_percent", text: "Highest match first" },
  { value: "crowding", text: "Most crowded first" },
  { value: "id", text: "As they came in" },
];

/** @param {Query} query */
export const sortOf = (query) => (SORTS.some(({ value }) => value === query.sort) ? (query.sort ?? "") : "doubt");

/** What of the address selects boxes, as the server takes it; nonsense is left out. @param {Query} query @returns {Record<string, string | number | boolean>} */
export function selectionOf(query) {
  /** @type {Record<string, string | number | boolean>} */
  const found = {};
  for (const key of FILTER_KEYS) if (query[key]) found[key] = query[key] ?? "";
  for (const key of FLAGS) if (query[key] === "true") found[key] = true;
  for (const key of NUMBERS) {
    const value = numberOf(query[key]);
    if (value !== null) found[key] = value;
  }
  return found;
}

/** @param {string | undefined} text */
function numberOf(text) {
  const value = text === undefined || text.trim() === "" ? NaN : Number(text);
  return Number.isFinite(value) && value >= 0 ? value : null;
}

/** @param {Query} query */
export const isFiltered = (query) => Object.keys(selectionOf(query)).length > 0;

/** @param {Query} query how many of those in the popover are set */
export const countOfMore = (query) => MORE_KEYS.filter((key) => key in selectionOf(query)).length;

/** @param {Query} query @returns {Query} without any filter; the order stays */
export const withoutFilters = (query) => Object.fromEntries(Object.entries(query).filter(([key]) => !BOX_FILTER_KEYS.includes(key)));
