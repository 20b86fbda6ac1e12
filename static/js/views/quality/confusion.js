// @ts-check
// The confusion matrix, drawn: what the filter said against what is true. Where people say what
// is, each field leads to its boxes.

import { html } from "../../html.js";
import { CELLS, answersIn, intervalText, percentOf, shareOf, shareText } from "../../measures.js";
import { linkTo } from "../../router.js";
import { countText } from "../../wording.js";
import { Icon } from "../icons.js";
import { WORDS, boxesOf } from "./truths.js";
import { Whisker } from "./whisker.js";

/** @typedef {import("../../types_quality.js").Confusion} Confusion */
/** @typedef {import("../../types_quality.js").Truth} Truth */

const MEASURES = /** @type {const} */ ([
  { key: "precision", text: "Precision" },
  { key: "recall", text: "Recall" },
  { key: "f1", text: "F1" },
]);

/** @param {{dataset: string, truth: Truth, confusion: Confusion}} props */
export function ConfusionPanel({ dataset, truth, confusion }) {
  const words = WORDS[truth];
  return html`<section class="panelbox quality__all" aria-labelledby="confusion-title">
    <header class="panelbox__head"><h2 id="confusion-title">${words.all}</h2><span class="faint">${words.counted(answersIn(confusion))}</span></header>
    <div class="quality__split">
      <${Matrix} dataset=${dataset} truth=${truth} confusion=${confusion} />
      <dl class="scores">
        ${MEASURES.map(({ key, text }) => {
          const measure = confusion[key];
          return html`<div class="score" key=${key}>
            <dt>${text} <span class="faint">${key === "f1" ? "both in one number" : words[key]}</span></dt>
            <dd><span class="score__value num">${shareText(measure?.value)}</span><${Whisker} measure=${measure} name=${text} />
              <span class="score__interval num faint">${measure ? `95 %: ${intervalText(measure)}` : intervalText(measure)}</span></dd>
          </div>`;
        })}
      </dl>
    </div>
    ${truth === "people" && confusion.kept_reject + confusion.rejected_keep > 0 &&
    html`<p class="quality__conflicts"><a class="button" href=${linkTo("grid", { dataset }, { conflict: "true" })}>${conflictText(confusion.kept_reject + confusion.rejected_keep)}<${Icon} name="right" /></a></p>`}
  </section>`;
}

/** @param {number} n */
const conflictText = (n) => (n === 1 ? "See the box on which they differ" : `See the ${countText(n)} boxes on which they differ`);

/** @param {{dataset: string, truth: Truth, confusion: Confusion}} props */
function Matrix({ dataset, truth, confusion }) {
  const words = WORDS[truth];
  return html`<table class="matrix">
    <caption class="sr-only">What the filter said, in rows, against ${words.said}, in columns</caption>
    <thead><tr><td></td><th scope="col">${words.keep}</th><th scope="col">${words.reject}</th></tr></thead>
    <tbody>
      ${["kept", "rejected"].map(
        (filter) => html`<tr key=${filter}>
          <th scope="row">filter ${filter === "kept" ? "keeps" : "rejects"}</th>
          ${CELLS.filter((cell) => cell.filter === filter).map((cell) => html`<td key=${cell.cell}><${Field} confusion=${confusion} cell=${cell} href=${boxesOf(dataset, truth, cell)} /></td>`)}
        </tr>`,
      )}
    </tbody>
  </table>`;
}

/** @param {{confusion: Confusion, cell: typeof CELLS[number], href: string | null}} props */
function Field({ confusion, cell, href }) {
  const count = confusion[cell.cell];
  const share = shareOf(confusion, cell.cell);
  const inner = html`<span class="field2__fill" style=${{ opacity: count ? 0.12 + 0.28 * share : 0 }}></span>
    <span class="field2__sign"><${Icon} name=${cell.isAgreed ? "check" : "warn"} /></span>
    <span class="field2__count num">${countText(count)}</span>
    <span class="field2__share num">${percentOf(share)} %</span>
    <span class="field2__text">${cell.text}</span>`;
  const name = `field2 field2--${cell.isAgreed ? "agreed" : "differ"}`;
  return count > 0 && href ? html`<a class=${name} href=${href}>${inner}</a>` : html`<span class=${name}>${inner}</span>`;
}
