// @ts-check
// The filters and the order above the grid, and how large the crops are. They write the address.

import { html, useEffect, useRef, useState } from "../html.js";
import { REVIEW_CHOICES } from "../boxfilter.js";
import { SORTS, countOfMore, isFiltered, sortOf, withoutFilters } from "../grid/filters.js";
import { REASONS } from "../wording.js";
import { VERDICT_CHOICES } from "./filters.js";
import { useTyped, useValue } from "./hooks.js";
import { Icon } from "./icons.js";
import { Segments, Select } from "./parts.js";

/** @typedef {import("../router.js").Query} Query */
/** @typedef {import("../app.js").App} App */

const REASON_CHOICES = Object.entries(REASONS).map(([value, text]) => ({ value, text }));
const TYPING_PAUSE_MS = 400;
export const SMALLEST_PX = 72;
export const LARGEST_PX = 360;

/** @param {{app: App, classes: readonly string[], query: Query, onChange: (query: Query) => void}} props */
export function GridFilters({ app, classes, query, onChange }) {
  /** @param {string} key */
  const set = (key) => (/** @type {string} */ value) => onChange({ ...query, [key]: value });
  const [isOpen, setOpen] = useState(false);
  return html`<div class="grid-filters" role="search" aria-label="Filter boxes">
    <${Segments} label="Verdict" value=${query.verdict ?? ""} choices=${VERDICT_CHOICES} onChange=${set("verdict")} />
    <button class="button grid-filters__toggle ${isFiltered(query) ? "is-set" : ""}" aria-expanded=${isOpen} onClick=${() => setOpen(!isOpen)}><${Icon} name="filter" />Filters</button>
    <div class="grid-filters__rest ${isOpen ? "is-open" : ""}">
    <${Select} label="Reason" any="Any reason" value=${query.reason ?? ""} choices=${REASON_CHOICES} onChange=${set("reason")} />
    <${Select} label="Class" any="Any class" value=${query.class ?? ""} choices=${classes.map((name) => ({ value: name, text: name }))} onChange=${set("class")} />
    <${Select} label="Review" any="Answered or not" value=${query.review ?? ""} choices=${REVIEW_CHOICES} onChange=${set("review")} />
    <${More} query=${query} onChange=${onChange} />
    ${isFiltered(query) && html`<button class="button button--quiet" onClick=${() => onChange(withoutFilters(query))}><${Icon} name="cross" />Clear</button>`}
    </div>
    <span class="grid-filters__middle"></span>
    <${Order} value=${sortOf(query)} onChange=${set("sort")} />
    <${SizeSlider} app=${app} />
  </div>`;
}

/** @param {{value: string, onChange: (value: string) => void}} props */
function Order({ value, onChange }) {
  return html`<span class="select">
    <select aria-label="Order" value=${value} onChange=${(/** @type {{currentTarget: HTMLSelectElement}} */ event) => onChange(event.currentTarget.value)}>
      ${SORTS.map((sort) => html`<option value=${sort.value}>${sort.text}</option>`)}
    </select>
  </span>`;
}

/** @param {{app: App}} props */
function SizeSlider({ app }) {
  const { cropSize } = useValue(app.prefs);
  /** @param {{currentTarget: HTMLInputElement}} event */
  const onInput = ({ currentTarget }) => app.prefs.change({ cropSize: Number(currentTarget.value) });
  return html`<label class="size"><${Icon} name="grid" /><span class="sr-only">Size of the crops</span>
    <input class="slider" type="range" min=${SMALLEST_PX} max=${LARGEST_PX} step="4" value=${cropSize} onInput=${onInput} />
  </label>`;
}

/** What is filtered by less often. @param {{query: Query, onChange: (query: Query) => void}} props */
function More({ query, onChange }) {
  const root = useRef(/** @type {HTMLDivElement | null} */ (null));
  const [isOpen, setOpen] = useState(false);
  useClosing(root, isOpen, () => setOpen(false));
  const count = countOfMore(query);
  /** @param {string} key */
  const flag = (key) => (/** @type {{currentTarget: HTMLInputElement}} */ event) => onChange({ ...query, [key]: event.currentTarget.checked ? "true" : "" });
  return html`<div class="menu" ref=${root}>
    <button class="button ${count ? "is-set" : ""}" aria-expanded=${isOpen} onClick=${() => setOpen(!isOpen)}><${Icon} name="filter" />More${count > 0 && html` <b class="num">${count}</b>`}</button>
    ${isOpen &&
    html`<div class="menu__panel more-filters" role="group" aria-label="More filters">
      <label class="switch"><input type="checkbox" checked=${query.toss_up === "true"} onChange=${flag("toss_up")} /><span>Toss-ups only</span></label>
      <label class="switch"><input type="checkbox" checked=${query.conflict === "true"} onChange=${flag("conflict")} /><span>The filter contradicts a person</span></label>
      <${Range} text="Match" unit="%" keys=${["match_min", "match_max"]} most=${100} query=${query} onChange=${onChange} />
      <${Range} text="Distance" unit="m" keys=${["distance_min", "distance_max"]} query=${query} onChange=${onChange} />
    </div>`}
  </div>`;
}

/** @param {{current: HTMLElement | null}} root @param {boolean} isOpen @param {() => void} close */
function useClosing(root, isOpen, close) {
  useEffect(() => {
    if (!isOpen) return;
    /** @param {Event} event */
    const onEvent = (event) => {
      const isInside = event.target instanceof Node && root.current?.contains(event.target);
      if (event instanceof KeyboardEvent && event.key === "Escape") {
        event.preventDefault();
        close();
      } else if (!(event instanceof KeyboardEvent) && !isInside) close();
    };
    addEventListener("pointerdown", onEvent);
    addEventListener("keydown", onEvent, { capture: true });
    return () => {
      removeEventListener("pointerdown", onEvent);
      removeEventListener("keydown", onEvent, { capture: true });
    };
  }, [isOpen]);
}

/** @param {{text: string, unit: string, keys: [string, string], most?: number, query: Query, onChange: (query: Query) => void}} props */
function Range({ text, unit, keys, most, query, onChange }) {
  return html`<fieldset class="range">
    <legend>${text}</legend>
    ${keys.map((key, i) => html`<${NumberField} key=${key} label=${`${text}, ${i ? "at most" : "at least"}`} hint=${i ? "to" : "from"} most=${most} value=${query[key] ?? ""}
      onChange=${(/** @type {string} */ value) => onChange({ ...query, [key]: value })} />`)}
    <span class="faint">${unit}</span>
  </fieldset>`;
}

/** @param {{label: string, hint: string, most?: number, value: string, onChange: (value: string) => void}} props */
function NumberField({ label, hint, most, value, onChange }) {
  const { shown, onInput } = useTyped(value, onChange, TYPING_PAUSE_MS);
  return html`<input type="number" min="0" max=${most} step="any" inputmode="decimal" aria-label=${label} placeholder=${hint} value=${shown} onInput=${onInput} />`;
}
