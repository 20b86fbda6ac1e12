// @ts-check
// The histogram of all classes, one for each class, and the reasons before and after a change.

import { reasonText } from "../boxes/wording.js";
import { html } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf, countText, percentText } from "../core/numbers.js";
import { BAR, NumberField, Segments, WideTable, numeric } from "../core/parts.js";
import { appliesTo, classPath, valueOf } from "./config.js";
import { Delta } from "./flips.js";
import { Histogram, together, typedPercent } from "./histogram.js";

/** @import { App } from "../core/app.js" */
/** @import { FilterConfigIn, Preview } from "../core/openapi.js" */
/** @import { Tuning } from "./preview.js" */

const SCALES = [
  { value: "", text: "Log" },
  { value: "linear", text: "Linear" },
];

const BY = [
  { value: "own", text: "By instances, depth, order" },
  { value: "tags", text: "By tags" },
];

/** @param {FilterConfigIn} config @param {string} name @param {string} key */
const hasOwn = (config, name, key) => valueOf(config, classPath(name, key)) !== undefined;

/** @param {FilterConfigIn} config @param {string} name @param {string} key */
const thresholdOf = (config, name, key) => Number(appliesTo(config, name, key) ?? 0);

/** @param {{app: App, tuning: Tuning, scale: string, selected: string}} props */
export function AllClasses({ app, tuning, scale, selected }) {
  const { tried, active, change, share } = tuning;
  const { key } = share;
  const counts = histogramsOf(tuning);
  const names = Object.keys(counts);
  const own = names.filter((name) => hasOwn(tried, name, key));
  const followers = names.filter((name) => !own.includes(name));
  const threshold = Number(valueOf(tried, key) ?? 0);
  /** @param {number | null} value */
  const set = (value) => value !== null && change({ [key]: value });
  return html`<section class="panelbox" aria-labelledby="all-classes">
    <header class="panelbox__head">
      <h2 id="all-classes">All classes</h2>
      <span class="faint">${followText(followers.length, own, share.isOwn)}</span>
      <span class="panelbox__tools">
        ${
          share.counts.own > 0 &&
          share.counts.tags > 0 &&
          html`
            <${Segments} label="Boxes decided" value=${share.isOwn ? "own" : "tags"} choices=${BY}
              onChange=${(/** @type {string} */ by) => tuning.look({ by, scale, class: selected })} />`
        }
        <${NumberField} label="Threshold of all classes" unit="%" value=${threshold} expected="0 to 100"
          parse=${typedPercent} onChange=${set} isSet=${key in tuning.edits} />
        <${Segments} label="Scale of the counts" value=${scale} choices=${SCALES}
          onChange=${(/** @type {string} */ value) => tuning.look({ scale: value, class: selected })} />
      </span>
    </header>
    <${Histogram} app=${app} name="all classes" size="large"
      counts=${together(followers.map((name) => counts[name] ?? []))}
      threshold=${threshold} active=${Number(valueOf(active.config, key) ?? 0)} isLog=${scale !== "linear"}
      onChange=${set} />
    <${Legend} isExclusive=${valueOf(tried, "profile") === "carlasimu"} />
  </section>`;
}

/** @param {Tuning} tuning @returns {Record<string, number[]>} */
const histogramsOf = ({ share }) => share.histograms?.classes ?? {};

/** @param {number} following @param {readonly string[]} own @param {boolean} isOwn */
function followText(following, own, isOwn) {
  const share = isOwn ? "the share of their pixels that is their object's own" : "their share of matching pixels";
  if (own.length === 0) return `${countOf(following, "class", "classes")}, boxes by ${share}`;
  const shown = own.length > 3 ? `${own.length} others` : own.join(", ");
  return `${countOf(following, "class", "classes")} together; ${shown} ${own.length === 1 ? "has its own" : "have their own"}`;
}

/** @param {{isExclusive: boolean}} props  `isExclusive`: a share that equals the threshold fails */
function Legend({ isExclusive }) {
  return html`<p class="chartlegend">
    <span><i class="chartswatch chartswatch--below"></i>${isExclusive ? "at or below" : "below"} the threshold</span>
    <span><i class="chartswatch chartswatch--above"></i>${isExclusive ? "above" : "at or above"} it</span>
    <span><i class="chartswatch chartswatch--active"></i>active threshold</span>
    <span>without boxes of too few visible pixels</span>
    <span class="chartlegend__keys">Drag, or <kbd>←</kbd><kbd>→</kbd> 0.5 · <kbd>⇧</kbd> 5 · <kbd>PgUp</kbd>
      <kbd>PgDn</kbd> 10</span>
  </p>`;
}

/** @param {{app: App, tuning: Tuning, scale: string, selected: string}} props */
export function ClassCards({ app, tuning, scale, selected }) {
  const counts = histogramsOf(tuning);
  const names = Object.keys(counts);
  // One class alone is all classes.
  if (names.length === 1 && !hasOwn(tuning.tried, names[0] ?? "", tuning.share.key)) return null;
  return html`<ul class="classcards">
    ${Object.entries(counts).map(
      ([name, bins]) =>
        html`<li key=${name}>
          <${ClassCard} app=${app} tuning=${tuning} name=${name} counts=${bins} scale=${scale}
            isSelected=${name === selected} /></li>`,
    )}
  </ul>`;
}

