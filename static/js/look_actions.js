// @ts-check
// How a picture is looked at, by the keymap's names: what every view with a stage can do.

import { clamp } from "./geometry.js";

const OPACITY_STEP = 0.1;
const ZOOM_STEP = 1.4;

/** @param {import("./app.js").App} app @param {() => import("./stage/stage.js").Stage | null} stage */
export function createLookActions(app, stage) {
  /** @param {number} change */
  function fade(change) {
    const { mask, opacity } = app.prefs.get();
    app.prefs.change({ mask: true, opacity: mask ? clamp(Math.round((opacity + change) * 10) / 10, 0.1, 1) : opacity });
  }

  return {
    mask: () => app.prefs.change({ mask: !app.prefs.get().mask }),
    opacityDown: () => fade(-OPACITY_STEP),
    opacityUp: () => fade(OPACITY_STEP),
    lit: () => app.prefs.change({ lit: !app.prefs.get().lit }),
    edges: () => app.prefs.change({ edges: !app.prefs.get().edges }),
    zoomIn: () => stage()?.zoomBy(ZOOM_STEP),
    zoomOut: () => stage()?.zoomBy(1 / ZOOM_STEP),
  };
}
