// @ts-check
// The page's crops: fetched once, shared by every view that shows them.

import { createCrops } from "../grid/crops.js";

/** @type {WeakMap<import("../app.js").App, import("../grid/crops.js").Crops>} */
const caches = new WeakMap();

/** @param {import("../app.js").App} app */
export function cropsOf(app) {
  const known = caches.get(app);
  if (known) return known;
  const crops = createCrops((url, signal) => load(app, url, signal), { onError: app.notice, discard: ({ src }) => URL.revokeObjectURL(src) });
  caches.set(app, crops);
  return crops;
}

/** @param {import("../app.js").App} app @param {string} url @param {AbortSignal} signal */
async function load(app, url, signal) {
  const src = URL.createObjectURL(await app.api.blob(url, signal));
  const image = new Image();
  image.src = src;
  await image.decode();
  return { src, width: image.naturalWidth, height: image.naturalHeight };
}
