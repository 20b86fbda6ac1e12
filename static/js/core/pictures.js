// @ts-check
// The addresses of pictures, and a picture fetched with the session and decoded.

import { blob, url } from "./api.js";

/** @param {import("./openapi.js").Frame} frame @param {"image" | "segmentation"} kind */
export const fileUrl = ({ id, files }, kind) => files[kind]?.url ?? url("/api/v1/frames/{frame_id}/{kind}", { path: { frame_id: id, kind } });

/** The segmentation painted in its palette, whatever its file's encoding. @param {number} id */
export const paintedUrl = (id) => url("/api/v1/frames/{frame_id}/overlay", { path: { frame_id: id }, query: { layer: "segmentation", boxes: "" } });

/** @param {number} id  of a frame */
export const thumbnailUrl = (id) => url("/api/v1/frames/{frame_id}/thumbnail", { path: { frame_id: id } });

/** @param {string} address @param {AbortSignal} [signal] */
export async function imageAt(address, signal) {
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
