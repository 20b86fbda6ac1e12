// @ts-check
// Matches of boxes as bars, with the threshold as a line that one can drag.

import { html, useEffect, useLayoutEffect, useMemo, useRef, useState } from "../../html.js";
import { binsFor, countTicks, heightOf, rebinned, shortCount } from "../../bins.js";
import { drawChart } from "../../chart.js";
import { movedByKey, valueAt } from "../../slider.js";
import { countOf, percentText } from "../../wording.js";
import { paintBars } from "./bars.js";

/** @typedef {import("../../app.js").App} App */

/** The plot inside of the drawing; tuning.css puts the handle on the same place. */
const AXIS = { left: 40, bottom: 22 };
const PADDING = /** @type {[number, number, number, number]} */ ([10, 20, 0, 0]);

/**
 * @typedef {object} HistogramProps
 * @property {App} app
 * @property {string} name  of what is counted
 * @property {readonly number[]} counts
 * @property {number} threshold
 * @property {number} active  threshold of the active configuration
 * @property {boolean} isLog
 * @property {"large" | "small"} size
 * @property {(value: number) => void} onChange
 */

/** @param {HistogramProps} props */
export function Histogram({ app, name, counts, threshold, active, isLog, size, onChange }) {
  const element = useRef(/** @type {HTMLDivElement | null} */ (null));
  const chart = useRef(/** @type {ReturnType<typeof drawChart> | null} */ (null));
  const bars = useBars(element, counts, isLog, size);
  const [pointed, setPointed] = useState("");
  /** What the chart draws; it reads this whenever it draws. */
  const shown = useRef({ ...bars, threshold, active });
  shown.current = { ...bars, threshold, active };

  useEffect(() => {
    const { current } = element;
    if (!current) return undefined;
    chart.current = drawChart(current, app.prefs, (ink, font) => describe(ink, font, () => shown.current, size, setPointed), () => dataOf(shown.current.heights));
    return () => chart.current?.stop();
  }, []);
  useLayoutEffect(() => chart.current?.update(), [bars]);
  useLayoutEffect(() => {
    const isHeld = element.current?.parentElement?.contains(document.activeElement);
    if (isHeld) chart.current?.redraw();
    else chart.current?.redrawSoon();
  }, [threshold, active]);

  return html`<div class="histogram histogram--${size}">
    <div class="histogram__drawing" ref=${element}></div>
    <div class="histogram__track">
      <${Handle} name=${name} threshold=${threshold} size=${size} onChange=${onChange} />
    </div>
    ${pointed && html`<div class="histogram__pointed num">${pointed}</div>`}
  </div>`;
}

/** @param {{current: HTMLDivElement | null}} element @param {readonly number[]} counts @param {boolean} isLog @param {"large" | "small"} size */
function useBars(element, counts, isLog, size) {
  const [width, setWidth] = useState(0);
  useLayoutEffect(() => {
    if (!element.current) return undefined;
    const watcher = new ResizeObserver(([entry]) => setWidth(entry?.contentRect.width ?? 0));
    watcher.observe(element.current);
    return () => watcher.disconnect();
  }, []);
  const bins = binsFor(width - AXIS.left, counts.length);
  return useMemo(() => {
    const binned = rebinned(counts, bins);
    const ticks = countTicks(Math.max(0, ...binned), isLog, size === "large" ? 5 : 3);
    return { binned, ticks, heights: binned.map((count) => heightOf(count, isLog)), isLog };
  }, [counts, bins, isLog]);
}

/** @typedef {{binned: readonly number[], ticks: readonly number[], heights: readonly number[], isLog: boolean, threshold: number, active: number}} Shown */

/** @param {readonly number[]} heights @returns {import("../../chart.js").Data} */
const dataOf = (heights) => [heights.map((_, bin) => (100 * (bin + 0.5)) / heights.length), [...heights]];

/**
 * @param {import("../../chart.js").Ink} ink @param {string} font @param {() => Shown} shown @param {"large" | "small"} size
 * @param {(text: string) => void} onPoint
 */
