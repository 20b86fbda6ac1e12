// @ts-check
// The confusion matrix, drawn: what the filter said against what people said. Each field leads
// to its boxes.

import { html } from "../../html.js";
import { CELLS, answersIn, cellQuery, intervalText, percentOf, shareOf, shareText } from "../../measures.js";
import { linkTo } from "../../router.js";
import { countOf, countText } from "../../wording.js";
import { Icon } from "../icons.js";
import { Whisker } from "./whisker.js";

/** @typedef {import("../../types_quality.js").Confusion} Confusion */

const MEASURES = /** @type {const} */ ([
  { key: "precision", text: "Precision", help: "of the boxes that the filter keeps, people keep" },
  { key: "recall", text: "Recall", help: "of the boxes that people keep, the filter keeps" },
  { key: "f1", text: "F1", help: "both in one number" },
]);

/** @param {{dataset: string, confusion: Confusion}} props */
export function ConfusionPanel({ dataset, confusion }) {
  return html`<section class="panelbox quality__all" aria-labelledby="confusion-title">
    <header class="panelbox__head"><h2 id="confusion-title">All boxes that were answered</h2><span class="faint">${countOf(answersIn(confusion), "answer")}, the latest of each box</span></header>
    <div class="quality__split">
      <${Matrix} dataset=${dataset} confusion=${confusion} />
      <dl class="scores">
        ${MEASURES.map(({ key, text, help }) => {
          const measure = confusion[key];
          return html`<div class="score" key=${key}>
            <dt>${text} <span class="faint">${help}</span></dt>
            <dd><span class="score__value num">${shareText(measure?.value)}</span><${Whisker} measure=${measure} name=${text} />
              <span class="score__interval num faint">${measure ? `95 %: ${intervalText(measure)}` : intervalText(measure)}</span></dd>
          </div>`;
        })}
      </dl>
    </div>
    ${confusion.kept_reject + confusion.rejected_keep > 0 &&
    html`<p class="quality__conflicts"><a class="button" href=${linkTo("grid", { dataset }, { conflict: "true" })}>${conflictText(confusion.kept_reject + confusion.rejected_keep)}<${Icon} name="right" /></a></p>`}
  </section>`;
}

/** @param {number} n */
const conflictText = (n) => (n === 1 ? "See the box on which they differ" : `See the ${countText(n)} boxes on which they differ`);

/** @param {{dataset: string, confusion: Confusion}} props */
function Matrix({ dataset, confusion }) {
  return html`<table class="matrix">
    <caption class="sr-only">What the filter said, in rows, against what people said, in columns</caption>
    <thead><tr><td></td><th scope="col">people keep</th><th scope="col">people reject</th></tr></thead>
    <tbody>
      ${["kept", "rejected"].map(
        (filter) => html`<tr key=${filter}>
          <th scope="row">filter ${filter === "kept" ? "keeps" : "rejects"}</th>
          ${CELLS.filter((cell) => cell.filter === filter).map((cell) => html`<td key=${cell.cell}><${Field} dataset=${dataset} confusion=${confusion} cell=${cell} /></td>`)}
        </tr>`,
      )}
    </tbody>
  </table>`;
}

/** @param {{dataset: string, confusion: Confusion, cell: typeof CELLS[number]}} props */
function Field({ dataset, confusion, cell }) {
  const count = confusion[cell.cell];
  const share = shareOf(confusion, cell.cell);
  const inner = html`<span class="field2__fill" style=${{ opacity: count ? 0.12 + 0.5 * share : 0 }}></span>
    <span class="field2__sign"><${Icon} name=${cell.isAgreed ? "check" : "warn"} /></span>
    <span class="field2__count num">${countText(count)}</span>
    <span class="field2__share num">${percentOf(share)} %</span>
    <span class="field2__text">${cell.text}</span>`;
  const name = `field2 field2--${cell.isAgreed ? "agreed" : "differ"}`;
  return count > 0
    ? html`<a class=${name} href=${linkTo("grid", { dataset }, cellQuery(cell.filter, cell.person))}>${inner}</a>`
    : html`<span class=${name}>${inner}</span>`;
}
