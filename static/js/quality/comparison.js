// @ts-check
// The filter compared with the truth: the confusion matrix, scores with confidence intervals, and both by class or
// distance.

import { html, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf, countText } from "../core/numbers.js";
import { Segments, WideTable, numeric } from "../core/parts.js";
import { linkTo } from "../core/router.js";
import {
  CELLS,
  COUNTED,
  WORDS,
  answersIn,
  bandQuery,
  bandText,
  boxesOf,
  intervalText,
  percentOf,
  shareOf,
  shareText,
} from "./measures.js";

/** @import { Confusion, Measure, Quality } from "../core/openapi.js" */
/** @typedef {import("../core/openapi.js").Quality["truth"]} Truth */

const MEASURES = /** @type {const} */ ([
  { key: "precision", text: "Precision" },
  { key: "recall", text: "Recall" },
  { key: "f1", text: "F1" },
]);

/** @param {{dataset: string, quality: Quality}} props */
export function ConfusionPanel({ dataset, quality: { truth, confusion, sample } }) {
  const words = WORDS[truth];
  const conflicts = confusion.kept_reject + confusion.rejected_keep;
  return html`<section class="panelbox quality__all" aria-labelledby="confusion-title">
    <header class="panelbox__head"><h2 id="confusion-title">${words.all}</h2>
      <span class="faint">${words.counted(answersIn(confusion))}</span></header>
    <div class="quality__split">
      <${Matrix} dataset=${dataset} truth=${truth} confusion=${confusion} />
      <div>
        <p class="faint">
          ${
            sample
              ? html`<b>All ${countText(sample.boxes)} boxes</b>, estimated from ${countOf(
                  sample.answered,
                  "random answer",
                )}
              ${sample.before > 0 ? ` and the ${countText(sample.before)} before them` : ""}
              ${sample.unsure > 0 ? `; ${countText(sample.unsure)} unsure left out` : ""}`
              : "Every box that has a truth is counted: nothing is estimated."
          }</p>
        <dl class="scores">
          ${MEASURES.map(({ key, text }) => {
            const measure = confusion[key];
            return html`<div class="score" key=${key}>
              <dt>${text} <span class="faint">${key === "f1" ? "both in one number" : words[key]}</span></dt>
              <dd><span class="score__value num">${shareText(measure?.value)}</span>
                <${Whisker} measure=${measure} name=${text} />
                <span class="score__interval num faint">
                  ${measure ? `95 %: ${intervalText(measure)}` : intervalText(measure)}
                </span></dd>
            </div>`;
          })}
        </dl></div>
    </div>
    ${
      truth === "people" &&
      conflicts > 0 &&
      html`<p class="quality__conflicts">
        <a class="button" href=${linkTo("grid", { dataset }, { conflict: "true" })}>
          ${`See the ${conflicts === 1 ? "box" : `${countText(conflicts)} boxes`} on which they differ`}
          <${Icon} name="right" /></a></p>`
    }
  </section>`;
}

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
          ${CELLS.filter((cell) => cell.filter === filter).map(
            (cell) => html`<td key=${cell.cell}>
              <${MatrixCell} confusion=${confusion} cell=${cell} href=${boxesOf(dataset, truth, cell)} />
            </td>`,
          )}
        </tr>`,
      )}
    </tbody>
  </table>`;
}

/** @param {{confusion: Confusion, cell: typeof CELLS[number], href: string | null}} props */
function MatrixCell({ confusion, cell, href }) {
  const count = confusion[cell.cell];
  const share = shareOf(confusion, cell.cell);
  const inner = html`<span class="matrixcell__fill" style=${{ opacity: count ? 0.12 + 0.28 * share : 0 }}></span>
  <span class="matrixcell__sign"><${Icon} name=${cell.isAgreed ? "check" : "warn"} /></span>
  <span class="matrixcell__count num">${countText(count)}</span>
  <span class="matrixcell__share num">${percentOf(share)} %</span>
  <span class="matrixcell__text">${cell.text}</span>`;
  const name = `matrixcell matrixcell--${cell.isAgreed ? "agreed" : "differ"}`;
  return count > 0 && href
    ? html`<a class=${name} href=${href}>${inner}</a>`
    : html`<span class=${name}>${inner}</span>`;
}

/** @typedef {{text: string, confusion: Confusion, query: Record<string, string> | null}} Group */

const CHOICES = [
  { value: "class", text: "Class" },
  { value: "distance", text: "Distance" },
];