function describe(ink, font, shown, size, onPoint) {
  const axis = { stroke: ink["text-faint"], font, ticks: { show: false }, gap: 4 };
  /** Labels that have room. @param {import("../../chart.js").UPlot} plot */
  const every = (plot) => (size === "small" ? 50 : plot.width < 560 ? 20 : 10);
  return {
    legend: { show: false },
    padding: PADDING,
    cursor: { y: false, points: { show: false }, drag: { x: false, y: false, setScale: false } },
    scales: {
      x: { time: false, range: /** @type {[number, number]} */ ([0, 100]) },
      y: { range: () => /** @type {[number, number]} */ ([0, heightOf(shown().ticks.at(-1) ?? 1, shown().isLog)]) },
    },
    series: [{}, { paths: () => null, points: { show: false } }],
    axes: [
      { ...axis, size: AXIS.bottom, grid: { show: false }, splits: (/** @type {import("../../chart.js").UPlot} */ plot) => range(0, 100, every(plot)), values: (/** @type {unknown} */ _, /** @type {number[]} */ at) => at.map((percent) => `${percent} %`) },
      {
        ...axis,
        size: AXIS.left,
        grid: { stroke: ink.line, width: 1 },
        splits: () => shown().ticks.map((count) => heightOf(count, shown().isLog)),
        // Nothing at the corner: the other axis begins there.
        values: () => shown().ticks.map((count) => (count === 0 ? "" : shortCount(count))),
      },
    ],
    hooks: {
      draw: [(/** @type {import("../../chart.js").UPlot} */ plot) => paintBars(plot, ink, shown())],
      setCursor: [(/** @type {import("../../chart.js").UPlot} */ plot) => onPoint(pointedText(plot.cursor.idx ?? null, shown().binned, plot.cursor.left ?? -1))],
    },
  };
}

/** @param {number} from @param {number} to @param {number} step */
const range = (from, to, step) => Array.from({ length: Math.floor((to - from) / step) + 1 }, (_, i) => from + i * step);

/** @param {number | null} bin @param {readonly number[]} binned @param {number} left px */
function pointedText(bin, binned, left) {
  if (bin === null || left < 0) return "";
  const size = 100 / binned.length;
  return `${bin * size}–${percentText((bin + 1) * size)}: ${countOf(binned[bin] ?? 0, "box", "boxes")}`;
}

/** @param {{name: string, threshold: number, size: string, onChange: (value: number) => void}} props */
function Handle({ name, threshold, size, onChange }) {
  const element = useRef(/** @type {HTMLDivElement | null} */ (null));
  const [isDragged, setDragged] = useState(false);

  /** @param {PointerEvent} event */
  const onPointerDown = (event) => {
    if (event.button !== 0) return;
    event.preventDefault();
    element.current?.setPointerCapture(event.pointerId);
    element.current?.focus({ preventScroll: true });
    setDragged(true);
  };
  /** @param {PointerEvent} event */
  const onPointerMove = (event) => {
    const track = element.current?.parentElement?.getBoundingClientRect();
    if (!track || !element.current?.hasPointerCapture(event.pointerId)) return;
    const value = valueAt(event.clientX, track.left, track.width);
    if (value !== threshold) onChange(value);
  };
  /** @param {KeyboardEvent} event */
  const onKeyDown = (event) => {
    const value = event.ctrlKey || event.altKey || event.metaKey ? null : movedByKey(threshold, event);
    if (value === null) return;
    event.preventDefault();
    if (value !== threshold) onChange(value);
  };
  return html`<div class="handle ${isDragged ? "is-dragged" : ""} ${threshold > 85 ? "is-right" : ""}" ref=${element} style=${{ left: `${threshold}%` }}
    role="slider" tabindex="0" aria-label=${`Threshold of ${name}`} aria-orientation="horizontal"
    aria-valuemin="0" aria-valuemax="100" aria-valuenow=${threshold} aria-valuetext=${percentText(threshold)}
    onPointerDown=${onPointerDown} onPointerMove=${onPointerMove} onLostPointerCapture=${() => setDragged(false)} onKeyDown=${onKeyDown}>
    <span class="handle__line"></span><span class="handle__knob"></span>
    ${size === "large" && html`<span class="handle__value num">${percentText(threshold)}</span>`}
  </div>`;
}
