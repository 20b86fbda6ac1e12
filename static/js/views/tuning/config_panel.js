// @ts-check
// Every key of the configuration: those that numbers can answer may be changed here, too.

import { html, useState } from "../../html.js";
import { differences, toYaml, valueOf, valueText } from "../../tuning.js";
import { Icon } from "../icons.js";
import { Words } from "../parts.js";
import { NumberField } from "./field.js";

/** @typedef {import("./state.js").Tuning} Tuning */

/** @type {Record<string, {text: string, unit?: string, step?: number, most?: number, isEmptyAllowed?: boolean, isWhole?: boolean}>} */
const KEYS = {
  threshold_small_box: { text: "share of pixels that must match", unit: "%", most: 100 },
  size_big_box: { text: "share of the image above which a box is large", unit: "%", most: 100 },
  threshold_big_box: { text: "share that must match in a large box", unit: "%", most: 100 },
  min_visible_pixels: { text: "matching pixels below which nothing is visible", unit: "px", step: 1, isWhole: true },
  min_distance: { text: "nearest distance that is kept", unit: "m", step: 1, isEmptyAllowed: true },
  max_distance: { text: "farthest distance that is kept", unit: "m", step: 1, isEmptyAllowed: true },
  profile: { text: "how pixels of a box are counted" },
  evidence: { text: "what is compared with the threshold" },
  projection: { text: "how 3D boxes become rectangles" },
  depth_tolerance: { text: "slack in front of and behind a box, metres" },
  ordered_min_pixels: { text: "pixels that nearer boxes must leave over", unit: "px", step: 1, isWhole: true },
  lidar_min_points: { text: "LiDAR points that must hit a box", unit: "points", step: 1, isWhole: true },
  palette: { text: "colours of the segmentation" },
  encoding: { text: "colours or raw tags" },
  channel_order: { text: "order of the colour channels" },
  lossy_segmentation: { text: "what to do with JPEG segmentations" },
};

/** @param {{tuning: Tuning}} props */
export function ConfigPanel({ tuning }) {
  const { tried, active } = tuning;
  const keys = Object.keys(tried).filter((key) => key !== "classes");
  const ofClasses = differences({ ...tried, classes: {} }, tried);
  return html`<section class="panelbox" aria-labelledby="config-title">
    <header class="panelbox__head"><h2 id="config-title">Configuration</h2><span class="faint">all keys; what can be answered from stored numbers can be changed here</span></header>
    <div class="tablewrap"><table class="table table--keys">
      <thead><tr><th scope="col">Key</th><th scope="col">Value</th><th scope="col">Active</th><th class="table__text" scope="col">Meaning</th></tr></thead>
      <tbody>
        ${keys.map((key) => html`<tr key=${key}><th scope="row"><code><${Words} text=${key} /></code></th><td><${Value} tuning=${tuning} name=${key} /></td><td class="num faint">${valueText(valueOf(active.config, key))}</td><td class="table__text faint">${KEYS[key]?.text ?? ""}</td></tr>`)}
        ${ofClasses.map((row) => html`<tr key=${row.path}><th scope="row"><code><${Words} text=${row.path} /></code></th><td class="num">${valueText(row.after)}</td><td class="num faint">${valueText(valueOf(active.config, row.path))}</td><td class="table__text faint">this class alone</td></tr>`)}
      </tbody>
    </table></div>
    <${Yaml} text=${toYaml(tried)} />
  </section>`;
}

/** @param {{tuning: Tuning, name: string}} props */
function Value({ tuning, name }) {
  const spec = KEYS[name];
  const value = valueOf(tuning.tried, name);
  if (!spec?.unit) return html`<span class="num">${valueText(value)}</span>`;
  /** @param {string} text */
  const parse = (text) => {
    const number = Number(text.trim() || NaN);
    const isRight = Number.isFinite(number) && number >= 0 && number <= (spec.most ?? Infinity) && (!spec.isWhole || Number.isInteger(number));
    return isRight ? number : null;
  };
  return html`<${NumberField} label=${name} unit=${spec.unit} step=${spec.step ?? 0.5} isEmptyAllowed=${spec.isEmptyAllowed} isSet=${name in tuning.edits}
    value=${value === null ? null : Number(value)} parse=${parse} onChange=${(/** @type {number | null} */ number) => tuning.change({ [name]: number })} />`;
}

/** @param {{text: string}} props */
function Yaml({ text }) {
  const [isCopied, setCopied] = useState(false);
  const copy = async () => {
    await navigator.clipboard?.writeText(text);
    setCopied(true);
    setTimeout(() => setCopied(false), 1500);
  };
  return html`<details class="yaml">
    <summary>As YAML</summary>
    <div class="yaml__body">
      <pre tabindex="0" aria-label="Configuration as YAML"><code>${text}</code></pre>
      <button class="button button--small" onClick=${copy}><${Icon} name=${isCopied ? "check" : "copy"} />${isCopied ? "Copied" : "Copy YAML"}</button>
    </div>
  </details>`;
}
