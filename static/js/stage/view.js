// @ts-check
// The stage as a component, for the frame (StageView) and for the queue (QueueStage), with the bars and actions of viewing.

import { isVeiled } from "../boxes/box.js";
import { spokenText } from "../boxes/wording.js";
import { blob } from "../core/api.js";
import { useValue } from "../core/hooks.js";
import { html, useEffect, useLayoutEffect, useMemo, useRef, useState } from "../core/html.js";
import { Toggle } from "../core/keymap.js";
import { countOf } from "../core/numbers.js";
import { Failure, Notice } from "../core/parts.js";
import { fileUrl, imageAt, paintedUrl } from "../core/pictures.js";
import { onThemeChange } from "../core/prefs.js";
import { clamp } from "./geometry.js";
import { canvasOf, isPaintedAlready, litPixels } from "./pixels.js";
import { createStage } from "./stage.js";

/** @typedef {import("../core/app.js").Actions} Actions */
/** @typedef {import("../core/app.js").App} App */
/** @typedef {import("../boxes/box.js").Decision} Decision */
/** @typedef {import("../core/openapi.js").Frame} Frame */
/** @typedef {import("./media.js").Media} Media */

/**
 * @param {{app: App, frame: Frame, shown: readonly Decision[], selected: Decision | null,
 *   onSelect: (boxId: number | null) => void, stageRef: {current: import("./stage.js").Stage | null}}} props
 */
