// @ts-check
// A share with its interval: a dot and whiskers on a scale from 0 to 100 %.

import { html } from "../../html.js";
import { intervalText, percentOf, shareText } from "../../measures.js";

/** @typedef {import("../../types_quality.js").Measure} Measure */

/** @param {{measure: Measure | null, name: string}} props */
export function Whisker({ measure, name }) {
  if (!measure) return html`<span class="whisker whisker--none" title=${`${name}: too few answers`}><span class="sr-only">not known</span></span>`;
  const [low, at, high] = [measure.low, measure.value, measure.high].map((share) => 100 * share);
  return html`<span class="whisker" title=${`${name} ${shareText(measure.value)}, 95 % between ${intervalText(measure)}`}>
    <svg class="whisker__svg" viewBox="0 0 100 12" preserveAspectRatio="none" aria-hidden="true" focusable="false">
      <line class="whisker__scale" x1="0" x2="100" y1="6" y2="6" />
      <line class="whisker__range" x1=${low} x2=${high} y1="6" y2="6" />
      <line class="whisker__range" x1=${low} x2=${low} y1="2.5" y2="9.5" />
      <line class="whisker__range" x1=${high} x2=${high} y1="2.5" y2="9.5" />
    </svg>
    <i class="whisker__dot" style=${{ left: `${at}%` }}></i>
  </span>`;
}

/** The number, its interval in words, and the drawing. @param {{measure: Measure | null, name: string}} props */
export function MeasureCell({ measure, name }) {
  return html`<div class="measure">
    <span class="measure__value num">${measure ? shareText(measure.value) : "–"}</span>
    <${Whisker} measure=${measure} name=${name} />
    <span class="measure__interval num">${measure ? `${percentOf(measure.low)}–${percentOf(measure.high)}` : ""}</span>
  </div>`;
}
