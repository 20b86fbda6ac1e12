// @ts-check
// Precision, recall and F1 over the threshold, with the active and the suggested one.

import { html, useEffect, useRef } from "../../html.js";
import { drawChart } from "../../chart.js";
import { shareText } from "../../measures.js";
import { percentText } from "../../wording.js";

/** @typedef {import("../../types_quality.js").Suggestion} Suggestion */
/** @typedef {import("../../chart.js").UPlot} UPlot */
/** @typedef {import("../../chart.js").Ink} Ink */

const TABLE_ROWS = 12;

/** @param {{app: import("../../app.js").App, suggestion: Suggestion}} props */
export function Curve({ app, suggestion }) {
  const element = useRef(/** @type {HTMLDivElement | null} */ (null));
  useEffect(() => {
    if (!element.current) return undefined;
    const chart = drawChart(element.current, app.prefs, (ink, font) => describe(ink, font, suggestion), () => dataOf(suggestion));
    return chart.stop;
  }, [suggestion]);
  return html`<div class="curve"><div class="curve__drawing" ref=${element}></div><${CurveTable} suggestion=${suggestion} /></div>`;
}

/** @param {Suggestion} suggestion @returns {import("../../chart.js").Data} */
const dataOf = ({ curve }) => [curve.map((p) => p.threshold), curve.map((p) => percent(p.precision)), curve.map((p) => percent(p.recall)), curve.map((p) => percent(p.f1))];

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
    scales: { x: { time: false, range: /** @type {[number, number]} */ ([0, 100]) }, y: { range: /** @type {[number, number]} */ ([0, 100]) } },
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
  for (const [value, color, dash] of /** @type {const} */ ([[current, ink["text-faint"], [3, 3]], [suggested, ink["kept-strong"], []]])) {
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

/** The drawing in numbers, for whoever cannot see it. @param {{suggestion: Suggestion}} props */
function CurveTable({ suggestion }) {
  const step = Math.max(1, Math.ceil(suggestion.curve.length / TABLE_ROWS));
  return html`<table class="sr-only">
    <caption>Scores of ${suggestion.class} over the threshold</caption>
    <thead><tr><th scope="col">Threshold</th><th scope="col">Precision</th><th scope="col">Recall</th><th scope="col">F1</th></tr></thead>
    <tbody>${suggestion.curve.filter((_, i) => i % step === 0).map((p) => html`<tr><th scope="row">${percentText(p.threshold)}</th><td>${shareText(p.precision)}</td><td>${shareText(p.recall)}</td><td>${shareText(p.f1)}</td></tr>`)}</tbody>
  </table>`;
}
