// @ts-check
// What the queue asks about a box: the sentence with its object, the rule, other layers of the same cut, and its
// depths.

import { isWithheld } from "../boxes/box.js";
import { useCrop } from "../boxes/crops.js";
import { distanceText } from "../boxes/wording.js";
import { get, url } from "../core/api.js";
import { useLoaded } from "../core/hooks.js";
import { html } from "../core/html.js";
import { metresText, wholePercentText } from "../core/numbers.js";
import { contextOf } from "../stage/geometry.js";

/** @import { Decision, Xyxy } from "../boxes/box.js" */
/** @import { DepthSlice } from "../core/openapi.js" */
/** @import { Frame } from "../stage/media.js" */
/** @typedef {ReturnType<typeof import("../stage/geometry.js").hiderOf>} Hider */

/** The rule of a dataset that has none of its own. */
const USUAL_RULE = "Keep the box if you see any pixel of the object itself. What hides it does not count.";

/** @param {Decision} box */
const nameOf = ({ class: name, id }) => `${name.replaceAll("_", " ")} ${id}`;

/** From this share of a box on, what covers it is said, unless another box does. */
const MOSTLY_PERCENT = 50;

/** What is asked about: "12 × 6 px, 177 m away, inside car 214 at 30 m". @param {Decision} box @param {Hider} hider */
export function objectText(box, hider) {
  const { xyxy, hidden_by: [most] = [] } = box;
  const away = distanceText(box);
  const at = hider && distanceText(hider.box);
  return [
    xyxy && `${Math.round(xyxy[2] - xyxy[0])} × ${Math.round(xyxy[3] - xyxy[1])} px`,
    away && `${away} away`,
    hider && `${hider.where} ${nameOf(hider.box)}${at ? ` at ${at}` : ""}`,
    !hider && most && most.percent >= MOSTLY_PERCENT && `${wholePercentText(most.percent)} of it ${most.name}`,
  ]
    .filter(Boolean)
    .join(", ");
}

/**
 * @param {{box: Decision, frame: Frame | null, hider: Hider, rule: string, offset: number}} props `offset`: how many
 *   frames later than the asked one it is
 */
export function Question({ box, frame, hider, rule, offset }) {
  return html`<div class="question">
    <p class="question__ask">
      <b>
        ${
          offset === 0
            ? `Can you see any of this ${box.class.replaceAll("_", " ")}?`
            : `${Math.abs(offset)} frame${Math.abs(offset) === 1 ? "" : "s"} ${offset < 0 ? "earlier" : "later"}:`
        }</b> <span class="num">${objectText(box, hider)}</span></p>
    <p class="question__rule"><span class="faint">Rule</span> ${rule || USUAL_RULE}</p>
    <p class="swipehint" aria-hidden="true"><span>← swipe to reject</span><span>swipe to keep →</span></p>
    ${
      frame?.files?.depth &&
      box.xyxy &&
      !isWithheld(box) &&
      html`<${DepthStrip} key=${box.box_id} box=${box} hider=${hider} />`
    }
  </div>`;
}

/** @typedef {"segmentation" | "depth" | "instances"} Layer */

/** @type {readonly Layer[]} */
const LAYERS = ["segmentation", "depth", "instances"];

/** The layers that a frame has besides its picture. @param {Frame | null} frame */
export const layersOf = (frame) =>
  LAYERS.filter((layer) => frame?.files?.[layer] && (layer !== "segmentation" || frame.segmentation));

/** The same cut of the other layers, beside the picture. @param {{box: Decision, frame: Frame, hider: Hider}} props */
export function Layers({ box, frame, hider }) {
  if (!box.xyxy) return null;
  const { width, height } = contextOf(box.xyxy, hider?.box.xyxy);
  const side = Math.ceil(Math.max(width, height));
  return html`<div class="layers">
    ${layersOf(frame).map(
      (layer) => html`<${LayerCut} key=${layer} layer=${layer} box=${box} frame=${frame} side=${side} />`,
    )}</div>`;
}

/** On sharp screens, too. */
const CUT_PX = 256;

