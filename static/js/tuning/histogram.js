// @ts-check
// A histogram of shares of matching pixels, with a threshold that can be dragged or moved by keys.

import { drawChart } from "../core/chart.js";
import { html, useEffect, useLayoutEffect, useMemo, useRef, useState } from "../core/html.js";
import { countOf, percentText } from "../core/numbers.js";

/** @import { default as UPlot } from "../../vendor/uplot-1.6.32.module.js" */
/** @import { App } from "../core/app.js" */
/** @import { Data, Ink } from "../core/chart.js" */

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
    chart.current = drawChart(
      current,
      app.prefs,
      (ink, font) => describe(ink, font, () => shown.current, size, setPointed),
      () => dataOf(shown.current.heights),
    );
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

/**
 * @param {{current: HTMLDivElement | null}} element @param {readonly number[]} counts @param {boolean} isLog
 * @param {"large" | "small"} size
 */
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

/**
 * @typedef {{binned: readonly number[], ticks: readonly number[], heights: readonly number[], isLog: boolean,
 *   threshold: number, active: number}} Shown
 */

/** @param {readonly number[]} heights @returns {Data} */
const dataOf = (heights) => [heights.map((_, bin) => (100 * (bin + 0.5)) / heights.length), [...heights]];

/**
 * @param {Ink} ink @param {string} font @param {() => Shown} shown
 * @param {"large" | "small"} size @param {(text: string) => void} onPoint
 */
function describe(ink, font, shown, size, onPoint) {
  const axis = { stroke: ink["text-faint"], font, ticks: { show: false }, gap: 4 };
  /** Labels that have room. @param {UPlot} plot */
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
      {
        ...axis,
        size: AXIS.bottom,
        grid: { show: false },
        splits: (/** @type {UPlot} */ plot) => range(0, 100, every(plot)),
        values: (/** @type {unknown} */ _, /** @type {number[]} */ at) => at.map((percent) => `${percent} %`),
      },
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
      draw: [(/** @type {UPlot} */ plot) => paintBars(plot, ink, shown())],
      setCursor: [
        (/** @type {UPlot} */ plot) =>
          onPoint(pointedText(plot.cursor.idx ?? null, shown().binned, plot.cursor.left ?? -1)),
      ],
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
  return html`<div class="handle ${isDragged ? "is-dragged" : ""} ${threshold > 85 ? "is-right" : ""}" ref=${element}
    style=${{ left: `${threshold}%` }}
    role="slider" tabindex="0" aria-label=${`Threshold of ${name}`} aria-orientation="horizontal"
    aria-valuemin="0" aria-valuemax="100" aria-valuenow=${threshold} aria-valuetext=${percentText(threshold)}
    onPointerDown=${onPointerDown} onPointerMove=${onPointerMove} onLostPointerCapture=${() => setDragged(false)}
    onKeyDown=${onKeyDown}>
    <span class="handle__line"></span><span class="handle__knob"></span>
    ${size === "large" && html`<span class="handle__value num">${percentText(threshold)}</span>`}
  </div>`;
}

/**
 * Neighbouring bins together.
 * @param {readonly number[]} counts @param {number} wanted how many bins; divides their number
 */
export function rebinned(counts, wanted) {
  const size = Math.max(1, Math.round(counts.length / wanted));
  return Array.from({ length: Math.ceil(counts.length / size) }, (_, bin) =>
    sum(counts.slice(bin * size, (bin + 1) * size)),
  );
}

/** @param {readonly number[]} counts */
const sum = (counts) => counts.reduce((total, n) => total + n, 0);

/** All classes as one. @param {readonly (readonly number[])[]} perClass */
export function together(perClass) {
  const bins = Math.max(0, ...perClass.map((counts) => counts.length));
  return Array.from({ length: bins }, (_, bin) => sum(perClass.map((counts) => counts[bin] ?? 0)));
}