/** Over the scores of a group or of a kind of evidence, and what it got wrong. */
export const SCORE_HEADS = [
  ...MEASURES.map(({ text }) => text),
  numeric("Kept ghosts", COUNTED.kept),
  numeric("Lost boxes", COUNTED.lost),
];

/** @param {{dataset: string, quality: Quality}} props */
export function PerGroup({ dataset, quality }) {
  const [by, setBy] = useState("class");
  /** @type {Group[]} */
  const groups =
    by === "class"
      ? Object.entries(quality.by_class).map(([name, confusion]) => ({ text: name, confusion, query: { class: name } }))
      : quality.by_distance.map((confusion) => {
          const { band } = confusion;
          return { text: bandText(band), confusion, query: bandQuery(band) };
        });
  return html`<section class="panelbox quality__wide" aria-labelledby="groups-title">
    <header class="panelbox__head"><h2 id="groups-title">${by === "class" ? "By class" : "By distance"}</h2>
      <span class="faint">dot: measured; line: 95 % interval; axis from 0 to 100 %</span>
      <span class="panelbox__tools"><${Segments} label="Compare by" value=${by} choices=${CHOICES} onChange=${setBy} />
      </span></header>
    <${WideTable} label="Scores" kind="groups"
      heads=${[by === "class" ? "Class" : "Distance", numeric(WORDS[quality.truth].column), ...SCORE_HEADS]}>
      ${groups
        .filter(({ confusion }) => answersIn(confusion) > 0)
        .map(
          (group) => html`<${Row} key=${group.text} dataset=${dataset} truth=${quality.truth} group=${group} />`,
        )}<//>
  </section>`;
}

/** @param {{dataset: string, truth: import("../core/openapi.js").Quality["truth"], group: Group}} props */
function Row({ dataset, truth, group }) {
  const { confusion, text, query } = group;
  /** @type {Record<string, string>} */
  const answered = truth === "people" ? { review: "decided" } : {};
  return html`<tr>
    <th
      scope="row">${query ? html`<a href=${linkTo("grid", { dataset }, { ...query, ...answered })}>${text}</a>` : text}
    </th>
    <td class="is-num num">${countText(answersIn(confusion))}</td>
    <td><${MeasureCell} measure=${confusion.precision} name="Precision" /></td>
    <td><${MeasureCell} measure=${confusion.recall} name="Recall" /></td>
    <td><${MeasureCell} measure=${confusion.f1} name="F1" /></td>
    ${CELLS.filter(({ isAgreed }) => !isAgreed).map((about) => {
      const count = countText(confusion[about.cell]);
      const href = confusion[about.cell] > 0 && query ? boxesOf(dataset, truth, about, query) : null;
      return html`<td class="is-num num"
        key=${about.cell}>${href ? html`<a title=${about.text} href=${href}>${count}</a>` : count}</td>`;
    })}
  </tr>`;
}

/** `most` is the share at the right end. @param {{measure: Measure | null, name: string, most?: number}} props */
function Whisker({ measure, name, most = 1 }) {
  if (!measure)
    return html`<span class="whisker whisker--none"
      title=${`${name}: ${intervalText(measure)}`}><span class="sr-only">not known</span></span>`;
  const [low, at, high] = [measure.low, measure.value, measure.high].map((share) => (100 * share) / most);
  return html`<span class="whisker"
    title=${`${name} ${shareText(measure.value)}, 95 % between ${intervalText(measure)}`}>
    <svg class="whisker__svg" viewBox="0 0 100 12" preserveAspectRatio="none" aria-hidden="true" focusable="false">
      <line class="whisker__scale" x1="0" x2="100" y1="6" y2="6" />
      <line class="whisker__range" x1=${low} x2=${high} y1="6" y2="6" />
      <line class="whisker__range" x1=${low} x2=${low} y1="2.5" y2="9.5" />
      <line class="whisker__range" x1=${high} x2=${high} y1="2.5" y2="9.5" />
    </svg>
    <i class="whisker__dot" style=${{ left: `${at}%` }}></i>
  </span>`;
}

/** A score as number, drawing and interval. @param {{measure: Measure | null, name: string, most?: number}} props */
export function MeasureCell({ measure, name, most = 1 }) {
  return html`<div class="measure">
    <span class="measure__value num">${measure ? shareText(measure.value) : "–"}</span>
    <${Whisker} measure=${measure} name=${name} most=${most} />
    <span class="measure__interval num">${measure ? `${percentOf(measure.low)}–${percentOf(measure.high)}` : ""}</span>
  </div>`;
}
