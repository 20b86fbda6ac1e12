// @ts-check
// Crops of boxes: fetched, cached, and drawn in a square. Used by the grid, the queue's strip and the flips.

import { ApiError, blob, pictureUrl } from "../core/api.js";
import { useRetries, useRetryOnline } from "../core/hooks.js";
import { html, useEffect, useMemo, useRef, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { createBundles } from "./bundles.js";

/** @import { Decision, Xyxy } from "./box.js" */
/** @typedef {{src: string, width: number, height: number}} Crop */
/** @typedef {{state: "failed", crop: null, error: Error}} NoCrop */
/** @typedef {{state: "shown", crop: Crop} | {state: "none", crop: null} | NoCrop} CropAnswer */
/** @typedef {(answer: CropAnswer) => void} Tell */

const KEPT = 800;

/**
 * @param {(url: string, signal: AbortSignal) => Promise<Crop>} fetchCrop
 * @param {{onError?: (error: unknown) => void, discard?: (crop: Crop) => void, kept?: number}} [how]
 */
export function createCrops(fetchCrop, { onError = () => {}, discard = () => {}, kept = KEPT } = {}) {
  /** Oldest use first. @type {Map<string, Crop>} */
  const have = new Map();
  /** @type {Map<string, {tells: Set<Tell>, stop: AbortController}>} */
  const underWay = new Map();
  /** Urls on show, and how often. @type {Map<string, number>} */
  const inUse = new Map();

  /** @param {string} url */
  function start(url) {
    const going = { tells: /** @type {Set<Tell>} */ (new Set()), stop: new AbortController() };
    underWay.set(url, going);
    void fetchCrop(url, going.stop.signal)
      .then(
        (crop) => /** @type {CropAnswer} */ ({ state: "shown", crop }),
        (error) => refusal(error, going.stop.signal),
      )
      .then((answer) => {
        // If it was cancelled, and perhaps requested again meanwhile, this answer is ignored.
        if (underWay.get(url) === going) underWay.delete(url);
        if (answer?.crop) keep(url, answer.crop);
        if (answer) for (const tell of going.tells) tell(answer);
      });
    return going;
  }

  /** @param {Error} error @param {AbortSignal} signal @returns {CropAnswer | null} */
  function refusal(error, signal) {
    if (signal.aborted) return null;
    onError(error);
    if (error instanceof ApiError && error.status === 404) return { state: "none", crop: null };
    return { state: "failed", crop: null, error };
  }

  /** @param {string} url @param {Crop} crop */
  function keep(url, crop) {
    have.set(url, crop);
    for (const [old, its] of have) {
      if (have.size <= kept) return;
      if (inUse.has(old)) continue;
      have.delete(old);
      discard(its);
    }
  }

  /** @param {string} url @param {number} change */
  function use(url, change) {
    const times = (inUse.get(url) ?? 0) + change;
    if (times > 0) inUse.set(url, times);
    else inUse.delete(url);
  }

  return {
    /** The crop if it is here. @param {string} url */
    ready: (url) => have.get(url) ?? null,

    /**
     * Request a crop. Returns a function to be called when the crop is no longer needed.
     * @param {string} url @param {Tell} onAnswer
     */
    want(url, onAnswer) {
      use(url, 1);
      // The same function may want a crop twice.
      const tell = (/** @type {CropAnswer} */ answer) => onAnswer(answer);
      const crop = have.get(url);
      if (crop) {
        have.delete(url);
        have.set(url, crop);
        tell({ state: "shown", crop });
      } else (underWay.get(url) ?? start(url)).tells.add(tell);
      return () => {
        use(url, -1);
        const going = underWay.get(url);
        if (!going?.tells.delete(tell) || going.tells.size > 0) return;
        underWay.delete(url);
        going.stop.abort();
      };
    },
  };
}

/** @typedef {ReturnType<typeof createCrops>} Crops */

/** @typedef {{width: number, height: number}} Size */
/** @typedef {{left: number, top: number, width: number, height: number}} Place  px in the cell */

/** Of the box's longer side, on every side of it. */
const AROUND = 0.3;

/** Of a tiny box one sees at least so much around. */
const LEAST_SIDE_PX = 28;
const PAD_STEP = 0.05;
const MOST_PAD = 10;
const HEIGHT_STEP_PX = 32;

/** The square of the image that a cell shows. @param {Xyxy} xyxy */
function squareAround([x0, y0, x1, y1]) {
  const side = Math.max(Math.max(x1 - x0, y1 - y0) * (1 + 2 * AROUND), LEAST_SIDE_PX);
  return { x: (x0 + x1 - side) / 2, y: (y0 + y1 - side) / 2, side };
}

/**
 * What to ask the server for: enough around the box to fill the square.
 * @param {Xyxy} xyxy @param {number} cell css px
 * @param {number} density device px per css px
 * @returns {{pad: number, height: number}}
 */
export function cropRequest(xyxy, cell, density) {
  const [x0, y0, x1, y1] = xyxy;
  const long = Math.max(x1 - x0, y1 - y0, 1);
  const short = Math.min(x1 - x0, y1 - y0);
  const { side } = squareAround(xyxy);
  const pad = Math.min(MOST_PAD, Math.ceil((side - short) / (2 * long) / PAD_STEP) * PAD_STEP);
  const rows = y1 - y0 + 2 * pad * long;
  const pixels = (rows * cell * Math.min(density, 2)) / side;
  const height = Math.min(1024, Math.max(HEIGHT_STEP_PX, Math.ceil(pixels / HEIGHT_STEP_PX) * HEIGHT_STEP_PX));
  return { pad: Math.round(pad * 100) / 100, height };
}

/**
 * Where the crop and the box on it lie in the cell.
 * @param {Xyxy} xyxy @param {number} pad @param {number} cell css px
 * @param {Size} natural of the crop @param {Size | null} frame of the image, if it is known
 * @returns {{picture: Place, box: Place}}
 */
export function placed(xyxy, pad, cell, natural, frame) {
  const { x, y, side } = squareAround(xyxy);
  const scale = cell / side;
  const [x0, y0, x1, y1] = xyxy;
  const margin = pad * Math.max(x1 - x0, y1 - y0, 1);
  // The part of the image that the server cuts out, as long as the image goes on.
  const asked = {
    left: Math.max(0, Math.floor(x0 - margin)),
    top: Math.max(0, Math.floor(y0 - margin)),
    right: Math.ceil(x1 + margin),
    bottom: Math.ceil(y1 + margin),
  };
  const cut = clipped(asked, natural, frame);
  return {
    picture: {
      left: (cut.left - x) * scale,
      top: (cut.top - y) * scale,
      width: (cut.right - cut.left) * scale,
      height: (cut.bottom - cut.top) * scale,
    },
    box: boxIn(xyxy, cell),
  };
}

/** The box alone, for a cell whose crop is still to come. @param {Xyxy} xyxy @param {number} cell @returns {Place} */
export function boxIn(xyxy, cell) {
  const { x, y, side } = squareAround(xyxy);
  const [x0, y0, x1, y1] = xyxy;
  const scale = cell / side;
  return { left: (x0 - x) * scale, top: (y0 - y) * scale, width: (x1 - x0) * scale, height: (y1 - y0) * scale };
}

/** @typedef {{left: number, top: number, right: number, bottom: number}} Window */

/**
 * Where the image ended, the crop is smaller than what was asked for. Its shape tells on which
 * side; where both sides end, only the image's size does.
 * @param {Window} asked @param {Size} natural @param {Size | null} frame @returns {Window}
 */
function clipped(asked, natural, frame) {
  const shape = natural.width / natural.height;
  if (frame) {
    const inside = {
      ...asked,
      right: Math.min(asked.right, frame.width),
      bottom: Math.min(asked.bottom, frame.height),
    };
    if (isLike(shapeOf(inside), shape, natural)) return inside;
  }
  if (isLike(shapeOf(asked), shape, natural)) return asked;
  if (shape < shapeOf(asked)) return { ...asked, right: asked.left + shape * (asked.bottom - asked.top) };
  return { ...asked, bottom: asked.top + (asked.right - asked.left) / shape };
}

/** @param {Window} window */
const shapeOf = ({ left, top, right, bottom }) => (right - left) / Math.max(1, bottom - top);

/**
 * Equal but for the rounding of either side to whole pixels.
 * @param {number} a @param {number} b @param {Size} natural
 */
const isLike = (a, b, { width, height }) => Math.abs(a / b - 1) <= 1.5 / Math.min(width, height);

const fetchCrop = createBundles(blob);

/** Of the whole page. */
const crops = createCrops(load, { discard: ({ src }) => URL.revokeObjectURL(src) });

/** @param {string} address @param {AbortSignal} signal */
async function load(address, signal) {
  const src = URL.createObjectURL(await fetchCrop(address, signal));
  const image = new Image();
  image.src = src;
  await image.decode();
  return { src, width: image.naturalWidth, height: image.naturalHeight };
}

/** @typedef {{url: string, state: "waiting" | "shown" | "none" | "failed", crop: Crop | null}} SeenCrop */

/**
 * A crop, requested while its cell is on the page, and again after a failure that may pass.
 * @param {string} url @returns {SeenCrop}
 */
export function useCrop(url) {
  const [seen, setSeen] = useState(/** @type {(CropAnswer & {url: string}) | null} */ (null));
  const [attempt, setAttempt] = useState(0);
  useEffect(() => (url ? crops.want(url, (answer) => setSeen({ url, ...answer })) : undefined), [url, attempt]);
  const failed = seen?.state === "failed" && seen.url === url ? seen : null;
  const again = () => setAttempt((n) => n + 1);
  useRetryOnline(failed, again);
  useRetries(failed?.error ?? null, again, url);
  if (seen?.url === url) return seen;
  const crop = url ? crops.ready(url) : null;
  return { url, state: crop ? "shown" : "waiting", crop };
}

/** How near to the visible part a picture must be to be requested. */
const NEAR = "400px";

/** Whether an element is near the visible part. @param {{current: HTMLElement | null}} place */
function useNear(place) {
  const [isNear, setNear] = useState(false);
  useEffect(() => {
    const watcher = new IntersectionObserver((entries) => setNear(entries.at(-1)?.isIntersecting ?? false), {
      rootMargin: NEAR,
    });
    if (place.current) watcher.observe(place.current);
    return () => watcher.disconnect();
  }, []);
  return isNear;
}

/**
 * A picture that is requested when it comes near the visible part, and given up when it leaves.
 * @param {{url: string}} props
 */
export function NearPicture({ url }) {
  const place = useRef(/** @type {HTMLImageElement | null} */ (null));
  const { crop } = useCrop(useNear(place) ? url : "");
  return html`<img ref=${place} src=${crop?.src} alt="" decoding="async" draggable=${false} />`;
}

/** A smaller picture is no look at a box, css px. */
const LEAST_LOOKED_PX = 64;

/** Boxes whose picture was on the screen. @type {Set<number>} */
const lookedAt = new Set();

/** How many of these boxes had their picture on the screen. @param {readonly number[]} ids */
export const countLookedAt = (ids) => ids.filter((id) => lookedAt.has(id)).length;

/**
 * Note that a box is looked at when its picture is on the screen.
 * @param {number} boxId @param {Crop | null} crop @param {number} size
 */
function useLook(boxId, crop, size) {
  const picture = useRef(/** @type {HTMLImageElement | null} */ (null));
  useEffect(() => {
    if (!picture.current || lookedAt.has(boxId) || size < LEAST_LOOKED_PX) return;
    const watcher = new IntersectionObserver(
      (entries) => entries.some(({ isIntersecting }) => isIntersecting) && lookedAt.add(boxId),
      { threshold: 0.5 },
    );
    watcher.observe(picture.current);
    return () => watcher.disconnect();
  }, [boxId, crop, size]);
  return picture;
}

/** @typedef {Pick<Decision, "box_id" | "xyxy" | "reason" | "effective_verdict">} PicturedBox */

/**
 * A box in its surroundings, drawn in a square that its parent provides.
 * @param {{box: PicturedBox, size: number, frameSize: Size | null}} props  `size`: of the square, css px, or about that
 */
export function Picture({ box, size, frameSize }) {
  const { xyxy, box_id } = box;
  const ask = xyxy ? cropRequest(xyxy, size, devicePixelRatio || 1) : null;
  // Another run may have measured the rectangle otherwise.
  const version = `-${xyxy?.map(Math.round).join("-")}`;
  const { state, crop } = useCrop(
    ask ? pictureUrl("/api/v1/boxes/{box_id}/crop", { path: { box_id }, query: ask }, version) : "",
  );
  const places = useMemo(
    () => (xyxy && ask && crop ? placed(xyxy, ask.pad, size, crop, frameSize) : null),
    [crop, size, frameSize, ask?.pad, box_id],
  );
  const picture = useLook(box_id, crop, size);
  if (!xyxy)
    return html`<div
      class="cell__none"><${Icon} name="image" /><span>${box.reason === "outside_image" ? "outside" : "no area"}</span>
    </div>`;
  const outline = html`<span class="cell__box cell__box--${box.effective_verdict}"
    style=${shareOf(places?.box ?? boxIn(xyxy, size), size)} />`;
  if (!places || !crop)
    return html`<div class="cell__none cell__none--low ${state === "waiting" ? "shimmer" : ""}">
      ${state === "waiting" ? "" : state === "failed" ? "not loaded" : "no picture"}</div>${outline}`;
  return html`<img ref=${picture} class="cell__image" src=${crop.src} alt="" draggable=${false}
    style=${shareOf(places.picture, size)} />${outline}`;
}

/**
 * A place as share of the square, which may be drawn a little larger or smaller.
 * @param {Place} place @param {number} size
 */
const shareOf = ({ left, top, width, height }, size) => {
  const percent = (/** @type {number} */ px) => `${(100 * px) / size}%`;
  return { left: percent(left), top: percent(top), width: percent(width), height: percent(height) };
};

/**
 * A `Picture` that is requested when it comes near the visible part, and given up when it leaves.
 * @param {{box: PicturedBox, size: number}} props
 */
export function NearBox({ box, size }) {
  const place = useRef(/** @type {HTMLSpanElement | null} */ (null));
  const isNear = useNear(place);
  return html`<span class="nearbox"
    ref=${place}>${isNear && html`<${Picture} box=${box} size=${size} frameSize=${null} />`}</span>`;
}
