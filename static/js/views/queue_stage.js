// @ts-check
// The stage of the queue: cut to the next box at once, everything but the box dimmed.

import { html, useEffect, useLayoutEffect, useMemo, useRef, useState } from "../html.js";
import { litPixels } from "../stage/pixels.js";
import { createStage } from "../stage/stage.js";
import { onThemeChange } from "../theme.js";
import { spokenText } from "../wording.js";
import { useValue } from "./hooks.js";
import { Failure, Notice } from "./parts.js";
import { QueueLook } from "./queue_look.js";

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../types.js").Decision} Decision */
/** @typedef {import("../queue/media.js").Media} Media */

/**
 * @param {{app: App, box: Decision, media: import("../queue/media.js").MediaCache, view: import("../store.js").Value<"crop" | "frame">, isBlind: boolean,
 *   actions: import("../app.js").Actions, stageRef: {current: import("../stage/stage.js").Stage | null}}} props
 */
export function QueueStage({ app, box, media, view, isBlind, actions, stageRef }) {
  const host = useRef(/** @type {HTMLDivElement | null} */ (null));
  const prefs = useValue(app.prefs);
  const mode = useValue(view);
  const wantsPixels = prefs.mask || (prefs.lit && !isBlind);
  const { found, error, retry } = useMedia(media, box.frame_id, wantsPixels);
  const mask = useMask(media, prefs.mask ? found : null);
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

/** Where in its frame the box is. @param {{frame: import("../types.js").Frame, picture: HTMLImageElement | null, box: Decision, mode: string, onClick: (() => void) | undefined}} props */
function Minimap({ frame, picture, box, mode, onClick }) {
  const { width, height } = frame;
  if (!width || !height || !box.xyxy || !picture || mode === "frame") return null;
  const [x0, y0, x1, y1] = box.xyxy;
  const place = { left: `${(100 * x0) / width}%`, top: `${(100 * y0) / height}%`, width: `${(100 * (x1 - x0)) / width}%`, height: `${(100 * (y1 - y0)) / height}%` };
  return html`<button class="minimap" title="The whole frame (C)" aria-label="Show the whole frame" onClick=${onClick} style=${{ aspectRatio: `${width} / ${height}` }}>
    <${SmallPicture} picture=${picture} /><span class="minimap__box" style=${place} />
  </button>`;
}

/** The picture once more, drawn: its address has ended. @param {{picture: HTMLImageElement}} props */
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

/** @param {import("../queue/media.js").MediaCache} media @param {number} frameId @param {boolean} wantsPixels */
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

/** @param {import("../queue/media.js").MediaCache} media @param {Media | null} found  null: no mask is wanted */
function useMask(media, found) {
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

/** From an answer to the next box on the screen, for whoever measures. @param {number} boxId @param {boolean} isHere */
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
