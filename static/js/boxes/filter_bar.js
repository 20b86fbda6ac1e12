// @ts-check
// The controls of the filters that every list of boxes has: verdict, reason, class, review, and a button that clears
// them.

import { html } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { Segments, Select } from "../core/parts.js";
import { BINS, PLACE_KEYS } from "./filters.js";
import { REASONS } from "./wording.js";

/** @import { Stats } from "../core/openapi.js" */
/** @import { Query } from "../core/router.js" */
/** @typedef {readonly {value: string, text: string}[]} Choices */
/**
 * @typedef {{label: string, any: string, choices: Choices}} Control `any`: the text of the choice that filters nothing
 */
/** @typedef {"verdict" | "reason" | "class" | "review" | "bin"} Key */

/** @type {Choices} */
export const VERDICT_CHOICES = [
  { value: "kept", text: "Kept" },
  { value: "rejected", text: "Rejected" },
  { value: "unmeasured", text: "Unmeasured" },
];

const REASON_CHOICES = Object.entries(REASONS).map(([value, text]) => ({ value, text }));

/** A box without keep or reject. One that was answered with unsure is undecided, but it is not unanswered. */
export const UNDECIDED = "Undecided: no answer, or unsure";

export const DECIDED = "Decided: keep or reject";

/** @type {Choices} */
export const REVIEW_CHOICES = [
  { value: "undecided", text: UNDECIDED },
  { value: "decided", text: DECIDED },
  { value: "keep", text: "Answered keep" },
  { value: "reject", text: "Answered reject" },
  { value: "unsure", text: "Unsure" },
];

/** @param {readonly string[]} classes @returns {Choices} */
export const classChoices = (classes) => classes.map((name) => ({ value: name, text: name }));

/** @type {Record<Key, Control>} */
const CONTROLS = {
  verdict: { label: "Verdict", any: "Any verdict", choices: VERDICT_CHOICES },
  reason: { label: "Reason", any: "Any reason", choices: REASON_CHOICES },
  class: { label: "Class", any: "Any class", choices: [] },
  review: { label: "Review", any: "Answered or not", choices: REVIEW_CHOICES },
  bin: { label: "Doubt", any: "In doubt or not", choices: BINS },
};

/**
 * The verdict as a row of buttons.
 * @param {{query: Query, choices?: Choices, onChange: (query: Query) => void}} props
 */
export function VerdictFilter({ query, choices = VERDICT_CHOICES, onChange }) {
  return html`<${Segments} label="Verdict" value=${query.verdict ?? ""}
    choices=${[{ value: "", text: "All" }, ...choices]}
    onChange=${(/** @type {string} */ verdict) => onChange({ ...query, verdict })} />`;
}

/**
 * The filters as menus, then what the view adds, then a button that clears all.
 * @param {{query: Query, keys?: readonly Key[], own: Partial<Record<Key, Partial<Control>>>, onChange: (query: Query)
 *   => void, onClear?: (() => void) | null, children?: unknown}} props `own`: what differs in this view, such as the
 *   classes of its dataset; `onClear`: null while there is nothing to clear
 */
export function FilterMenus({ query, keys = ["reason", "class", "review"], own, onChange, onClear = null, children }) {
  return html`${keys.map((key) => {
    const { label, any, choices } = { ...CONTROLS[key], ...own[key] };
    return html`<${Select} key=${key} label=${label} any=${any} value=${query[key] ?? ""} choices=${choices}
      onChange=${(/** @type {string} */ value) => onChange({ ...query, [key]: value })} />`;
  })}
  ${children}
  ${onClear && html`<button class="button button--quiet" onClick=${onClear}><${Icon} name="cross" />Clear</button>`}`;
}

const PLACES = {
  map: { label: "Map", any: "Any map" },
  weather: { label: "Weather", any: "Any weather" },
  camera: { label: "Camera", any: "Any camera" },
  sequence: { label: "Drive", any: "Any drive" },
};

const BANDS = ["0-50", "50-100", "100-150", "150-200", "200-"];

/** A band of distance in words. @param {string | number | null} from @param {string | number | null} to  metres */
export const bandText = (from, to) => (to === null || to === "" ? `from ${from} m` : `${from || 0} to ${to} m`);

/**
 * The frames' maps, weathers, cameras and drives as menus, where the dataset has several, and bands of distance.
 * @param {{stats: Stats | null, query: Query, onChange: (query: Query) => void}} props
 *   `stats`: null until they are loaded
 */
export function PlaceFilters({ stats, query, onChange }) {
  const { distance_min: from = "", distance_max: to = "" } = query;
  /** @param {string} band */
  const choice = (band) => ({ value: band, text: bandText(...parts(band)) });
  /** @param {string} band @returns {[string, string]} */
  const parts = (band) => [band.split("-")[0] ?? "", band.split("-")[1] ?? ""];
  const set = from || to ? `${from || 0}-${to}` : "";
  const bands = !set || BANDS.includes(set) ? BANDS : [...BANDS, set];
  return html`${PLACE_KEYS.map((key) => {
    const names = Object.keys(stats?.[`by_${key}`] ?? {});
    if (names.length < 2 && !query[key]) return null;
    return html`<${Select} key=${key} ...${PLACES[key]} value=${query[key] ?? ""} choices=${classChoices(names)}
      onChange=${(/** @type {string} */ name) => onChange({ ...query, [key]: name })} />`;
  })}
  <${Select} label="Distance" any="Any distance" value=${set} choices=${bands.map(choice)}
    onChange=${(/** @type {string} */ band) => {
      const [distance_min, distance_max] = parts(band);
      onChange({ ...query, distance_min, distance_max });
    }} />`;
}
