// @ts-check
// Pictures, fetched with the session and decoded; the one that is likely next, ahead of time.

import { blob, url } from "./api.js";

/** @param {import("./openapi.js").Frame} frame @param {"image" | "segmentation"} kind */
export const fileUrl = ({ id, files }, kind) => files[kind]?.url ?? url("/api/v1/frames/{frame_id}/{kind}", { path: { frame_id: id, kind } });

/** The segmentation painted in its palette, whatever its file's encoding. @param {number} id */
export const paintedUrl = (id) => url("/api/v1/frames/{frame_id}/overlay", { path: { frame_id: id }, query: { layer: "segmentation", boxes: "" } });

/** @param {number} id  of a frame */
export const thumbnailUrl = (id) => url("/api/v1/frames/{frame_id}/thumbnail", { path: { frame_id: id } });

/** The picture that is likely to be shown next, already requested. @type {{address: string, coming: Promise<HTMLImageElement>} | null} */
let ahead = null;

/** Fetch and decode a picture before it is asked for. @param {string} address */
export function fetchAhead(address) {
  if (ahead?.address === address) return;
  ahead = { address, coming: imageFrom(address) };
  ahead.coming.catch(() => (ahead = null));
}

/** @param {string} address @param {AbortSignal} [signal] @returns {Promise<HTMLImageElement>} */
export const imageAt = (address, signal) => (ahead?.address === address ? ahead.coming : imageFrom(address, signal));

/** @param {string} address @param {AbortSignal} [signal] */
async function imageFrom(address, signal) {
  const image = new Image();
  // By fetch, because an <img> sends no session. A decoded image no longer needs its address.
  image.src = URL.createObjectURL(await blob(address, signal));
  try {
    await image.decode();
  } finally {
    URL.revokeObjectURL(image.src);
  }
  return image;
}
