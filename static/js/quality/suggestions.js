// @ts-check
// Suggested thresholds, how certain they are, and the scores over all thresholds as curves.

import { post } from "../core/api.js";
import { drawChart } from "../core/chart.js";
import { useTask } from "../core/hooks.js";
import { html, useEffect, useRef } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { percentText } from "../core/numbers.js";
import { Segments } from "../core/parts.js";
import { linkTo } from "../core/router.js";
import { OWN_SHARE, editsFor, queryOf, withEdits, worthTrying } from "../tuning/config.js";
import { requireActive } from "../tuning/versions.js";
import { FEW_ANSWERS, WORDS, shareText } from "./measures.js";

/** @import { default as UPlot } from "../../vendor/uplot-1.6.32.module.js" */
/** @import { App } from "../core/app.js" */
/** @import { Data, Ink } from "../core/chart.js" */
/** @import { ConfigVersion, Suggestion } from "../core/openapi.js" */

const TARGETS = [
  { value: "f1", text: "Best F1" },
  { value: "recall", text: "Keep 99 % of the visible objects" },
];

/**
 * @param {{app: App, dataset: string, truth: import("../core/openapi.js").Quality["truth"], suggested: readonly
 *   Suggestion[], active: ConfigVersion, target: string,
 *   onTarget: (target: string) => void, onOutdated: () => void}} props  `onOutdated`: another version has become active
 */
export function Suggestions({ app, dataset, truth, suggested, active, target, onTarget, onOutdated }) {
  const words = WORDS[truth];
  const better = worthTrying(suggested, target);
  return html`<section class="panelbox quality__wide" aria-labelledby="suggested-title">
    <header class="panelbox__head"><h2 id="suggested-title">Suggested thresholds</h2>
      <span class="faint">${words.goals[target]}</span>
      <span class="panelbox__tools">
        <${Segments} label="What to suggest for" value=${target} choices=${TARGETS} onChange=${onTarget} />
        ${
          better.length > 0 &&
          html`<a class="button"
            href=${linkTo("thresholds", { dataset }, queryOf(editsFor(better)))}>Try all ${better.length}</a>
          <${SaveButton} app=${app} dataset=${dataset} active=${active} suggested=${better} text="Save all as a version"
            isLarge onOutdated=${onOutdated} />`
        }</span>
    </header>
    ${suggested.length === 0 && html`<p class="panelbox__empty">${words.both}</p>`}
    ${
      suggested.length > 0 &&
      html`<p class="chartlegend">
        <span><i class="line line--f1"></i>F1</span><span><i class="line line--precision"></i>precision</span>
        <span><i class="line line--recall"></i>recall</span>
        <span><i class="line line--current"></i>active</span>
        <span><i class="line line--suggested"></i>suggested, with its 95 % interval</span>
      </p>`
    }
    <ul class="suggestions">${suggested.map(
      (suggestion) => html`<li key=${`${suggestion.class} ${suggestion.key}`}>
        <${Card} app=${app} dataset=${dataset} active=${active} onOutdated=${onOutdated} suggestion=${suggestion}
          known=${words.some(suggestion.answers)} isBetter=${better.includes(suggestion)} />
      </li>`,
    )}</ul>
  </section>`;
}

/**
 * @param {{app: App, dataset: string, active: ConfigVersion, onOutdated: () => void, suggestion: Suggestion, known:
 *   string, isBetter: boolean}} props
 */
function Card({ app, dataset, active, onOutdated, suggestion, known, isBetter }) {
  const { class: name, current, suggested, interval, answers, f1_current: before, f1_suggested: after } = suggestion;
  return html`<article class="suggestion" aria-label=${name}>
    <header class="suggestion__head">
      <h3>${name}</h3>
      <span class="faint">${suggestion.key === OWN_SHARE ? "own pixels · " : ""}${known}
        ${answers < FEW_ANSWERS ? html` <span class="warn">few</span>` : ""}</span>
    </header>
    <p class="suggestion__change num"><span>${percentText(current)}</span>
      ${
        isBetter
          ? html`<${Icon} name="right" /><strong>${percentText(suggested)}</strong>`
          : html`<span class="faint">stays</span>`
      }
      ${
        isBetter &&
        interval &&
        html`<span class="faint suggestion__interval">${percentText(interval[0])} to ${percentText(interval[1])}</span>`
      }</p>
    <p class="suggestion__f1 num faint">F1 ${shareText(before)}
      ${isBetter ? html` → <strong>${shareText(after)}</strong>` : ""}</p>
    <${Curve} app=${app} suggestion=${suggestion} />
    ${
      isBetter &&
      html`<p class="suggestion__actions">
        <a class="button button--small"
          href=${linkTo("thresholds", { dataset }, { ...queryOf(editsFor([suggestion])), class: name })}>Try it<span
            class="sr-only">: ${percentText(suggested)} for ${name}</span></a>
        <${SaveButton} app=${app} dataset=${dataset} active=${active} suggested=${[suggestion]} text="Save as a version"
          onOutdated=${onOutdated} /></p>`
    }
  </article>`;
}

/**
 * @param {{app: App, dataset: string, active: ConfigVersion, suggested: readonly Suggestion[], text: string, isLarge?:
 *   boolean, onOutdated: () => void}} props
 */
