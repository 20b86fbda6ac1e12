// @ts-check
// Files and folders that are dropped or picked, and the progress of their upload.

import { useLazy, useValue } from "../core/hooks.js";
import { html, useEffect, useRef, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf, countText } from "../core/numbers.js";
import { createLazy } from "../core/observable.js";
import { Dialog, FailureLine, FileList, useDialog } from "../core/parts.js";
import { linkTo } from "../core/router.js";
import { doneOf, isOver } from "./uploader.js";

/** @typedef {import("./uploader.js").UploadApp} App */
/** @typedef {import("./folder.js").Entry} Entry */
/** @typedef {import("./uploader.js").Progress} Progress */

/** The parts of uploads that are shown over any view: drop zone, dialog, panel. @param {{app: App}} props */
export function Uploads({ app }) {
  const dropped = useValue(app.uploads.dropped);
  const job = useValue(app.uploads.job);
  const isOver = useDrop(app);
  return html`
    ${
      isOver &&
      html`<div class="dropzone"
        aria-hidden="true">
        <div class="dropzone__card"><${Icon} name="upload" />Drop images, segmentations and labels to upload them</div>
      </div>`
    }
    ${dropped && html`<${UploadDialog} key=${dropped} app=${app} dropped=${dropped} />`}
    ${job && html`<${UploadPanel} key=${job} app=${app} job=${job} />`}`;
}

