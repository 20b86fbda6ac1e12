// @ts-check
// Crops, fetched a few at a time. What is scrolled away before its turn is never asked for;
// what is under way is cancelled. The last hundreds stay.

import { ApiError } from "../api.js";

/** @typedef {{src: string, width: number, height: number}} Crop */
/** @typedef {{state: "shown", crop: Crop} | {state: "none" | "failed", crop: null}} CropAnswer */
/** @typedef {{url: string, tell: (answer: CropAnswer) => void}} Wish */

const PARALLEL = 6;
const KEPT = 800;

/**
 * @param {(url: string, signal: AbortSignal) => Promise<Crop>} fetchCrop
 * @param {{onError?: (error: unknown) => void, discard?: (crop: Crop) => void, parallel?: number, kept?: number}} [how]
 */
export function createCrops(fetchCrop, { onError = () => {}, discard = () => {}, parallel = PARALLEL, kept = KEPT } = {}) {
  /** Oldest use first. @type {Map<string, Crop>} */
  const have = new Map();
  /** @type {Set<Wish>} */
  const waiting = new Set();
  /** @type {Map<string, {wishes: Set<Wish>, stop: AbortController}>} */
  const underWay = new Map();
  /** Urls on show, and how often. @type {Map<string, number>} */
  const inUse = new Map();

  function next() {
    for (const wish of waiting) {
      const going = underWay.get(wish.url);
      if (going) going.wishes.add(wish);
      else if (underWay.size >= parallel) continue;
      else void start(wish);
      waiting.delete(wish);
    }
  }

  /** @param {Wish} first */
  async function start(first) {
    const going = { wishes: new Set([first]), stop: new AbortController() };
    underWay.set(first.url, going);
    const answer = await fetchCrop(first.url, going.stop.signal).then(
      (crop) => /** @type {CropAnswer} */ ({ state: "shown", crop }),
      (error) => refusal(error, going.stop.signal),
    );
    // Cancelled meanwhile, and perhaps asked for anew: then this answer is nobody's.
    if (underWay.get(first.url) === going) underWay.delete(first.url);
    if (answer?.crop) keep(first.url, answer.crop);
    if (answer) for (const wish of going.wishes) wish.tell(answer);
    next();
  }

  /** @param {unknown} error @param {AbortSignal} signal @returns {CropAnswer | null} */
  function refusal(error, signal) {
    if (signal.aborted) return null;
    onError(error);
    const isNone = error instanceof ApiError && error.status === 404;
    return { state: isNone ? "none" : "failed", crop: null };
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

    /** Ask for a crop; call what is returned once it is not wanted any more. @param {string} url @param {(answer: CropAnswer) => void} tell */
    want(url, tell) {
      use(url, 1);
      const wish = { url, tell };
      const crop = have.get(url);
      if (crop) {
        have.delete(url);
        have.set(url, crop);
        tell({ state: "shown", crop });
      } else {
        waiting.add(wish);
        next();
      }
      return () => {
        use(url, -1);
        waiting.delete(wish);
        const going = underWay.get(url);
        if (!going?.wishes.delete(wish) || going.wishes.size > 0) return;
        underWay.delete(url);
        going.stop.abort();
        // Others are given up in the same stroke: their turn must not come in between.
        queueMicrotask(next);
      };
    },

    /** For those who watch: how much is asked for now. */
    load: () => ({ underWay: underWay.size, waiting: waiting.size }),
  };
}

/** @typedef {ReturnType<typeof createCrops>} Crops */