/**
 * @param {{app: App, tuning: Tuning, name: string, counts: readonly number[], scale: string, isSelected: boolean}}
 *   props
 */
function ClassCard({ app, tuning, name, counts, scale, isSelected }) {
  const { tried, active, edits, change, look, share } = tuning;
  const { key } = share;
  const path = classPath(name, key);
  const threshold = thresholdOf(tried, name, key);
  const unknown = tuning.share.histograms?.unknown_percent?.[name] ?? 0;
  /** @param {number | null} value */
  const set = (value) => value !== null && change({ [path]: value });
  return html`<section class="classcard ${isSelected ? "is-selected" : ""}" aria-label=${name}>
    <header class="classcard__head">
      <button class="classcard__name" aria-pressed=${isSelected}
        title=${isSelected ? "Show all classes again" : `Show reasons and flips of ${name} alone`}
        onClick=${() => look({ class: isSelected ? "" : name, scale })}>${name}</button>
      ${
        hasOwn(tried, name, key)
          ? html`<button class="button button--quiet button--small" onClick=${() => change({ [path]: undefined })}
            title=${`Follow all classes (${percentText(Number(valueOf(tried, key) ?? 0))})`}>
            <${Icon} name="undo" />Follow all</button>`
          : html`<span class="faint classcard__follows">as for all</span>`
      }
      <${NumberField} label=${`Threshold of ${name}, percent`} unit="%" value=${threshold} expected="0 to 100"
        parse=${typedPercent} onChange=${set} isSet=${path in edits} />
    </header>
    <${Histogram} app=${app} name=${name} size="small" counts=${counts} threshold=${threshold}
      active=${thresholdOf(active.config, name, key)} isLog=${scale !== "linear"} onChange=${set} />
    <${ClassCounts} tuning=${tuning} name=${name} />
    ${unknown > 0 && html`<p class="faint">${percentText(unknown)} of its pixels have no known tag</p>`}
  </section>`;
}

/** @param {{tuning: Tuning, name: string}} props */
function ClassCounts({ tuning, name }) {
  const now = tuning.preview?.by_class?.[name];
  const before = tuning.baseline?.by_class?.[name];
  const flips = tuning.preview?.flips?.by_class[name];
  return html`<dl class="classcard__counts num">
    <div>
      <dt><span class="badge__sign badge__sign--kept"><${Icon} name="check" /></span><span class="sr-only">kept</span>
      </dt><dd>${now ? countText(now.kept) : "…"} <${Delta} count=${now?.kept} before=${before?.kept} /></dd></div>
    <div>
      <dt><span class="badge__sign badge__sign--rejected"><${Icon} name="cross" /></span>
        <span class="sr-only">rejected</span></dt><dd>${now ? countText(now.rejected) : "…"}</dd></div>
    ${now && now.unmeasured > 0 && html`<div><dt>unmeasured</dt><dd>${countText(now.unmeasured)}</dd></div>`}
    <div class="classcard__flips"><dt class="sr-only">would flip</dt>
      <dd>${flips ? `${countOf(flips.kept_to_rejected + flips.rejected_to_kept, "flip")}` : "no flip"}</dd></div>
  </dl>`;
}

/**
 * The verdict of the reasons that do not reject a box; profile carlasimu rejects unmapped classes.
 * @type {Record<string, string>}
 */
const METERS = {
  visible: "kept",
  no_segmentation: "unmeasured",
  unmapped_class: "unmeasured",
  passed: "unmeasured",
  unknown_pixels: "unmeasured",
};

/** @param {{tuning: Tuning, selected: string}} props */
export function Reasons({ tuning, selected }) {
  /** @param {Preview | null} preview @returns {Record<string, number>} */
  const of = (preview) => (selected ? preview?.reasons_by_class?.[selected] : preview?.by_reason) ?? {};
  const before = of(tuning.baseline);
  const after = of(tuning.preview);
  const isPublished = tuning.tried.profile === "carlasimu";
  /** @param {string} reason */
  const meterOf = (reason) =>
    isPublished && reason === "unmapped_class" ? "rejected" : (METERS[reason] ?? "rejected");
  const most = Math.max(1, ...Object.values(after), ...Object.values(before));
  const reasons = Object.keys({ ...before, ...after }).sort((a, b) => (before[b] ?? 0) - (before[a] ?? 0));
  return html`<section class="panelbox" aria-labelledby="reasons-title">
    <header class="panelbox__head"><h2 id="reasons-title">Reasons${selected ? `: ${selected}` : ""}</h2></header>
    <${WideTable} label="Reasons" heads=${["Reason", numeric("Active"), numeric("New"), numeric("Change"), BAR]}>
      ${reasons.map(
        (reason) => html`<tr key=${reason}>
          <th scope="row">${reasonText(reason)}</th>
          <td class="is-num num">${countText(before[reason] ?? 0)}</td>
          <td class="is-num num">${countText(after[reason] ?? 0)}</td>
          <td class="is-num"><${Delta} count=${after[reason] ?? 0} before=${before[reason] ?? 0} /></td>
          <td class="table__bar" aria-hidden="true">
            <span class="meter meter--${meterOf(reason)}">
              <i style=${{ width: `${(100 * (after[reason] ?? 0)) / most}%` }}></i></span></td>
        </tr>`,
      )}<//>
  </section>`;
}