function SaveButton({ app, dataset, active, suggested, text, isLarge = false, onOutdated }) {
  const { run: save, isBusy } = useTask(async () => {
    await requireActive(dataset, active.digest, onOutdated);
    const { digest } = await post("/api/v1/datasets/{dataset}/configs", {
      path: { dataset },
      body: withEdits(active.config, editsFor(suggested)),
    });
    const query = queryOf(editsFor(suggested));
    app.toasts.show(`Saved as version ${digest.slice(0, 8)}; it has no effect until it is applied.`, {
      action: { text: "Look at it", href: linkTo("thresholds", { dataset }, query) },
    });
  }, app.toasts.fail);
  return html`<button class="button ${isLarge ? "" : "button--small"}" disabled=${isBusy}
    onClick=${save}>${text}</button>`;
}

const TABLE_ROWS = 12;

/** @param {{app: App, suggestion: Suggestion}} props */
function Curve({ app, suggestion }) {
  const element = useRef(/** @type {HTMLDivElement | null} */ (null));
  useEffect(() => {
    if (!element.current) return undefined;
    const chart = drawChart(
      element.current,
      app.prefs,
      (ink, font) => describe(ink, font, suggestion),
      () => dataOf(suggestion),
    );
    return chart.stop;
  }, [suggestion]);
  return html`<div
    class="curve"><div class="curve__drawing" ref=${element}></div><${CurveTable} suggestion=${suggestion} /></div>`;
}

/** @param {Suggestion} suggestion @returns {Data} */
const dataOf = ({ curve }) => [
  curve.map((p) => p.threshold),
  curve.map((p) => percent(p.precision)),
  curve.map((p) => percent(p.recall)),
  curve.map((p) => percent(p.f1)),
];

/** @param {number | null} share */
const percent = (share) => (share === null ? null : 100 * share);

/** @param {Ink} ink @param {string} font @param {Suggestion} suggestion */
function describe(ink, font, suggestion) {
  const axis = { stroke: ink["text-faint"], font, ticks: { show: false }, gap: 4 };
  const line = { points: { show: false }, spanGaps: true };
  const values = (/** @type {unknown} */ _, /** @type {number[]} */ at) => at.map((value) => `${value} %`);
  return {
    legend: { show: false },
    padding: /** @type {[number, number, number, number]} */ ([8, 18, 0, 0]),
    cursor: { show: false },
    scales: {
      x: { time: false, range: /** @type {[number, number]} */ ([0, 100]) },
      y: { range: /** @type {[number, number]} */ ([0, 100]) },
    },
    series: [
      {},
      { ...line, stroke: ink.accent, width: 1.5, dash: [6, 4] },
      { ...line, stroke: ink.unsure, width: 1.5, dash: [2, 3] },
      { ...line, stroke: ink.text, width: 2 },
    ],
    axes: [
      { ...axis, size: 22, grid: { show: false }, splits: () => [25, 50, 75, 100], values },
      { ...axis, size: 44, grid: { stroke: ink.line, width: 1 }, splits: () => [0, 50, 100], values },
    ],
    hooks: { drawClear: [(/** @type {UPlot} */ plot) => paintMarks(plot, ink, suggestion)] },
  };
}

/** @param {UPlot} plot @param {Ink} ink @param {Suggestion} suggestion */
function paintMarks(plot, ink, { current, suggested, interval }) {
  const { ctx, bbox } = plot;
  const at = (/** @type {number} */ value) => plot.valToPos(value, "x", true);
  ctx.save();
  if (interval) {
    ctx.globalAlpha = 0.16;
    ctx.fillStyle = ink["kept-strong"] ?? "";
    ctx.fillRect(at(interval[0]), bbox.top, Math.max(devicePixelRatio, at(interval[1]) - at(interval[0])), bbox.height);
    ctx.globalAlpha = 1;
  }
  for (const [value, color, dash] of /** @type {const} */ ([
    [current, ink["text-faint"], [3, 3]],
    [suggested, ink["kept-strong"], []],
  ])) {
    ctx.strokeStyle = color ?? "";
    ctx.lineWidth = 1.5 * devicePixelRatio;
    ctx.setLineDash(dash.map((px) => px * devicePixelRatio));
    ctx.beginPath();
    ctx.moveTo(at(value), bbox.top);
    ctx.lineTo(at(value), bbox.top + bbox.height);
    ctx.stroke();
  }
  ctx.restore();
}

/** The curve as numbers, for screen readers. @param {{suggestion: Suggestion}} props */
function CurveTable({ suggestion }) {
  const step = Math.max(1, Math.ceil(suggestion.curve.length / TABLE_ROWS));
  return html`<table class="sr-only">
    <caption>Scores of ${suggestion.class} over the threshold</caption>
    <thead>
      <tr><th scope="col">Threshold</th><th scope="col">Precision</th><th scope="col">Recall</th><th scope="col">F1</th>
      </tr></thead>
    <tbody>
      ${suggestion.curve
        .filter((_, i) => i % step === 0)
        .map(
          (p) => html`<tr>
            <th scope="row">${percentText(p.threshold)}</th><td>${shareText(p.precision)}</td>
            <td>${shareText(p.recall)}</td><td>${shareText(p.f1)}</td></tr>`,
        )}</tbody>
  </table>`;
}
