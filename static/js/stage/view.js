// @ts-check
// A frame on the stage with its boxes, as a component; the bar over it, and the actions of both.

import { isWithheld } from "../boxes/box.js";
import { useLazy, useValue } from "../core/hooks.js";
import { html, useLayoutEffect, useMemo, useRef } from "../core/html.js";
import { Toggle } from "../core/keymap.js";
import { FailureLine, Notice } from "../core/parts.js";
import { onThemeChange } from "../core/prefs.js";
import { clamp } from "./geometry.js";
import { highlightOf } from "./pixels.js";
import { createStage } from "./stage.js";

/** @typedef {import("../core/app.js").Actions} Actions */
/** @typedef {import("../core/app.js").App} App */
/** @typedef {import("../boxes/box.js").Decision} Decision */
/** @typedef {import("./media.js").Frame} Frame */

/**
 * The boxes are shown as soon as the frame is known; the picture and the segmentation follow.
 * @param {{app: App, frame: Frame | null, media: import("./media.js").Media, boxes: readonly Decision[], selected: Decision | null, isCrop: boolean,
 *   isDim?: boolean, scene?: number, label: string, onSelect?: (boxId: number | null) => void, onCrop: (isOnBox: boolean) => void,
 *   stageRef: {current: import("./stage.js").Stage | null}, children?: unknown}} props
 *   `frame`: null until it is loaded; `isCrop`, `isDim`, `scene`: `crop`, `dim`, `scene` of a Snapshot (stage.js); `onCrop`: a double click
 */
export function StageView({ app, frame, media, boxes, selected, isCrop, isDim = false, scene, label, onSelect = () => {}, onCrop, stageRef, children }) {
  const host = useRef(/** @type {HTMLDivElement | null} */ (null));
  const prefs = useValue(app.prefs);
  const { value: picture = null, error: noPicture, retry: retryPicture } = useLazy(frame?.has_image ? media.picture : null);
  const { value: mask = null, error: noMask, retry: retryMask } = useLazy(frame && prefs.mask ? media.mask : null);
  const isHighlighted = prefs.lit && selected !== null && !isWithheld(selected);
  const { value: pixels, error: noPixels, retry: retryPixels } = useLazy(frame && isHighlighted ? media.segmentation : null);
  const highlight = useMemo(
    () => (isHighlighted && pixels?.form ? highlightOf(pixels.canvas, pixels.form, selected) : null),
    [isHighlighted, selected?.box_id, selected?.accepted_tags, pixels],
  );
  const hasNoPicture = frame !== null && !frame.has_image;
  const noSegmentation = noMask ?? noPixels;

  useLayoutEffect(() => {
    const stage = createStage(/** @type {HTMLElement} */ (host.current), { onSelect, onCrop, onZoom: app.zoom.set });
    stageRef.current = stage;
    const stop = onThemeChange(app.prefs, () => requestAnimationFrame(stage.restyle));
    return () => {
      stop();
      stageRef.current = null;
      stage.destroy();
    };
  }, []);
  useLayoutEffect(() => {
    if (!frame) return;
    const { opacity, edges } = prefs;
    stageRef.current?.update({ image: imageSize(frame, picture), picture, mask, opacity, boxes, selected, highlight, edges, crop: isCrop, dim: isDim, scene });
  }, [frame, picture, mask, prefs.opacity, boxes, selected, highlight, prefs.edges, isCrop, isDim]);

  return html`<div class="stage-wrap">
    <div class="stage" ref=${host} role="img" aria-label=${label} data-box=${selected?.box_id ?? ""} data-mode=${isCrop ? "crop" : "frame"}
      data-picture=${picture ? "shown" : hasNoPicture || noPicture ? "failed" : "loading"} data-mask=${mask ? "on" : "off"} data-highlighted=${highlight?.count ?? ""}></div>
    ${hasNoPicture && html`<div class="stage__note"><${Notice} title="This frame has no image"><p>Its boxes and numbers are here all the same.</p><//></div>`}
    ${!picture && !hasNoPicture && !noPicture && html`<div class="stage__loading shimmer" aria-hidden="true"></div>`}
    <div class="stage__failures">
      ${noPicture && html`<${FailureLine} what="Image" error=${noPicture} onRetry=${retryPicture} />`}
      ${noSegmentation && html`<${FailureLine} what="Segmentation" error=${noSegmentation} onRetry=${() => (retryMask(), retryPixels())} />`}
    </div>
    ${children}
  </div>`;
}

/** @param {Frame} frame @param {HTMLImageElement | null} picture */
function imageSize(frame, picture) {
  return { width: frame.width ?? picture?.naturalWidth ?? 1280, height: frame.height ?? picture?.naturalHeight ?? 720 };
}

const OPACITY_STEP = 0.1;
const ZOOM_STEP = 1.4;

/** @param {App} app @param {() => import("./stage.js").Stage | null} stage */
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

/**
 * Toggles of the view, then the close-up and the zoom, which every view has.
 * @param {{app: App, actions: Actions, isCrop: boolean, isFit?: boolean, hasZoomText?: boolean, children?: unknown}} props
 *   `isFit`: whether the whole frame is shown, where that is a state; `children`: the toggles
 */
export function LookBar({ app, actions, isCrop, isFit, hasZoomText = false, children }) {
  return html`<div class="bar bar--look" role="toolbar" aria-label="View">
    ${children}
    <${Toggle} app=${app} action="crop" icon="crop" isOn=${isCrop} run=${actions.crop} />
    <${Toggle} app=${app} action="fit" icon="fit" isOn=${isFit} run=${actions.fit} />
    <${Toggle} app=${app} action="zoomOut" icon="minus" run=${actions.zoomOut} />
    ${hasZoomText && html`<${ZoomText} app=${app} />`}
    <${Toggle} app=${app} action="zoomIn" icon="plus" run=${actions.zoomIn} />
  </div>`;
}

/** @param {{app: App}} props */
function ZoomText({ app }) {
  return html`<output class="zoom num" aria-label="Zoom">${Math.round(useValue(app.zoom) * 100)}%</output>`;
}