/**
 * The number of bins for which bars are wide enough to be seen.
 * @param {number} width px
 * @param {number} most a multiple of 4
 */
export function binsFor(width, most) {
  if (width >= most * 4) return most;
  return width >= most * 2 ? most / 2 : most / 4;
}

/** Height of a count on the axis; nothing is 0 on either scale. @param {number} count @param {boolean} isLog */
export const heightOf = (count, isLog) => (isLog ? Math.log10(1 + count) : count);

/**
 * Round counts for the axis, 0 first, the last one at or above the tallest bar.
 * @param {number} tallest @param {boolean} isLog @param {number} [most]
 */
export function countTicks(tallest, isLog, most = 5) {
  if (tallest <= 0) return [0, 1];
  return isLog ? logTicks(tallest, most) : linearTicks(tallest, most);
}

/** @param {number} tallest @param {number} most */
function logTicks(tallest, most) {
  const top = Math.ceil(Math.log10(tallest + 1));
  const step = Math.ceil(top / Math.max(1, most - 1));
  const ticks = [0];
  for (let power = step; power < top + step; power += step) ticks.push(10 ** power);
  return ticks;
}

/** @param {number} tallest @param {number} most */
function linearTicks(tallest, most) {
  const raw = tallest / Math.max(1, most - 1);
  const size = 10 ** Math.floor(Math.log10(raw));
  const step = Math.max(1, ([1, 2, 5, 10].find((nice) => nice * size >= raw) ?? 10) * size);
  return Array.from({ length: Math.ceil(tallest / step) + 1 }, (_, i) => i * step);
}

/** 12 000 as 12k, for axes. @param {number} count */
export function shortCount(count) {
  if (count >= 1e6) return `${count / 1e6}M`;
  return count >= 1e4 ? `${count / 1e3}k` : String(count);
}

const STEP = 0.5;
const LARGE_STEP = 5;
const PAGE_STEP = 10;

/** @param {number} value */
const clampPercent = (value) => Math.min(100, Math.max(0, value));

/** @type {Record<string, (value: number, isLarge: boolean) => number>} */
const MOVES = {
  ArrowRight: (value, isLarge) => value + (isLarge ? LARGE_STEP : STEP),
  ArrowUp: (value, isLarge) => value + (isLarge ? LARGE_STEP : STEP),
  ArrowLeft: (value, isLarge) => value - (isLarge ? LARGE_STEP : STEP),
  ArrowDown: (value, isLarge) => value - (isLarge ? LARGE_STEP : STEP),
  PageUp: (value) => value + PAGE_STEP,
  PageDown: (value) => value - PAGE_STEP,
  Home: () => 0,
  End: () => 100,
};

/**
 * Where a key moves the threshold; null when the key is not one of the slider's.
 * @param {number} value @param {{key: string, shiftKey: boolean}} press
 */
export function movedByKey(value, { key, shiftKey }) {
  const move = MOVES[key];
  // Two digits, so that steps never leave 10.499999.
  return move ? Math.round(clampPercent(move(value, shiftKey)) * 100) / 100 : null;
}

/**
 * The threshold under a pointer, in steps of half a percent.
 * @param {number} x px
 * @param {number} left px
 * @param {number} width px
 */
export function valueAt(x, left, width) {
  const share = width > 0 ? (x - left) / width : 0;
  return clampPercent(Math.round((100 * share) / STEP) * STEP);
}

/** The typed text as a percentage; null if it is none. @param {string} text */
export function typedPercent(text) {
  const value = Number(text.replace(",", ".").replace("%", "").trim() || NaN);
  return Number.isFinite(value) && value >= 0 && value <= 100 ? value : null;
}

/** @typedef {{heights: readonly number[], threshold: number, active: number}} Bars */

const HATCH_PX = 5;