/** @param {{layer: Layer, box: Decision, frame: Frame, side: number}} props  `side`: of the cut, px of the image */
function LayerCut({ layer, box, frame, side }) {
  const [x0, y0, x1, y1] = /** @type {Xyxy} */ (box.xyxy);
  const { crop } = useCrop(
    url("/api/v1/boxes/{box_id}/crop", {
      path: { box_id: box.box_id },
      query: { layer, pad: 0, least: side, height: CUT_PX },
    }),
  );
  // Where the image ends, the cut does.
  const left = Math.max(0, Math.floor((x0 + x1 - side) / 2));
  const top = Math.max(0, Math.floor((y0 + y1 - side) / 2));
  const right = Math.min(frame.width ?? Infinity, Math.ceil((x0 + x1 + side) / 2));
  const bottom = Math.min(frame.height ?? Infinity, Math.ceil((y0 + y1 + side) / 2));
  const place = {
    left: `${(100 * (x0 - left)) / (right - left)}%`,
    top: `${(100 * (y0 - top)) / (bottom - top)}%`,
    width: `${(100 * (x1 - x0)) / (right - left)}%`,
    height: `${(100 * (y1 - y0)) / (bottom - top)}%`,
  };
  return html`<figure class="layers__cut">
    <div class="layers__picture ${crop ? "" : "shimmer"}" style=${{ aspectRatio: `${right - left} / ${bottom - top}` }}>
      ${crop && html`<img src=${crop.src} alt="" /><span class="layers__box" style=${place} />`}
    </div>
    <figcaption>${layer}</figcaption>
  </figure>`;
}

/** The depths of a box are said as from and to if it is as deep, m. */
const DEEP_M = 2;

/** What hides a box lies so much nearer than the pixels, at most, m. */
const LIKE_HIDER_M = 4;

/** "Box 53 m, pixels 31 m: a nearer car". @param {DepthSlice} slice @param {Decision} box @param {Hider} hider */
export function depthText({ near, far, median }, box, hider) {
  const at = near !== null && far !== null ? (near + far) / 2 : box.distance;
  const isDeep = near !== null && far !== null && far - near >= DEEP_M;
  const own =
    at === null
      ? "Box: not known"
      : `Box ${isDeep ? `${near.toFixed(0)} to ${metresText(Math.round(far))}` : metresText(at)}`;
  if (median === null) return `${own}, no pixels but sky`;
  const pixels = `pixels ${metresText(median)}`;
  if (at === null) return `${own}, ${pixels}`;
  const [low, high] = [(near ?? at) - 1, (far ?? at) + 1];
  const isHider = hider && Math.abs((hider.box.distance ?? Infinity) - median) <= LIKE_HIDER_M;
  const what =
    median < low
      ? isHider
        ? `a nearer ${hider.box.class.replaceAll("_", " ")}`
        : "something nearer"
      : median > high
        ? "what is behind it"
        : "where the box is";
  return `${own}, ${pixels}: ${what}`;
}

/** The axis ends so much beyond the box, and beyond so many of its pixels. */
const AXIS_BEYOND = 1.15;

const MOST_PERCENT = 80;

/** The depths of the box and of its pixels on one axis of metres. @param {{box: Decision, hider: Hider}} props */
function DepthStrip({ box, hider }) {
  const { value } = useLoaded(
    (signal) => get("/api/v1/boxes/{box_id}/slice", { path: { box_id: box.box_id }, signal }),
    [box.box_id],
  );
  if (!value) return html`<div class="depths" aria-hidden="true"></div>`;
  const near = value.near ?? box.distance;
  const far = value.far ?? box.distance;
  let sum = 0;
  // Up to the end of this band most of the pixels lie.
  const last = value.bands.find(({ percent }) => (sum += percent) >= MOST_PERCENT) ?? value.bands.at(-1);
  const end = AXIS_BEYOND * Math.max(far ?? 0, last?.far ?? 0, 1);
  const most = Math.max(...value.bands.map(({ percent }) => percent), 1);
  /** @param {number} from @param {number} to */
  const place = (from, to) => ({ left: `${(100 * from) / end}%`, width: `max(3px, ${(100 * (to - from)) / end}%)` });
  const shown = value.bands.filter((band) => band.near < end);
  return html`<div class="depths" role="img" aria-label=${depthText(value, box, hider)}>
    <span class="depths__words num">${depthText(value, box, hider)}</span>
    <span class="depths__axis" aria-hidden="true">
      ${shown.map(
        ({ near: from, far: to, percent }) => html`<i class="depths__band"
          style=${{ ...place(from, to), height: `${Math.max(8, (100 * percent) / most)}%` }} />`,
      )}
      ${near !== null && far !== null && html`<i class="depths__box" style=${place(near, far)} />`}
    </span>
    <span class="faint num">${metresText(end)}</span>
  </div>`;
}