/** Accept drops on the whole window. @param {App} app @returns {boolean} whether files are being dragged over it */
function useDrop(app) {
  const [isOver, setOver] = useState(false);
  useEffect(() => {
    const stop = new AbortController();
    /** "dragenter" of a child comes before "dragleave" of its parent, so both are counted. */
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

const FOUND_FILES = createLazy(async () => (await import("./dialog.js")).FoundFiles);

/**
 * The upload dialog. What it shows is loaded only when something was dropped.
 * @param {{app: App, dropped: Promise<Entry[]>}} props
 */
function UploadDialog({ app, dropped }) {
  const dialog = useDialog();
  const { value: FoundFiles, error, retry } = useLazy(FOUND_FILES);
  return html`<${Dialog} dialog=${dialog} id="upload-title" title="Upload" kind="upload"
    onClose=${() => app.uploads.discard(dropped)}>
    ${
      FoundFiles
        ? html`<${FoundFiles} app=${app} dropped=${dropped} close=${dialog.close} />`
        : error
          ? html`<${FailureLine} what="The upload dialog could not be loaded" error=${error} onRetry=${retry} />`
          : html`<p class="upload__reading"
            role="status"><span class="spinner" aria-hidden="true"></span>Listing the files</p>`
    }
  <//>`;
}

/**
 * Start an upload, unless one is running: a second drop must not end it.
 * @param {App} app
 * @param {Promise<import("./folder.js").Entry[]>} files
 */
function offer(app, files) {
  if (app.uploads.isRunning()) app.toasts.show("An upload is in progress. Wait for it, or cancel it first.");
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
    if (currentTarget.files?.length) offer(app, filesOfField([...currentTarget.files]));
    // The same folder may be picked again.
    currentTarget.value = "";
  };
  return html`<span>
    <button class="button ${isPrimary ? "button--primary" : ""}"
      onClick=${() => field.current?.click()}><${Icon} name=${icon} />${text}</button>
    <input ref=${field} type="file" hidden multiple webkitdirectory=${isFolder} aria-label=${text}
      onChange=${onChange} />
  </span>`;
}

/** With more files than this the page would be too slow. */
const MOST_FILES = 60_000;

/** Too many files were dropped or picked. */
class TooMany extends Error {
  constructor() {
    super(`These are more than ${MOST_FILES} files: use the command line for them.`);
  }
}

/** Whether files are being dragged. @param {DataTransfer | null} transfer */
const hasFiles = (transfer) => transfer?.types.includes("Files") ?? false;

/**
 * All files of a drop. Must be called within the event's handler: its content is not available later.
 * @param {DataTransfer} transfer
 * @returns {Promise<Entry[]>}
 */
function filesOfDrop(transfer) {
  const items = [...transfer.items].filter(({ kind }) => kind === "file");
  const found = items.map((item) => item.webkitGetAsEntry?.() ?? item.getAsFile());
  return allOf(found);
}

/** @param {readonly (FileSystemEntry | File | null)[]} found */
async function allOf(found) {
  /** @type {Entry[]} */
  const entries = [];
  for (const one of found) {
    if (one instanceof File) entries.push({ path: one.name, open: async () => one });
    else if (one) await collect(one, entries);
  }
  return entries.sort((a, b) => (a.path < b.path ? -1 : 1));
}

/** @param {readonly File[]} files @returns {Promise<Entry[]>} */
async function filesOfField(files) {
  if (files.length > MOST_FILES) throw new TooMany();
  return files.map((file) => ({ path: file.webkitRelativePath || file.name, open: async () => file }));
}

/** @param {FileSystemEntry} entry @param {Entry[]} entries */
async function collect(entry, entries) {
  if (entries.length >= MOST_FILES) throw new TooMany();
  if (entry.isFile) {
    const { file } = /** @type {FileSystemFileEntry} */ (entry);
    /** @type {Promise<File> | undefined} */
    let asked;
    const open = () => (asked ??= new Promise((resolve, reject) => file.call(entry, resolve, reject)));
    entries.push({ path: entry.fullPath.replace(/^\//, ""), open });
    return;
  }
  const reader = /** @type {FileSystemDirectoryEntry} */ (entry).createReader();
  // A reader gives some entries at a time, and none at the end.
  for (let some = await nextEntries(reader); some.length; some = await nextEntries(reader))
    for (const inside of some) await collect(inside, entries);
}

/** @param {FileSystemDirectoryReader} reader @returns {Promise<FileSystemEntry[]>} */
const nextEntries = (reader) => new Promise((resolve, reject) => reader.readEntries(resolve, reject));

/** @type {Record<import("./uploader.js").Phase, string>} */
const PHASES = {
  sending: "Uploading",
  paused: "Paused",
  offline: "The server does not answer; trying again",
  busy: "The server is busy; trying again",
  "signed-out": "Signed out; sign in to continue",
  done: "Uploaded",
  stopped: "Stopped",
};

/** @param {{app: import("./uploader.js").UploadApp, job: import("./uploader.js").Job}} props */
function UploadPanel({ app, job: { dataset, uploader } }) {
  const progress = useValue(uploader.state);
  const { phase, total, refused, setAside, trouble } = progress;
  const done = doneOf(progress);
  const percent = total ? Math.floor((100 * done) / total) : 100;
  const isEnd = isOver(phase);
  return html`<section class="upload-panel" aria-label="Upload">
    <header class="upload-panel__head">
      <h2>${PHASES[phase]} <span class="faint">${dataset}</span></h2>
      ${
        isEnd &&
        html`<button class="button button--quiet button--icon" aria-label="Close the upload"
          onClick=${app.uploads.dismiss}><${Icon} name="cross" /></button>`
      }
    </header>
    <div class="progress__track" role="progressbar" aria-label="Frames uploaded" aria-valuemin="0"
      aria-valuemax=${total} aria-valuenow=${done}>
      <span class="progress__fill ${refused.length ? "has-refused" : ""}" style=${{ width: `${percent}%` }} />
    </div>
    <p class="upload-panel__text"
      role="status">${isEnd ? outcome(progress) : `${countText(done)} of ${countOf(total, "frame")}`}</p>
    ${trouble && html`<${FailureLine} error=${{ message: trouble }} />`}
    <${FileList} title="Answers set aside"
      items=${setAside.map(({ key, answers, boxes }) => ({
        name: key,
        why: `${countOf(answers, "answer")} on boxes that changed or are gone: ${boxes.join(", ")}`,
      }))} isOpen=${isEnd} />
    <${FileList} title="Refused" items=${refused.map(({ key, why, more }) => ({ name: key, why, more }))}
      isOpen=${isEnd} />
    <footer class="upload-panel__foot">
      ${!isEnd && html`<button class="button" onClick=${uploader.cancel}>Cancel</button>`}
      ${phase === "sending" && html`<button class="button" onClick=${uploader.pause}>Pause</button>`}
      ${
        !isEnd &&
        phase !== "sending" &&
        html`<button class="button button--primary"
          onClick=${uploader.resume}>Resume</button>`
      }
      ${
        phase === "done" &&
        refused.length > 0 &&
        html`<button class="button"
          onClick=${uploader.retry}>Retry refused frames</button>`
      }
      ${
        isEnd &&
        done > refused.length &&
        html`<a class="button button--primary" href=${linkTo("frames", { dataset })}
          onClick=${app.uploads.dismiss}>Open the frames</a>`
      }
    </footer>
  </section>`;
}

/** @param {Progress} progress */
function outcome({ stored, same, refused, setAside }) {
  const parts = [`${countOf(stored, "frame")} stored`];
  if (same) parts.push(`${countText(same)} there already`);
  if (refused.length) parts.push(`${countText(refused.length)} refused`);
  const answers = setAside.reduce((sum, frame) => sum + frame.answers, 0);
  if (answers) parts.push(`${countOf(answers, "answer")} set aside`);
  return parts.join(" · ");
}