/** @param {UPlot} plot @param {Ink} ink @param {Bars} bars */
function paintBars(plot, ink, { heights, threshold, active }) {
  const { ctx, bbox } = plot;
  const at = (/** @type {number} */ percent) => plot.valToPos(percent, "x", true);
  const shape = barShape(plot, heights);
  const split = at(threshold);
  if (active !== threshold) paintChange(plot, ink, at(active), split);
  within(ctx, bbox.left, split, bbox, () => {
    ctx.globalAlpha = 0.3;
    ctx.fillStyle = ink["rejected-strong"] ?? "";
    ctx.fill(shape);
    ctx.globalAlpha = 1;
    ctx.fillStyle = hatch(ctx, ink["rejected-strong"] ?? "") ?? "";
    ctx.fill(shape);
  });
  within(ctx, split, bbox.left + bbox.width, bbox, () => {
    ctx.fillStyle = ink["kept-strong"] ?? "";
    ctx.fill(shape);
  });
}

/** @param {UPlot} plot @param {readonly number[]} heights */
function barShape(plot, heights) {
  const shape = new Path2D();
  const floor = plot.valToPos(0, "y", true);
  const gap = plot.bbox.width / heights.length > 5 * devicePixelRatio ? devicePixelRatio : 0;
  for (const [bin, height] of heights.entries()) {
    if (height <= 0) continue;
    const left = plot.valToPos((100 * bin) / heights.length, "x", true);
    const right = plot.valToPos((100 * (bin + 1)) / heights.length, "x", true);
    const top = plot.valToPos(height, "y", true);
    shape.rect(left, top, right - left - gap, floor - top);
  }
  return shape;
}

/**
 * Paint the range between the active threshold and the one that is tried.
 * @param {UPlot} plot @param {Ink} ink @param {number} from @param {number} to
 */
function paintChange({ ctx, bbox }, ink, from, to) {
  ctx.save();
  ctx.globalAlpha = 0.12;
  ctx.fillStyle = ink.accent ?? "";
  ctx.fillRect(Math.min(from, to), bbox.top, Math.abs(to - from), bbox.height);
  ctx.globalAlpha = 1;
  ctx.strokeStyle = ink["text-faint"] ?? "";
  ctx.lineWidth = devicePixelRatio;
  ctx.setLineDash([3 * devicePixelRatio, 3 * devicePixelRatio]);
  ctx.beginPath();
  ctx.moveTo(from, bbox.top);
  ctx.lineTo(from, bbox.top + bbox.height);
  ctx.stroke();
  ctx.restore();
}

/**
 * @param {CanvasRenderingContext2D} ctx @param {number} left @param {number} right @param {UPlot["bbox"]} bbox
 * @param {() => void} paint
 */
function within(ctx, left, right, bbox, paint) {
  ctx.save();
  ctx.beginPath();
  ctx.rect(left, bbox.top, Math.max(0, right - left), bbox.height);
  ctx.clip();
  paint();
  ctx.restore();
}

/** One tile per colour and density. @type {Map<string, OffscreenCanvas>} */
const tiles = new Map();

/**
 * Slanted lines: the sign of a rejected box that needs no colour.
 * @param {CanvasRenderingContext2D} ctx @param {string} color
 */
function hatch(ctx, color) {
  const name = `${color} ${devicePixelRatio}`;
  const tile = tiles.get(name) ?? hatchTile(color);
  tiles.set(name, tile);
  return ctx.createPattern(tile, "repeat");
}

/** @param {string} color */
function hatchTile(color) {
  const size = Math.round(HATCH_PX * devicePixelRatio);
  const tile = new OffscreenCanvas(size, size);
  const pen = tile.getContext("2d");
  if (!pen) return tile;
  pen.strokeStyle = color;
  pen.lineWidth = 1.3 * devicePixelRatio;
  pen.beginPath();
  for (const offset of [-size, 0, size]) {
    pen.moveTo(offset, size);
    pen.lineTo(offset + size, 0);
  }
  pen.stroke();
  return tile;
}
