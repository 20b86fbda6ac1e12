// @ts-check
// The page's small pictures: fetched once, shared by every view that shows them.

import { createCrops } from "../grid/crops.js";
import { html, useEffect, useLayoutEffect, useRef, useState } from "../html.js";

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

/** @typedef {{url: string, state: "waiting" | "shown" | "none" | "failed", crop: import("../grid/crops.js").Crop | null}} SeenCrop */

/** A crop as long as its cell is on show. @param {import("../app.js").App} app @param {string} url @returns {SeenCrop} */
export function useCrop(app, url) {
  const crops = cropsOf(app);
  const [seen, setSeen] = useState(/** @type {SeenCrop | null} */ (null));
  const [attempt, setAttempt] = useState(0);
  useEffect(() => (url ? crops.want(url, (answer) => setSeen({ url, ...answer })) : undefined), [url, attempt]);
  const hasFailed = seen?.state === "failed";
  // With the drawing that says so, and not after it: the network may be back by then.
  useLayoutEffect(() => {
    if (!hasFailed) return;
    const again = () => setAttempt((n) => n + 1);
    addEventListener("online", again);
    return () => removeEventListener("online", again);
  }, [hasFailed]);
  if (seen?.url === url) return seen;
  const crop = url ? crops.ready(url) : null;
  return { url, state: crop ? "shown" : "waiting", crop };
}

/** How far from the screen a picture is asked for already. */
const NEAR = "400px";

/**
 * A picture that is asked for when it comes near the screen, and given up when it leaves.
 * @param {{app: import("../app.js").App, url: string, children?: unknown}} props  `children`: what stands there when there is none
 */
export function NearPicture({ app, url, children }) {
  const place = useRef(/** @type {HTMLImageElement | null} */ (null));
  const [isNear, setNear] = useState(false);
  const { state, crop } = useCrop(app, isNear ? url : "");
  const isMissing = isNear && (state === "none" || state === "failed");
  useEffect(() => {
    const watcher = new IntersectionObserver((entries) => setNear(entries.at(-1)?.isIntersecting ?? false), { rootMargin: NEAR });
    if (place.current) watcher.observe(place.current);
    return () => watcher.disconnect();
  }, [isMissing]);
  return isMissing && children ? children : html`<img ref=${place} src=${crop?.src} alt="" decoding="async" draggable=${false} />`;
}
