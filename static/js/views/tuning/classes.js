// @ts-check
// One histogram for the classes that share a threshold, and a small one for each class.

import { html } from "../../html.js";
import { together } from "../../bins.js";
import { typedPercent } from "../../slider.js";
import { THRESHOLD, appliesTo, classPath, valueOf } from "../../tuning.js";
import { countOf, countText, percentText } from "../../wording.js";
import { Icon } from "../icons.js";
import { Segments } from "../parts.js";
import { NumberField } from "./field.js";
import { Histogram } from "./histogram.js";
import { Delta } from "./summary.js";

/** @typedef {import("./state.js").Tuning} Tuning */
/** @typedef {import("../../app.js").App} App */

const SCALES = [
  { value: "", text: "Log" },
  { value: "linear", text: "Linear" },
];

/** @param {import("../../types_jobs.js").ConfigBody} config @param {string} name */
const hasOwn = (config, name) => valueOf(config, classPath(name)) !== undefined;

/** @param {import("../../types_jobs.js").ConfigBody} config @param {string} name */
const thresholdOf = (config, name) => Number(appliesTo(config, name) ?? 0);

/** @param {{app: App, tuning: Tuning, scale: string, selected: string}} props */
export function AllClasses({ app, tuning, scale, selected }) {
  const { tried, active, change } = tuning;
  const counts = histogramsOf(tuning);
  const names = Object.keys(counts);
  const own = names.filter((name) => hasOwn(tried, name));
  const followers = names.filter((name) => !own.includes(name));
  const threshold = Number(valueOf(tried, THRESHOLD));
  /** @param {number | null} value */
  const set = (value) => value !== null && change({ [THRESHOLD]: value });
  return html`<section class="panelbox" aria-labelledby="all-classes">
    <header class="panelbox__head">
      <h2 id="all-classes">All classes</h2>
      <span class="faint">${followText(followers.length, own)}</span>
      <span class="panelbox__tools">
        <${NumberField} label="Threshold of all classes" unit="%" value=${threshold} parse=${typedPercent} onChange=${set} isSet=${THRESHOLD in tuning.edits} />
        <${Segments} label="Scale of the counts" value=${scale} choices=${SCALES} onChange=${(/** @type {string} */ value) => tuning.look({ scale: value, class: selected })} />
      </span>
    </header>
    <${Histogram} app=${app} name="all classes" size="large" counts=${together(followers.map((name) => counts[name] ?? []))}
      threshold=${threshold} active=${Number(valueOf(active.config, THRESHOLD))} isLog=${scale !== "linear"} onChange=${set} />
    <${Legend} />
  </section>`;
}

/** @param {Tuning} tuning @returns {Record<string, number[]>} */
const histogramsOf = ({ preview, baseline }) => (preview?.histograms ?? baseline?.histograms)?.classes ?? {};

/** @param {number} following @param {readonly string[]} own */
function followText(following, own) {
  if (own.length === 0) return `${countOf(following, "class", "classes")}, boxes by the share of their pixels that match`;
  const shown = own.length > 3 ? `${own.length} others` : own.join(", ");
  return `${countOf(following, "class", "classes")} together; ${shown} ${own.length === 1 ? "has its own" : "have their own"}`;
}

function Legend() {
  return html`<p class="chartlegend">
    <span><i class="chartswatch chartswatch--below"></i>below the threshold</span>
    <span><i class="chartswatch chartswatch--above"></i>at or above it</span>
    <span><i class="chartswatch chartswatch--active"></i>active threshold</span>
    <span class="chartlegend__keys">Drag, or <kbd>←</kbd><kbd>→</kbd> 0.5 · <kbd>⇧</kbd> 5 · <kbd>PgUp</kbd><kbd>PgDn</kbd> 10</span>
  </p>`;
}

/** @param {{app: App, tuning: Tuning, scale: string, selected: string}} props */
export function ClassCards({ app, tuning, scale, selected }) {
  const counts = histogramsOf(tuning);
  const names = Object.keys(counts);
  // One class alone is all classes.
  if (names.length === 1 && !hasOwn(tuning.tried, names[0] ?? "")) return null;
  return html`<ul class="classcards">
    ${Object.entries(counts).map(
      ([name, bins]) => html`<li key=${name}><${ClassCard} app=${app} tuning=${tuning} name=${name} counts=${bins} scale=${scale} isSelected=${name === selected} /></li>`,
    )}
  </ul>`;
}

/** @param {{app: App, tuning: Tuning, name: string, counts: readonly number[], scale: string, isSelected: boolean}} props */
function ClassCard({ app, tuning, name, counts, scale, isSelected }) {
  const { tried, active, edits, change, look } = tuning;
  const path = classPath(name);
  const threshold = thresholdOf(tried, name);
  /** @param {number | null} value */
  const set = (value) => value !== null && change({ [path]: value });
  const follow = () => change({ [path]: undefined });
  return html`<section class="classcard ${isSelected ? "is-selected" : ""}" aria-label=${name}>
    <header class="classcard__head">
      <button class="classcard__name" aria-pressed=${isSelected} title=${isSelected ? "Show all classes again" : `Show reasons and flips of ${name} alone`}
        onClick=${() => look({ class: isSelected ? "" : name, scale })}>${name}</button>
      ${hasOwn(tried, name)
        ? html`<button class="button button--quiet button--small" onClick=${follow} title=${`Follow all classes (${percentText(Number(valueOf(tried, THRESHOLD)))})`}><${Icon} name="undo" />own</button>`
        : html`<span class="faint classcard__follows">as for all</span>`}
      <${NumberField} label=${`Threshold of ${name}, percent`} unit="%" value=${threshold} parse=${typedPercent} onChange=${set} isSet=${path in edits} />
    </header>
    <${Histogram} app=${app} name=${name} size="small" counts=${counts} threshold=${threshold} active=${thresholdOf(active.config, name)} isLog=${scale !== "linear"} onChange=${set} />
    <${ClassCounts} tuning=${tuning} name=${name} />
  </section>`;
}

/** @param {{tuning: Tuning, name: string}} props */
function ClassCounts({ tuning, name }) {
  const now = tuning.preview?.by_class?.[name];
  const before = tuning.baseline?.by_class?.[name];
  const flips = tuning.preview?.flips?.by_class[name];
  return html`<dl class="classcard__counts num">
    <div><dt><span class="badge__sign badge__sign--kept"><${Icon} name="check" /></span><span class="sr-only">kept</span></dt><dd>${now ? countText(now.kept) : "…"} <${Delta} count=${now?.kept} before=${before?.kept} /></dd></div>
    <div><dt><span class="badge__sign badge__sign--rejected"><${Icon} name="cross" /></span><span class="sr-only">rejected</span></dt><dd>${now ? countText(now.rejected) : "…"}</dd></div>
    <div class="classcard__flips"><dt class="sr-only">would flip</dt><dd>${flips ? `${countOf(flips.kept_to_rejected + flips.rejected_to_kept, "flip")}` : "no flip"}</dd></div>
  </dl>`;
}
