// @ts-check
// Draws charts. The chart library is loaded with this module; colours come from the style sheet.

import Plot from "../../vendor/uplot-1.6.32.module.js";
import { onThemeChange } from "./prefs.js";

/** @import { PrefsValue } from "./prefs.js" */

/** @typedef {Plot.Options} Options */
/** @typedef {Plot.AlignedData} Data */
/** @typedef {Record<string, string>} Ink  CSS colours by token name */

/** The longest delay of a redraw by `redrawSoon`. */
const SOON_MS = 150;

const TOKENS = `text text-soft text-faint line line-strong surface accent unsure unmeasured-strong
  kept kept-strong rejected rejected-strong`.split(/\s+/);

/**
 * Draw into an element until stopped: again when it gets another size or the theme changes.
 * @param {HTMLElement} element @param {PrefsValue} prefs
 * @param {(ink: Ink, font: string) => Omit<Options, "width" | "height">} describe @param {() => Data} data
 * @returns {{redraw: () => void, redrawSoon: () => void, update: () => void, stop: () => void}}
 */
export function drawChart(element, prefs, describe, data) {
  /** @type {Plot | null} */
  let plot = null;
  let isStopped = false;
  // Twenty charts may depend on one threshold: those out of sight are redrawn when they are scrolled into view.
  let isSeen = true;
  let isBehind = false;
  const redraw = () => {
    isBehind = !isSeen;
    if (isSeen) plot?.redraw(false);
  };
  let soon = 0;
  const later = globalThis.requestIdleCallback ?? ((run) => setTimeout(run, SOON_MS));
  const redrawSoon = () => {
    soon ||= later(
      () => {
        soon = 0;
        if (!isStopped) redraw();
      },
      { timeout: SOON_MS },
    );
  };
  const sight = new IntersectionObserver(([entry]) => {
    isSeen = entry?.isIntersecting ?? true;
    if (isSeen && isBehind) redraw();
  });
  sight.observe(element);
  const size = () => ({ width: Math.max(element.clientWidth, 40), height: Math.max(element.clientHeight, 40) });
  const build = () => {
    if (isStopped) return;
    plot?.destroy();
    // The computed colour of an element: the property itself may be of both themes.
    const probe = element.appendChild(document.createElement("i"));
    const style = getComputedStyle(probe);
    const inkOf = (/** @type {string} */ name) => {
      probe.style.color = `var(--${name})`;
      return style.color;
    };
    const ink = Object.fromEntries(TOKENS.map((name) => [name, inkOf(name)]));
    const font = `11px ${style.fontFamily}`;
    probe.remove();
    plot = new Plot({ ...describe(ink, font), ...size() }, data(), element);
    // A drawing: hidden from screen readers.
    plot.root.setAttribute("aria-hidden", "true");
    element.dataset.drawn = String(Number(element.dataset.drawn ?? 0) + 1);
  };
  const watcher = new ResizeObserver(() => plot?.setSize(size()));
  watcher.observe(element);
  // The attribute that switches the theme may be set by a later observer than this one.
  const stopTheme = onThemeChange(prefs, () => requestAnimationFrame(build));
  build();
  return {
    redraw,
    // When there is time: charts that follow another one must not slow it down.
    redrawSoon,
    update: () => plot?.setData(data()),
    stop() {
      isStopped = true;
      watcher.disconnect();
      sight.disconnect();
      stopTheme();
      plot?.destroy();
      plot = null;
    },
  };
}