export function StageView({ app, frame, shown, selected, onSelect, stageRef }) {
  const host = useRef(/** @type {HTMLDivElement | null} */ (null));
  const prefs = useValue(app.prefs);
  const picture = usePicture(frame.has_image ? fileUrl(frame, "image") : null);
  const wantsPixels = frame.has_segmentation && (prefs.mask || (prefs.lit && selected !== null && !isVeiled(selected)));
  const segmentation = useSegmentation(app, frame, wantsPixels);
  const mask = useMask(app, frame, prefs.mask, segmentation.canvas);
  const lit = useMemo(
    () => (prefs.lit && selected && segmentation.canvas && frame.segmentation ? litPixels(segmentation.canvas, frame.segmentation, selected) : null),
    [prefs.lit, selected?.box_id, selected?.accepted_tags, segmentation.canvas],
  );
  const image = imageSize(frame, picture.image);

  useLayoutEffect(() => {
    const stage = createStage(/** @type {HTMLElement} */ (host.current), {
      onSelect,
      onZoom: app.zoom.set,
      onCrop: (crop) => app.prefs.change({ crop }),
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
    const boxes = selected && !shown.includes(selected) ? [...shown, selected] : shown;
    stageRef.current?.update({ image, picture: picture.image, mask, opacity: prefs.opacity, boxes, selected, lit, edges: prefs.edges, crop: prefs.crop });
  }, [picture.image, mask, prefs.opacity, shown, selected, lit, prefs.edges, prefs.crop]);

  const words = `${countOf(shown.length, "box", "boxes")} shown${selected ? `; selected: ${spokenText(selected)}` : ""}`;
  return html`<div class="stage-wrap">
    <div class="stage" ref=${host} role="img" aria-label=${`Frame ${frame.key}: ${words}`} data-lit=${lit?.count ?? ""} data-mask=${mask ? "on" : "off"} data-picture=${picture.state}></div>
    ${picture.state === "failed" && html`<div class="stage__note"><${Notice} title="The image cannot be shown"><p>Its boxes and numbers are still here.</p><//></div>`}
    ${picture.state === "loading" && html`<div class="stage__loading shimmer" aria-hidden="true"></div>`}
    ${segmentation.error && html`<p class="stage__error" role="alert">Segmentation: ${segmentation.error}</p>`}
  </div>`;
}

/** @param {Frame} frame @param {HTMLImageElement | null} picture */
function imageSize(frame, picture) {
  return { width: frame.width ?? picture?.naturalWidth ?? 1280, height: frame.height ?? picture?.naturalHeight ?? 720 };
}

/** @param {string | null} url */
function usePicture(url) {
  const [found, setFound] = useState(/** @type {{image: HTMLImageElement | null, state: "loading" | "shown" | "failed"}} */ ({ image: null, state: url ? "loading" : "failed" }));
  useEffect(() => {
    const stop = new AbortController();
    if (url) {
      imageAt(url, stop.signal).then(
        (image) => !stop.signal.aborted && setFound({ image, state: "shown" }),
        () => !stop.signal.aborted && setFound({ image: null, state: "failed" }),
      );
    }
    return () => stop.abort();
  }, [url]);
  return found;
}

/** The segmentation's stored pixels, loaded when they are first needed. @param {App} app @param {Frame} frame @param {boolean} isWanted */
function useSegmentation(app, frame, isWanted) {
  const [found, setFound] = useState(/** @type {{canvas: HTMLCanvasElement | null, error: string}} */ ({ canvas: null, error: "" }));
  useEffect(() => {
    if (!isWanted || found.canvas) return;
    const stop = new AbortController();
    blob(fileUrl(frame, "segmentation"), stop.signal).then(canvasOf).then(
      (canvas) => !stop.signal.aborted && setFound({ canvas, error: "" }),
      (error) => !stop.signal.aborted && setFound({ canvas: null, error: error.message }),
    );
    return () => stop.abort();
  }, [isWanted]);
  return found;
}

/** @param {App} app @param {Frame} frame @param {boolean} isOn @param {HTMLCanvasElement | null} segmentation @returns {CanvasImageSource | null} */
function useMask(app, frame, isOn, segmentation) {
  const isPainted = frame.segmentation !== null && isPaintedAlready(frame.segmentation);
  const [painted, setPainted] = useState(/** @type {HTMLImageElement | null} */ (null));
  useEffect(() => {
    if (!isOn || isPainted || !frame.has_segmentation || painted) return;
    imageAt(paintedUrl(frame.id)).then(setPainted, () => app.toasts.show("The segmentation could not be painted.", { kind: "error" }));
  }, [isOn]);
  if (!isOn) return null;
  return isPainted ? segmentation : painted;
}

const OPACITY_STEP = 0.1;
const ZOOM_STEP = 1.4;

/** @param {import("../core/app.js").App} app @param {() => import("./stage.js").Stage | null} stage */
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

/** @param {{app: import("../core/app.js").App, frame: import("../core/openapi.js").Frame, mode: string, isBlind: boolean, actions: import("../core/app.js").Actions}} props */
export function QueueLook({ app, frame, mode, isBlind, actions }) {
  const { mask, lit } = useValue(app.prefs);
  return html`<div class="bar bar--look" role="toolbar" aria-label="View">
    ${frame.has_segmentation && html`<${Toggle} app=${app} action="mask" icon="layers" isOn=${mask} run=${actions.mask} />`}
    ${frame.has_segmentation && !isBlind && html`<${Toggle} app=${app} action="lit" icon="light" isOn=${lit} run=${actions.lit} />`}
    <${Toggle} app=${app} action="crop" icon="crop" isOn=${mode === "crop"} run=${actions.crop} />
    <${Toggle} app=${app} action="fit" icon="fit" isOn=${mode === "frame"} run=${actions.fit} />
    <${Toggle} app=${app} action="zoomOut" icon="minus" run=${actions.zoomOut} />
    <${Toggle} app=${app} action="zoomIn" icon="plus" run=${actions.zoomIn} />
  </div>`;
}

/**
 * @param {{app: App, box: Decision, media: import("./media.js").MediaCache, view: import("../core/observable.js").Value<"crop" | "frame">, isBlind: boolean,
 *   actions: import("../core/app.js").Actions, stageRef: {current: import("./stage.js").Stage | null}}} props
 */
export function QueueStage({ app, box, media, view, isBlind, actions, stageRef }) {
  const host = useRef(/** @type {HTMLDivElement | null} */ (null));
  const prefs = useValue(app.prefs);
  const mode = useValue(view);
  const wantsPixels = prefs.mask || (prefs.lit && !isBlind);
  const { found, error, retry } = useMedia(media, box.frame_id, wantsPixels);
  const mask = useMaskAhead(media, prefs.mask ? found : null);
  const segmentation = found?.segmentation ?? null;
  const form = found?.frame.segmentation ?? null;
  const lit = useMemo(
    () => (prefs.lit && !isBlind && segmentation && form ? litPixels(segmentation, form, box) : null),
    [prefs.lit, isBlind, box.box_id, segmentation],
  );

  useLayoutEffect(() => {
    const stage = createStage(/** @type {HTMLElement} */ (host.current), {
      onSelect: () => {},
      onZoom: app.zoom.set,
      onCrop: () => view.set(view.get() === "crop" ? "frame" : "crop"),
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
    if (!found) return;
    const { width, height } = found.frame;
    const image = { width: width ?? found.picture?.naturalWidth ?? 1280, height: height ?? found.picture?.naturalHeight ?? 720 };
    const others = isBlind ? [] : found.frame.boxes.filter(({ box_id }) => box_id !== box.box_id);
    const boxes = mode === "frame" ? [...others, box] : [box];
    const { opacity, edges } = prefs;
    stageRef.current?.update({ image, picture: found.picture, mask, opacity, boxes, selected: box, lit, edges, crop: mode === "crop" && box.xyxy !== null, dim: mode === "crop", scene: box.box_id });
  }, [found, mask, prefs.opacity, box, lit, prefs.edges, mode, isBlind]);
  useMeasure(box.box_id, found !== null);

  const words = isBlind ? `${box.class} ${box.id}` : spokenText(box);
  const state = found ? (found.picture ? "shown" : "failed") : "loading";
  return html`<div class="stage-wrap">
    <div class="stage" ref=${host} role="img" aria-label=${`Box: ${words}`} data-box=${box.box_id} data-picture=${state} data-mode=${mode} data-lit=${lit?.count ?? ""}></div>
    ${error && html`<div class="stage__note queue__note"><${Failure} error=${error} onRetry=${retry} /></div>`}
    ${found && !found.picture && html`<div class="stage__note"><${Notice} title="There is no image to show"><p>The box and its numbers are still here.</p><//></div>`}
    ${!found && !error && html`<div class="stage__loading shimmer" aria-hidden="true"></div>`}
    ${found && html`<${Minimap} frame=${found.frame} picture=${found.picture} box=${box} mode=${mode} onClick=${actions.crop} />`}
    ${found && html`<${QueueLook} app=${app} frame=${found.frame} mode=${mode} isBlind=${isBlind} actions=${actions} />`}
  </div>`;
}

/** Twice what it is wide on the page, for sharp screens. */
const MINIMAP_PX = 336;

/** A small picture of the frame that shows where the box is. @param {{frame: import("../core/openapi.js").Frame, picture: HTMLImageElement | null, box: Decision, mode: string, onClick: (() => void) | undefined}} props */
function Minimap({ frame, picture, box, mode, onClick }) {
  const { width, height } = frame;
  if (!width || !height || !box.xyxy || !picture || mode === "frame") return null;
  const [x0, y0, x1, y1] = box.xyxy;
  const place = { left: `${(100 * x0) / width}%`, top: `${(100 * y0) / height}%`, width: `${(100 * (x1 - x0)) / width}%`, height: `${(100 * (y1 - y0)) / height}%` };
  return html`<button class="minimap" title="The whole frame (C)" aria-label="Show the whole frame" onClick=${onClick} style=${{ aspectRatio: `${width} / ${height}` }}>
    <${SmallPicture} picture=${picture} /><span class="minimap__box" style=${place} />
  </button>`;
}

/** The picture, drawn smaller on a canvas: its blob address is no longer valid. @param {{picture: HTMLImageElement}} props */
function SmallPicture({ picture }) {
  const canvas = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  useLayoutEffect(() => {
    const context = canvas.current?.getContext("2d");
    if (!canvas.current || !context) return;
    canvas.current.width = MINIMAP_PX;
    canvas.current.height = Math.round((MINIMAP_PX * picture.naturalHeight) / picture.naturalWidth);
    context.imageSmoothingQuality = "high";
    context.drawImage(picture, 0, 0, canvas.current.width, canvas.current.height);
  }, [picture]);
  return html`<canvas ref=${canvas} aria-hidden="true" />`;
}

/** @param {import("./media.js").MediaCache} media @param {number} frameId @param {boolean} wantsPixels */
function useMedia(media, frameId, wantsPixels) {
  const [late, setLate] = useState(/** @type {{frameId: number, found: Media | null, error: Error | null} | null} */ (null));
  const [attempt, setAttempt] = useState(0);
  useEffect(() => {
    let isCurrent = true;
    const coming = wantsPixels ? media.want(frameId).then((found) => (isCurrent && setLate({ frameId, found, error: null }), media.wantAll(frameId))) : media.want(frameId);
    coming.then(
      (found) => isCurrent && setLate({ frameId, found, error: null }),
      (error) => isCurrent && setLate({ frameId, found: null, error }),
    );
    return () => void (isCurrent = false);
  }, [frameId, wantsPixels, attempt]);
  const found = (late?.frameId === frameId ? late.found : null) ?? media.ready(frameId);
  const error = late?.frameId === frameId && !found ? late.error : null;
  return { found, error, retry: () => setAttempt((n) => n + 1) };
}

/** @param {import("./media.js").MediaCache} media @param {Media | null} found  null: no mask is wanted */
function useMaskAhead(media, found) {
  const [painted, setPainted] = useState(/** @type {{frameId: number, mask: CanvasImageSource | null} | null} */ (null));
  useEffect(() => {
    if (!found) return;
    let isCurrent = true;
    media.mask(found).then(
      (mask) => isCurrent && setPainted({ frameId: found.frame.id, mask }),
      () => {},
    );
    return () => void (isCurrent = false);
  }, [found]);
  return found && painted?.frameId === found.frame.id ? painted.mask : null;
}

/** Measure the time from an answer until the next box is on the screen (performance entry "queue:next"). @param {number} boxId @param {boolean} isHere */
function useMeasure(boxId, isHere) {
  useLayoutEffect(() => {
    if (!isHere || performance.getEntriesByName("queue:answer").length === 0) return;
    // After the stage has drawn, and after what it drew was given to the screen.
    requestAnimationFrame(() =>
      setTimeout(() => {
        if (performance.getEntriesByName("queue:answer").length === 0) return;
        performance.measure("queue:next", "queue:answer");
        performance.clearMarks("queue:answer");
      }),
    );
  }, [boxId, isHere]);
}

/** @param {{app: App, frame: import("../core/openapi.js").Frame, actions: Actions}} props */
export function LookBar({ app, frame, actions }) {
  const { mask, opacity, lit, edges, blind, crop } = useValue(app.prefs);
  const hasEdges = frame.boxes.some((box) => box.edges?.length);
  /** @param {{currentTarget: HTMLInputElement}} event */
  const setOpacity = ({ currentTarget }) => app.prefs.change({ opacity: Number(currentTarget.value), mask: true });
  return html`<div class="bar bar--look" role="toolbar" aria-label="View">
    ${frame.has_segmentation &&
    html`<${Toggle} app=${app} action="mask" icon="layers" isOn=${mask} run=${actions.mask} />
      <input class="slider" type="range" min="0.1" max="1" step="0.05" value=${opacity} aria-label="Segmentation opacity" onInput=${setOpacity} />
      <${Toggle} app=${app} action="lit" icon="light" isOn=${lit} run=${actions.lit} />`}
    ${hasEdges && html`<${Toggle} app=${app} action="edges" icon="cube" isOn=${edges} run=${actions.edges} />`}
    <${Toggle} app=${app} action="blind" icon="blind" isOn=${blind} run=${actions.blind} />
    <span class="bar__rule" aria-hidden="true"></span>
    <${Toggle} app=${app} action="crop" icon="crop" isOn=${crop} run=${actions.crop} />
    <${Toggle} app=${app} action="fit" icon="fit" run=${actions.fit} />
    <${Toggle} app=${app} action="zoomOut" icon="minus" run=${actions.zoomOut} />
    <${ZoomText} app=${app} />
    <${Toggle} app=${app} action="zoomIn" icon="plus" run=${actions.zoomIn} />
  </div>`;
}

/** @param {{app: App}} props */
function ZoomText({ app }) {
  return html`<output class="zoom num" aria-label="Zoom">${Math.round(useValue(app.zoom) * 100)}%</output>`;
}
