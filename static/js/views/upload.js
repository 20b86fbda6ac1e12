// @ts-check
// Bringing files: dropped anywhere on the page, or picked with a button.

import { html, useEffect, useRef, useState } from "../html.js";
import { filesOfDrop, filesOfField, hasFiles } from "../upload/pick.js";
import { useValue } from "./hooks.js";
import { Icon } from "./icons.js";
import { UploadDialog } from "./upload_dialog.js";
import { UploadPanel } from "./upload_panel.js";

/** @typedef {import("../app.js").App} App */

/** What uploads show over whatever view is on. @param {{app: App}} props */
export function Uploads({ app }) {
  const dropped = useValue(app.uploads.dropped);
  const job = useValue(app.uploads.job);
  const isOver = useDrop(app);
  return html`
    ${isOver && html`<div class="dropzone" aria-hidden="true"><div class="dropzone__card"><${Icon} name="upload" />Drop images, segmentations and labels to upload them</div></div>`}
    ${dropped && html`<${UploadDialog} key=${dropped} app=${app} dropped=${dropped} />`}
    ${job && html`<${UploadPanel} key=${job} app=${app} job=${job} />`}`;
}

/** Listens on the whole window. @param {App} app @returns {boolean} files hang over it */
function useDrop(app) {
  const [isOver, setOver] = useState(false);
  useEffect(() => {
    const stop = new AbortController();
    /** Entering a child comes before leaving its parent: only the balance tells. */
    let depth = 0;
    /** @template {keyof WindowEventMap} K @param {K} type @param {(event: WindowEventMap[K]) => void} handle */
    const on = (type, handle) => addEventListener(type, handle, { signal: stop.signal });
    /** @param {DragEvent} event @param {number} change */
    const count = (event, change) => {
      if (!hasFiles(event.dataTransfer)) return;
      event.preventDefault();
      depth = Math.max(0, depth + change);
      setOver(depth > 0);
    };
    on("dragenter", (event) => count(event, 1));
    on("dragleave", (event) => count(event, -1));
    on("dragover", (event) => hasFiles(event.dataTransfer) && event.preventDefault());
    on("drop", (event) => {
      count(event, -depth);
      if (event.dataTransfer && hasFiles(event.dataTransfer)) offer(app, filesOfDrop(event.dataTransfer));
    });
    return () => stop.abort();
  }, [app]);
  return isOver;
}

/** One at a time: what runs is not thrown away by a second drop. @param {App} app @param {Promise<import("../upload/matching.js").Entry[]>} files */
function offer(app, files) {
  if (app.uploads.isRunning()) app.toasts.show("An upload is going on. Wait for it, or cancel it first.");
  else app.uploads.take(files);
}

/** @param {{app: App, isPrimary?: boolean}} props */
export function UploadButtons({ app, isPrimary = false }) {
  return html`<div class="pickers">
    <${Picker} app=${app} text="Upload a folder" icon="upload" isFolder=${true} isPrimary=${isPrimary} />
    <${Picker} app=${app} text="Upload files" icon="image" />
  </div>`;
}

/** @param {{app: App, text: string, icon: string, isFolder?: boolean, isPrimary?: boolean}} props */
function Picker({ app, text, icon, isFolder = false, isPrimary = false }) {
  const field = useRef(/** @type {HTMLInputElement | null} */ (null));
  /** @param {{currentTarget: HTMLInputElement}} event */
  const onChange = ({ currentTarget }) => {
    if (currentTarget.files?.length) offer(app, filesOfField(currentTarget.files));
    // The same folder may be picked again.
    currentTarget.value = "";
  };
  return html`<span>
    <button class="button ${isPrimary ? "button--primary" : ""}" onClick=${() => field.current?.click()}><${Icon} name=${icon} />${text}</button>
    <input ref=${field} type="file" hidden multiple webkitdirectory=${isFolder} aria-label=${text} onChange=${onChange} />
  </span>`;
}
