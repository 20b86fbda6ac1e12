// @ts-check
// People against people: without their agreement nothing can be measured by them.

import { html } from "../../html.js";
import { kappaText } from "../../measures.js";
import { countOf, countText } from "../../wording.js";

/** @typedef {import("../../types_quality.js").Agreement} Agreement */

/** @param {{agreement: Agreement, reviewers: readonly {name: string, answers: number, keep: number, reject: number, unsure: number}[]}} props */
export function Reviewers({ agreement, reviewers }) {
  return html`<section class="panelbox quality__wide" aria-labelledby="reviewers-title">
    <header class="panelbox__head"><h2 id="reviewers-title">People</h2><span class="faint">${countOf(reviewers.length, "reviewer")}</span></header>
    <div class="quality__split quality__split--top">
      <div class="tablewrap"><table class="table">
        <thead><tr><th scope="col">Reviewer</th><th class="is-num" scope="col">Answers</th><th class="is-num" scope="col">Keep</th><th class="is-num" scope="col">Reject</th><th class="is-num" scope="col">Unsure</th></tr></thead>
        <tbody>${reviewers.map((one) => html`<tr key=${one.name}><th scope="row">${one.name}</th>${[one.answers, one.keep, one.reject, one.unsure].map((n) => html`<td class="is-num num">${countText(n)}</td>`)}</tr>`)}</tbody>
      </table></div>
      <${Together} agreement=${agreement} />
    </div>
  </section>`;
}

/** @param {{agreement: Agreement}} props */
function Together({ agreement }) {
  const { boxes, percent, kappa, interval, pairs } = agreement;
  if (boxes === 0) return html`<p class="panelbox__empty">No box has been answered by two people. When some are, this says how far they agree.</p>`;
  return html`<div class="together">
    <dl class="together__figures">
      <div><dt>agree on</dt><dd class="num">${percent === null ? "–" : `${Math.round(10 * percent) / 10} %`}</dd><dd class="faint">of ${countOf(boxes, "box", "boxes")} answered twice</dd></div>
      <div><dt>Cohen's kappa</dt><dd class="num">${kappaNumber(kappa)}</dd><dd class="faint">${kappaText(kappa)}${interval ? `, 95 %: ${kappaNumber(interval[0])} to ${kappaNumber(interval[1])}` : ""}</dd></div>
    </dl>
    <div class="tablewrap"><table class="table">
      <thead><tr><th scope="col">Pair</th><th class="is-num" scope="col">Boxes</th><th class="is-num" scope="col">Agree</th><th class="is-num" scope="col">Kappa</th></tr></thead>
      <tbody>${pairs.map((pair) => html`<tr key=${`${pair.a} ${pair.b}`}><th scope="row">${pair.a} and ${pair.b}</th><td class="is-num num">${countText(pair.boxes)}</td><td class="is-num num">${countText(pair.agreed)}</td><td class="is-num num">${kappaNumber(pair.kappa)}</td></tr>`)}</tbody>
    </table></div>
  </div>`;
}

/** @param {number | null} kappa */
const kappaNumber = (kappa) => (kappa === null ? "–" : kappa.toFixed(2).replace("-", "−"));
