// @ts-check
// Pictures, fetched with the session and decoded; the one that is likely next, ahead of time.

import { api } from "./api.js";

/** The picture that is likely to be wanted next. @type {{url: string, coming: Promise<HTMLImageElement>} | null} */
let ahead = null;

/** Fetch and decode a picture before it is asked for. @param {string} url */
export function fetchAhead(url) {
  if (ahead?.url === url) return;
  ahead = { url, coming: imageFrom(url) };
  ahead.coming.catch(() => (ahead = null));
}

/** @param {string} url @param {AbortSignal} [signal] @returns {Promise<HTMLImageElement>} */
export const imageAt = (url, signal) => (ahead?.url === url ? ahead.coming : imageFrom(url, signal));

/** @param {string} url @param {AbortSignal} [signal] */
async function imageFrom(url, signal) {
  const image = new Image();
  // By fetch, which shows the session; what is decoded needs its address no longer.
  image.src = URL.createObjectURL(await api.blob(url, signal));
  try {
    await image.decode();
  } finally {
    URL.revokeObjectURL(image.src);
  }
  return image;
}
