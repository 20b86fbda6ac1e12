// @ts-check
// The stage of the queue: the current box close up or in its frame, with a small map of the frame and a measure of its
// speed.

import { isWithheld } from "../boxes/box.js";
import { useBoxes } from "../boxes/store.js";
import { spokenText } from "../boxes/wording.js";
import { useLazy, useRetries, useValue } from "../core/hooks.js";
import { html, useLayoutEffect, useMemo, useRef } from "../core/html.js";
import { Toggle, useKeyText, withKey } from "../core/keymap.js";
import { Failure } from "../core/parts.js";
import { hiderOf } from "../stage/geometry.js";
import { LookBar, StageView } from "../stage/view.js";
import { Coach } from "./coach.js";
import { Layers, Question, layersOf } from "./question.js";

/** @import { Decision } from "../boxes/box.js" */
/** @import { Actions } from "../core/app.js" */
/** @import { Value } from "../core/observable.js" */
/** @import { ReviewApp as App } from "../review/answers.js" */
/** @import { Frame, Media } from "../stage/media.js" */
/** @import { Lesson } from "./coach.js" */

/** @type {readonly number[]} */
const NONE = [];

/**
 * @param {{app: App, box: Decision, see: (box: Decision) => Decision, media: Media, view: Value<"crop" | "frame">,
 *   actions: Actions, stageRef: {current: import("../stage/stage.js").Stage | null}, rule: string, offset: number,
 *   lesson: Lesson | null, strip: unknown}} props `offset`: how many frames later than the asked one the box is;
 *   `lesson`: null if the box is of none; `strip`: shown below the question; `box`: withheld until it is answered in a
 *   blind review; then its frame's other boxes are not shown either; `see`: what may be shown of those
 */
export function QueueStage({ app, box, see, media, view, actions, stageRef, rule, offset, lesson, strip }) {
  const mode = useValue(view);
  const isBlind = isWithheld(box);
  const { value: frame = null, error, retry } = useLazy(media.frame);
  const { value: picture = null, error: noPicture } = useLazy(frame?.has_image ? media.picture : null);
  const inFrame = useBoxes(app.boxes, frame && mode === "frame" && !isBlind ? frame.boxIds : NONE);
  const boxes = useMemo(() => {
    // When the box or the view has just changed, the others are still those of before.
    const others =
      mode === "frame" && !isBlind
        ? inFrame.filter(({ box_id, frame_id }) => box_id !== box.box_id && frame_id === box.frame_id)
        : [];
    return [...others.map(see), box];
  }, [inFrame, mode, box, see]);
  // Neither the verdicts nor the places of other boxes are shown in a blind review.
  const hider = useMemo(
    () => (frame && !isBlind ? hiderOf(app.boxes.all(frame.boxIds), box) : null),
    [frame, isBlind, box],
  );
  useMeasure(box.box_id, frame !== null && (!frame.has_image || picture !== null || noPicture !== null));
  useRetries(error, retry, box.frame_id);
  if (error) return html`<div class="stage__note queue__note"><${Failure} error=${error} onRetry=${retry} /></div>`;
  const layers = mode === "crop" && box.xyxy ? layersOf(frame).length : 0;
  return html`${lesson && html`<${Coach} app=${app} lesson=${lesson} box=${box} hider=${hider} />`}
  <${Question} box=${box} frame=${frame} hider=${hider} rule=${rule} offset=${offset} />${strip}
  <div class="queue__picture" data-layers=${layers || undefined}>
    ${layers > 0 && frame && html`<${Layers} box=${box} frame=${frame} hider=${hider} />`}
    <${StageView} app=${app} frame=${frame} media=${media} boxes=${boxes} selected=${box} isCrop=${mode === "crop"}
      hider=${hider?.box} scene=${box.box_id} label=${`Box: ${isBlind ? `${box.class} ${box.id}` : spokenText(box)}`}
      onCrop=${() => view.set(view.get() === "crop" ? "frame" : "crop")} stageRef=${stageRef}
      onSwipe=${(/** @type {"left" | "right"} */ side) => (side === "left" ? actions.reject : actions.keep)?.()}>
      ${
        frame &&
        html`<${Minimap} app=${app} frame=${frame} picture=${picture} box=${box} mode=${mode}
          onClick=${actions.crop} />`
      }
      ${frame && html`<${QueueLook} app=${app} frame=${frame} mode=${mode} isBlind=${isBlind} actions=${actions} />`}
    <//></div>`;
}

/** @param {{app: App, frame: Frame, mode: string, isBlind: boolean, actions: Actions}} props */
function QueueLook({ app, frame, mode, isBlind, actions }) {
  const { mask, lit } = useValue(app.prefs);
  return html`<${LookBar} app=${app} actions=${actions} isCrop=${mode === "crop"} isFit=${mode === "frame"}>
    ${
      frame.has_segmentation &&
      html`<${Toggle} app=${app} action="mask" icon="layers" isOn=${mask} run=${actions.mask} />`
    }
    ${
      frame.has_segmentation &&
      !isBlind &&
      html`<${Toggle} app=${app} action="lit" icon="light" isOn=${lit} run=${actions.lit} />`
    }
  <//>`;
}

/** Twice what it is wide on the page, for sharp screens. */
const MINIMAP_PX = 336;

/**
 * A small picture of the frame that shows where the box is.
 * @param {{app: App, frame: Frame, picture: HTMLImageElement | null, box: Decision, mode: string, onClick: (() => void)
 *   | undefined}} props
 */
function Minimap({ app, frame, picture, box, mode, onClick }) {
  const { width, height } = frame;
  const key = useKeyText(app, "crop");
  if (!width || !height || !box.xyxy || !picture || mode === "frame") return null;
  const [x0, y0, x1, y1] = box.xyxy;
  const place = {
    left: `${(100 * x0) / width}%`,
    top: `${(100 * y0) / height}%`,
    width: `${(100 * (x1 - x0)) / width}%`,
    height: `${(100 * (y1 - y0)) / height}%`,
  };
  return html`<button class="minimap" title=${withKey("The whole frame", key)} aria-label="Show the whole frame"
    onClick=${onClick} style=${{ aspectRatio: `${width} / ${height}` }}>
    <${SmallPicture} picture=${picture} /><span class="minimap__box" style=${place} />
  </button>`;
}

/**
 * The picture, drawn smaller on a canvas: its blob address is no longer valid.
 * @param {{picture: HTMLImageElement}} props
 */
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

/**
 * Measure the time from an answer until the next box is on the screen (performance entry "queue:next").
 * @param {number} boxId @param {boolean} isHere
 */
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
