// @ts-check
// What is queued, in which order, and how far one has come.

import { html, useState } from "../html.js";
import { REVIEW_CHOICES } from "../boxfilter.js";
import { isFiltered, withoutFilters } from "../grid/filters.js";
import { isBlind } from "../queue/blind.js";
import { paceOf } from "../queue/line.js";
import { withoutList } from "../queue/listed.js";
import { ORDERS, orderOf } from "../queue/sitting.js";
import { REASONS, countOf, countText } from "../wording.js";
import { VERDICT_CHOICES } from "./filters.js";
import { useValue } from "./hooks.js";
import { Icon } from "./icons.js";
import { Segments, Select } from "./parts.js";

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../router.js").Query} Query */
/** @typedef {import("../queue/sitting.js").Sitting} Sitting */

const REASON_CHOICES = Object.entries(REASONS).map(([value, text]) => ({ value, text }));

/** @param {{app: App, sitting: Sitting, classes: readonly string[], query: Query, onChange: (query: Query) => void}} props */
export function QueueHead({ app, sitting, classes, query, onChange }) {
  const prefs = useValue(app.prefs);
  /** @param {string} key */
  const set = (key) => (/** @type {string} */ value) => onChange({ ...query, [key]: value });
  return html`<div class="queue__head">
    ${sitting.listed.length > 0
      ? html`<p class="queue__listed">${countOf(sitting.listed.length, "chosen box", "chosen boxes")} <button class="button button--small" onClick=${() => onChange(withoutList(query))}>The whole queue</button></p>`
      : html`<${Choices} classes=${classes} query=${query} set=${set} onChange=${onChange} />`}
    <label class="switch queue__blind" title="Hide the filter's verdict and earlier answers until you have answered">
      <input type="checkbox" checked=${isBlind(query, prefs)} onChange=${(/** @type {{currentTarget: HTMLInputElement}} */ event) => set("blind")(event.currentTarget.checked ? "on" : "off")} /><span>Blind</span>
    </label>
    <span class="queue__middle"></span>
    <${Progress} sitting=${sitting} />
  </div>`;
}

/** Which boxes, and which first. @param {{classes: readonly string[], query: Query, set: (key: string) => (value: string) => void, onChange: (query: Query) => void}} props */
function Choices({ classes, query, set, onChange }) {
  const [isOpen, setOpen] = useState(false);
  return html`<${Segments} label="Order" value=${orderOf(query)} choices=${ORDERS} onChange=${set("order")} />
    <button class="button queue__more ${isFiltered(query) ? "is-set" : ""}" aria-expanded=${isOpen} onClick=${() => setOpen(!isOpen)}><${Icon} name="filter" />Filters</button>
    <div class="queue__filters ${isOpen ? "is-open" : ""}" role="search" aria-label="Filter boxes">
      <${Select} label="Verdict" any="Any verdict" value=${query.verdict ?? ""} choices=${VERDICT_CHOICES.slice(1)} onChange=${set("verdict")} />
      <${Select} label="Class" any="Any class" value=${query.class ?? ""} choices=${classes.map((name) => ({ value: name, text: name }))} onChange=${set("class")} />
      <${Select} label="Reason" any="Any reason in the image" value=${query.reason ?? ""} choices=${REASON_CHOICES} onChange=${set("reason")} />
      <${Select} label="Review" any=${orderOf(query) === "audit" ? "Decided" : "Undecided"} value=${query.review ?? ""} choices=${REVIEW_CHOICES} onChange=${set("review")} />
      ${isFiltered(query) && html`<button class="button button--quiet" onClick=${() => onChange(withoutFilters(query))}><${Icon} name="cross" />Clear</button>`}
    </div>`;
}

/** @param {{sitting: Sitting}} props */
function Progress({ sitting }) {
  const { left } = useValue(sitting.counts);
  const { times, verdicts } = useValue(sitting.tally);
  const comparisons = useValue(sitting.comparisons);
  const pace = paceOf(times);
  const done = verdicts.size;
  const all = sitting.order === "audit" ? (left ?? 0) : done + (left ?? 0);
  const percent = all ? Math.floor((100 * done) / all) : 0;
  return html`<div class="queue__progress">
    <p role="status"><b class="num">${countText(done)}</b> answered${left !== null && html` · <b class="num">${countText(left)}</b> ${sitting.order === "audit" ? "to audit" : "left"}`}
      ${pace !== null && html`<span class="faint"> · ${countText(Math.round(pace))} per minute</span>`}
      ${comparisons.length > 0 && html`<span class="faint"> · agreed on ${countText(comparisons.filter(({ agrees }) => agrees).length)} of ${countText(comparisons.length)}</span>`}</p>
    <div class="progress__track" role="progressbar" aria-label="answered" aria-valuemin="0" aria-valuemax="100" aria-valuenow=${percent}><span class="progress__fill" style=${{ width: `${percent}%` }} /></div>
  </div>`;
}
