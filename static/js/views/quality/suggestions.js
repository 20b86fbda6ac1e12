// @ts-check
// Thresholds that would agree better with the truth: how sure that is, and one click to have them.

import { html, useState } from "../../html.js";
import { jobs } from "../../calls/jobs.js";
import { FEW_ANSWERS, shareText, worthTrying } from "../../measures.js";
import { linkTo } from "../../router.js";
import { classPath, queryOf, withEdits } from "../../tuning.js";
import { percentText } from "../../wording.js";
import { Icon } from "../icons.js";
import { Segments } from "../parts.js";
import { Curve } from "./curve.js";
import { WORDS } from "./truths.js";

/** @typedef {import("../../types_quality.js").Suggestion} Suggestion */
/** @typedef {import("../../types_jobs.js").ConfigVersion} ConfigVersion */
/** @typedef {import("../../app.js").App} App */

/** @param {readonly Suggestion[]} suggested */
const editsFor = (suggested) => Object.fromEntries(suggested.map((one) => [classPath(one.class), one.suggested]));

const TARGETS = [
  { value: "f1", text: "Best F1" },
  { value: "recall", text: "Keep 99 % of the real ones" },
];

/**
 * @param {{app: App, dataset: string, truth: import("../../types_quality.js").Truth, suggested: readonly Suggestion[], active: ConfigVersion, target: string, onTarget: (target: string) => void}} props
 */
export function Suggestions({ app, dataset, truth, suggested, active, target, onTarget }) {
  const words = WORDS[truth];
  const better = worthTrying(suggested, target);
  return html`<section class="panelbox quality__wide" aria-labelledby="suggested-title">
    <header class="panelbox__head"><h2 id="suggested-title">Suggested thresholds</h2>
      <span class="faint">${words.goals[target]}</span>
      <span class="panelbox__tools"><${Segments} label="What to suggest for" value=${target} choices=${TARGETS} onChange=${onTarget} />
      ${better.length > 0 &&
      html`<a class="button" href=${linkTo("thresholds", { dataset }, queryOf(editsFor(better)))}>Try all ${better.length}</a>
        <${SaveButton} app=${app} dataset=${dataset} active=${active} suggested=${better} text="Save all as a version" isLarge />`}</span>
    </header>
    ${suggested.length === 0 && html`<p class="panelbox__empty">${words.both}</p>`}
    ${suggested.length > 0 && html`<${CurveLegend} />`}
    <ul class="suggestions">${suggested.map((one) => html`<li key=${one.class}><${Card} app=${app} dataset=${dataset} active=${active} suggestion=${one} known=${words.some(one.answers)} isBetter=${better.includes(one)} /></li>`)}</ul>
  </section>`;
}

const CurveLegend = () => html`<p class="chartlegend">
  <span><i class="line line--f1"></i>F1</span><span><i class="line line--precision"></i>precision</span><span><i class="line line--recall"></i>recall</span>
  <span><i class="line line--current"></i>active</span><span><i class="line line--suggested"></i>suggested, with its 95 % interval</span>
</p>`;

/** @param {{app: App, dataset: string, active: ConfigVersion, suggestion: Suggestion, known: string, isBetter: boolean}} props */
function Card({ app, dataset, active, suggestion, known, isBetter }) {
  const { class: name, current, suggested, interval, answers, f1_current: before, f1_suggested: after } = suggestion;
  return html`<article class="suggestion" aria-label=${name}>
    <header class="suggestion__head"><h3>${name}</h3><span class="faint">${known}${answers < FEW_ANSWERS ? html` <span class="warn">few</span>` : ""}</span></header>
    <p class="suggestion__change num"><span>${percentText(current)}</span>${isBetter ? html`<${Icon} name="right" /><strong>${percentText(suggested)}</strong>` : html`<span class="faint">stays</span>`}
      ${isBetter && interval && html`<span class="faint suggestion__interval">${percentText(interval[0])} to ${percentText(interval[1])}</span>`}</p>
    <p class="suggestion__f1 num faint">F1 ${shareText(before)}${isBetter ? html` → <strong>${shareText(after)}</strong>` : ""}</p>
    <${Curve} app=${app} suggestion=${suggestion} />
    ${isBetter &&
    html`<p class="suggestion__actions"><a class="button button--small" href=${linkTo("thresholds", { dataset }, { ...queryOf(editsFor([suggestion])), class: name })}>Try it<span class="sr-only">: ${percentText(suggested)} for ${name}</span></a>
      <${SaveButton} app=${app} dataset=${dataset} active=${active} suggested=${[suggestion]} text="Save as a version" /></p>`}
  </article>`;
}

/** @param {{app: App, dataset: string, active: ConfigVersion, suggested: readonly Suggestion[], text: string, isLarge?: boolean}} props */
function SaveButton({ app, dataset, active, suggested, text, isLarge = false }) {
  const [isBusy, setBusy] = useState(false);
  const save = async () => {
    setBusy(true);
    try {
      const { digest } = await jobs.saveConfig(dataset, withEdits(active.config, editsFor(suggested)));
      const query = queryOf(editsFor(suggested));
      app.toasts.show(`Saved as version ${digest.slice(0, 8)}; it decides nothing before it is applied.`, { action: { text: "Look at it", href: linkTo("thresholds", { dataset }, query) } });
    } catch (error) {
      app.notice(error);
      app.toasts.show(error instanceof Error ? error.message : String(error), { kind: "error" });
    }
    setBusy(false);
  };
  return html`<button class="button ${isLarge ? "" : "button--small"}" disabled=${isBusy} onClick=${save}>${text}</button>`;
}
