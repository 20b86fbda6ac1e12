// @ts-check
// A frame on the stage with its boxes, as a component; the bar over it, and the actions of both.

import { isWithheld } from "../boxes/box.js";
import { useLazy, useRetries, useValue } from "../core/hooks.js";
import { html, useLayoutEffect, useMemo, useRef, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { Toggle } from "../core/keymap.js";
import { FailureLine, Notice } from "../core/parts.js";
import { onThemeChange } from "../core/prefs.js";
import { clamp } from "./geometry.js";
import { highlightOf } from "./pixels.js";
import { createStage } from "./stage.js";

/** @import { Decision } from "../boxes/box.js" */
/** @import { Actions, App } from "../core/app.js" */
/** @import { Frame, Media } from "./media.js" */
/** @import { Stage } from "./stage.js" */

/**
 * The boxes are shown as soon as the frame is known; the picture and the segmentation follow.
 * @param {{app: App, frame: Frame | null, media: Media, boxes: readonly Decision[], selected:
 *   Decision | null, isCrop: boolean, hider?: Decision | null, scene?: number, label: string, onSelect?: (boxId: number
 *   | null) => void, onSwipe?: (side: "left" | "right") => void, onCrop: (isOnBox: boolean) => void, stageRef:
 *   {current: Stage | null}, children?: unknown}} props `frame`: null until it is loaded;
 *   `isCrop`, `hider`, `scene`: `crop`, `hider`, `scene` of a Snapshot (stage.js); `onCrop`: a double click; `onSwipe`:
 *   a finger has moved the picture far enough; without it, a finger pans
 */
export function StageView({
  app,
  frame,
  media,
  boxes,
  selected,
  isCrop,
  hider = null,
  scene,
  label,
  onSelect,
  onSwipe,
  onCrop,
  stageRef,
  children,
}) {
  const host = useRef(/** @type {HTMLDivElement | null} */ (null));
  const prefs = useValue(app.prefs);
  const isBare = useValue(app.isBare);
  const {
    value: picture = null,
    error: noPicture,
    retry: retryPicture,
  } = useLazy(frame?.has_image ? media.picture : null);
  const { value: mask = null, error: noMask, retry: retryMask } = useLazy(frame && prefs.mask ? media.mask : null);
  const isHighlighted = prefs.lit && selected !== null && !isWithheld(selected);
  const {
    value: pixels,
    error: noPixels,
    retry: retryPixels,
  } = useLazy(frame && isHighlighted ? media.segmentation : null);
  const highlight = useMemo(
    () => (isHighlighted && pixels?.form ? highlightOf(pixels.canvas, pixels.form, selected) : null),
    [isHighlighted, selected?.box_id, selected?.accepted_tags, pixels],
  );
  // After the picture, which is needed first.
  const { value: objects = null } = useLazy(onSelect && frame && picture ? media.objects : null);
  const hasNoPicture = frame !== null && !frame.has_image;
  const noSegmentation = noMask ?? noPixels;
  useRetries(noPicture, retryPicture, media);

  const [swiped, setSwiped] = useState(0);
  const swipe = useRef(onSwipe);
  swipe.current = onSwipe;
  /** @param {number} dx @param {boolean} isEnd */
  const moved = (dx, isEnd) => {
    setSwiped(isEnd ? 0 : dx);
    if (isEnd && Math.abs(dx) >= SWIPE_PX) swipe.current?.(dx < 0 ? "left" : "right");
  };

  useLayoutEffect(() => {
    const stage = createStage(/** @type {HTMLElement} */ (host.current), {
      onSelect: onSelect ?? (() => {}),
      onCrop,
      onSwipe: onSwipe ? moved : null,
      onZoom: app.zoom.set,
    });
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
    const image = imageSize(frame, picture);
    const isWhole = picture !== null || hasNoPicture;
    const look = { mask, opacity, highlight, edges, crop: isCrop, hider, isBare, objects, hasFar: prefs.far };
    stageRef.current?.update({ image, picture, boxes, selected, isWhole, scene, ...look });
  }, [
    frame,
    picture,
    mask,
    prefs.opacity,
    boxes,
    selected,
    highlight,
    prefs.edges,
    isCrop,
    hider,
    isBare,
    objects,
    prefs.far,
  ]);

  return html`<div class="stage-wrap">
    <div class="stage" ref=${host} style=${{ transform: swiped ? `translateX(${swiped}px)` : "" }} role="img"
      aria-label=${label} data-box=${selected?.box_id ?? ""} data-mode=${isCrop ? "crop" : "frame"}
      data-picture=${picture ? "shown" : hasNoPicture ? "none" : noPicture ? "failed" : "loading"}
      data-mask=${mask ? "on" : "off"} data-highlighted=${highlight?.count ?? ""} data-hider=${hider?.box_id ?? ""}
      data-bare=${isBare || undefined} data-objects=${objects ? "shown" : undefined}></div>
    ${
      hasNoPicture &&
      html`<div class="stage__note">
        <${Notice} title="This frame has no image"><p>Its boxes and numbers are here all the same.</p><//></div>`
    }
    ${!picture && !hasNoPicture && !noPicture && html`<div class="stage__loading shimmer" aria-hidden="true"></div>`}
    <div class="stage__failures">
      ${noPicture && html`<${FailureLine} what="Image" error=${noPicture} onRetry=${retryPicture} />`}
      ${
        noSegmentation &&
        html`<${FailureLine} what="Segmentation" error=${noSegmentation}
          onRetry=${() => (retryMask(), retryPixels())} />`
      }
    </div>
    ${swiped !== 0 && html`<${Swipe} dx=${swiped} />`}
    ${children}
  </div>`;
}

/** So far a finger moves the picture to answer. */
const SWIPE_PX = 96;

/** What a swipe will answer if the finger is lifted. @param {{dx: number}} props */
function Swipe({ dx }) {
  const verdict = dx < 0 ? "reject" : "keep";
  return html`<div class="swipe swipe--${verdict} ${Math.abs(dx) >= SWIPE_PX ? "is-far" : ""}" aria-hidden="true">
    <${Icon} name=${dx < 0 ? "cross" : "check"} />${dx < 0 ? "Reject" : "Keep"}
  </div>`;
}

/** @param {Frame} frame @param {HTMLImageElement | null} picture */
function imageSize(frame, picture) {
  return { width: frame.width ?? picture?.naturalWidth ?? 1280, height: frame.height ?? picture?.naturalHeight ?? 720 };
}

const OPACITY_STEP = 0.1;
const ZOOM_STEP = 1.4;

/** @param {App} app @param {() => Stage | null} stage */
export function createLookActions(app, stage) {
  /** @param {number} change */
  function fade(change) {
    const { mask, opacity } = app.prefs.get();
    app.prefs.change({ mask: true, opacity: mask ? clamp(Math.round((opacity + change) * 10) / 10, 0.1, 1) : opacity });
  }

  /** The picture alone, until the key or the button is released. */
  function bare() {
    app.isBare.set(true);
    const stop = new AbortController();
    const end = () => {
      stop.abort();
      app.isBare.set(false);
    };
    for (const type of ["keyup", "pointerup", "blur"]) addEventListener(type, end, { signal: stop.signal });
  }

  return {
    bare,
    mask: () => app.prefs.change({ mask: !app.prefs.get().mask }),
    opacityDown: () => fade(-OPACITY_STEP),
    opacityUp: () => fade(OPACITY_STEP),
    lit: () => app.prefs.change({ lit: !app.prefs.get().lit }),
    far: () => app.prefs.change({ far: !app.prefs.get().far }),
    panels: () => app.prefs.change({ panels: !app.prefs.get().panels }),
    /** With the panels, the picture would be hardly larger. */
    fullScreen() {
      if (document.fullscreenElement) return void document.exitFullscreen();
      document.documentElement.requestFullscreen().catch(app.toasts.fail);
      return app.prefs.change({ panels: false });
    },
    edges: () => app.prefs.change({ edges: !app.prefs.get().edges }),
    zoomIn: () => stage()?.zoomBy(ZOOM_STEP),
    zoomOut: () => stage()?.zoomBy(1 / ZOOM_STEP),
  };
}

/**
 * Toggles of the view, then the close-up and the zoom, which every view has.
 * @param {{app: App, actions: Actions, isCrop: boolean, isFit?: boolean, hasZoomText?: boolean, children?: unknown}}
 *   props `isFit`: whether the whole frame is shown, where that is a state; `children`: the toggles
 */
export function LookBar({ app, actions, isCrop, isFit, hasZoomText = false, children }) {
  const { panels } = useValue(app.prefs);
  return html`<div class="bar bar--look" role="toolbar" aria-label="View">
    ${children}
    <${Toggle} app=${app} action="bare" icon="image" isHeld=${true} run=${actions.bare} />
    <${Toggle} app=${app} action="crop" icon="crop" isOn=${isCrop} run=${actions.crop} />
    <${Toggle} app=${app} action="fit" icon="fit" isOn=${isFit} run=${actions.fit} />
    <span class="bar__pinch"><${Toggle} app=${app} action="zoomOut" icon="minus" run=${actions.zoomOut} />
      ${hasZoomText && html`<${ZoomText} app=${app} />`}
      <${Toggle} app=${app} action="zoomIn" icon="plus" run=${actions.zoomIn} /></span>
    <span class="bar__wide"><${Toggle} app=${app} action="panels" icon="panels" isOn=${!panels} run=${actions.panels} />
      <${Toggle} app=${app} action="fullScreen" icon="screen" run=${actions.fullScreen} /></span>
  </div>`;
}

/** @param {{app: App}} props */
function ZoomText({ app }) {
  return html`<output class="zoom num" aria-label="Zoom">${Math.round(useValue(app.zoom) * 100)}%</output>`;
}
