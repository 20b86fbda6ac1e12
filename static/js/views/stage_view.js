// @ts-check
// The stage as part of the page: it gets a snapshot whenever something that is drawn has changed.

import { html, useEffect, useLayoutEffect, useMemo, useRef, useState } from "../html.js";
import { imageAt } from "../pictures.js";
import { canvasOf, isPaintedAlready, litPixels } from "../stage/pixels.js";
import { createStage } from "../stage/stage.js";
import { onThemeChange } from "../theme.js";
import { countOf, spokenText } from "../wording.js";
import { isVeiled } from "../blind.js";
import { useValue } from "./hooks.js";
import { Notice } from "./parts.js";

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../types.js").Frame} Frame */
/** @typedef {import("../types.js").Decision} Decision */

/**
 * @param {{app: App, frame: Frame, shown: readonly Decision[], selected: Decision | null,
 *   onSelect: (boxId: number | null) => void, stageRef: {current: import("../stage/stage.js").Stage | null}}} props
 */
export function StageView({ app, frame, shown, selected, onSelect, stageRef }) {
  const host = useRef(/** @type {HTMLDivElement | null} */ (null));
  const prefs = useValue(app.prefs);
  const picture = usePicture(frame.has_image ? app.api.fileUrl(frame, "image") : null);
  const wantsPixels = frame.has_segmentation && (prefs.mask || (prefs.lit && selected !== null && !isVeiled(selected)));
  const segmentation = useSegmentation(app, frame, wantsPixels);
  const mask = useMask(app, frame, prefs.mask, segmentation.canvas);
  const lit = useMemo(
    () => (prefs.lit && selected && segmentation.canvas && frame.segmentation ? litPixels(segmentation.canvas, frame.segmentation, selected) : null),
    [prefs.lit, selected?.box_id, selected?.accepted_tags, segmentation.canvas],
  );
  const image = imageSize(frame, picture.image);

  useLayoutEffect(() => {
    const stage = createStage(/** @type {HTMLElement} */ (host.current), {
      onSelect,
      onZoom: app.zoom.set,
      onCrop: (crop) => app.prefs.change({ crop }),
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
    const boxes = selected && !shown.includes(selected) ? [...shown, selected] : shown;
    stageRef.current?.update({ image, picture: picture.image, mask, opacity: prefs.opacity, boxes, selected, lit, edges: prefs.edges, crop: prefs.crop });
  }, [picture.image, mask, prefs.opacity, shown, selected, lit, prefs.edges, prefs.crop]);

  const words = `${countOf(shown.length, "box", "boxes")} shown${selected ? `; selected: ${spokenText(selected)}` : ""}`;
  return html`<div class="stage-wrap">
    <div class="stage" ref=${host} role="img" aria-label=${`Frame ${frame.key}: ${words}`} data-lit=${lit?.count ?? ""} data-mask=${mask ? "on" : "off"} data-picture=${picture.state}></div>
    ${picture.state === "failed" && html`<div class="stage__note"><${Notice} title="The image cannot be shown"><p>Its boxes and numbers are still here.</p><//></div>`}
    ${picture.state === "loading" && html`<div class="stage__loading shimmer" aria-hidden="true"></div>`}
    ${segmentation.error && html`<p class="stage__error" role="alert">Segmentation: ${segmentation.error}</p>`}
  </div>`;
}

/** @param {Frame} frame @param {HTMLImageElement | null} picture */
function imageSize(frame, picture) {
  return { width: frame.width ?? picture?.naturalWidth ?? 1280, height: frame.height ?? picture?.naturalHeight ?? 720 };
}

/** @param {string | null} url */
function usePicture(url) {
  const [found, setFound] = useState(/** @type {{image: HTMLImageElement | null, state: "loading" | "shown" | "failed"}} */ ({ image: null, state: url ? "loading" : "failed" }));
  useEffect(() => {
    const stop = new AbortController();
    if (url) {
      imageAt(url, stop.signal).then(
        (image) => !stop.signal.aborted && setFound({ image, state: "shown" }),
        () => !stop.signal.aborted && setFound({ image: null, state: "failed" }),
      );
    }
    return () => stop.abort();
  }, [url]);
  return found;
}

/** The segmentation's stored pixels, loaded once they are wanted. @param {App} app @param {Frame} frame @param {boolean} isWanted */
function useSegmentation(app, frame, isWanted) {
  const [found, setFound] = useState(/** @type {{canvas: HTMLCanvasElement | null, error: string}} */ ({ canvas: null, error: "" }));
  useEffect(() => {
    if (!isWanted || found.canvas) return;
    const stop = new AbortController();
    app.api.blob(app.api.fileUrl(frame, "segmentation"), stop.signal).then(canvasOf).then(
      (canvas) => !stop.signal.aborted && setFound({ canvas, error: "" }),
      (error) => {
        if (stop.signal.aborted) return;
        app.notice(error);
        setFound({ canvas: null, error: error.message });
      },
    );
    return () => stop.abort();
  }, [isWanted]);
  return found;
}

/** @param {App} app @param {Frame} frame @param {boolean} isOn @param {HTMLCanvasElement | null} segmentation @returns {CanvasImageSource | null} */
function useMask(app, frame, isOn, segmentation) {
  const isPainted = frame.segmentation !== null && isPaintedAlready(frame.segmentation);
  const [painted, setPainted] = useState(/** @type {HTMLImageElement | null} */ (null));
  useEffect(() => {
    if (!isOn || isPainted || !frame.has_segmentation || painted) return;
    imageAt(app.api.paintedUrl(frame.id)).then(setPainted, () => app.toasts.show("The segmentation could not be painted.", { kind: "error" }));
  }, [isOn]);
  if (!isOn) return null;
  return isPainted ? segmentation : painted;
}
