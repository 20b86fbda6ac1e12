// @ts-check
// The content of the upload dialog: what the server found in the dropped files, and the dataset that they are uploaded to.

import { ApiError } from "../core/api.js";
import { useDatasets, useLoaded, useTask } from "../core/hooks.js";
import { html, useEffect, useRef, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf, countText, sizeText } from "../core/numbers.js";
import { Command, FailureLine, FileList, Segments } from "../core/parts.js";
import { hasImages, readFolder, topOf, visibleEntries } from "./folder.js";

/** @typedef {import("./uploader.js").UploadApp} App */
/** @typedef {import("./folder.js").Entry} Entry */
/** @typedef {import("./folder.js").Plan} Plan */
/** @typedef {import("./folder.js").Reading} Reading */

/** With more frames than this, the dialog recommends the command line. */
const MANY_FRAMES = 2000;

/** The names that a dataset may have. */
export const DATASET_NAME = /^[a-z0-9](?:[a-z0-9._-]{0,98}[a-z0-9])?$/;

const NAME_RULE = "Use small letters, digits, dots, dashes and underscores; begin and end with a letter or digit.";

/** @param {{app: App, dropped: Promise<Entry[]>, close: () => void}} props */
export function FoundFiles({ app, dropped, close }) {
  const found = useFound(dropped);
  const { plan, error } = found;
  /** What was typed stays when the files are read as another layout. */
  const [typed, setTyped] = useState(/** @type {string | null} */ (null));
  if (error) return html`<${NotRead} found=${found} error=${error} close=${close} />`;
  if (plan) return html`<${Review} app=${app} found=${found} plan=${plan} typed=${typed} setTyped=${setTyped} close=${close} />`;
  return html`<${Progress} found=${found} close=${close} />`;
}

/**
 * @typedef {object} Found
 * @property {readonly Entry[] | null} entries
 * @property {string} top  the name of the one folder, or ""
 * @property {Plan | null} plan
 * @property {Reading | null} reading
 * @property {Error | null} error
 * @property {(layout: import("./folder.js").Layout) => void} read  read the files again, as this layout
 * @property {() => void} retry
 */

/** @param {Promise<Entry[]>} dropped @returns {Found} */
function useFound(dropped) {
  const [layout, setLayout] = useState(/** @type {import("./folder.js").Layout} */ ("auto"));
  const [reading, setReading] = useState(/** @type {Reading | null} */ (null));
  const { value: entries, error: notListed } = useLoaded(() => dropped.then(listed), [dropped]);
  const read = useLoaded(
    async (signal) => entries && readFolder(entries, layout, signal, (now) => signal.aborted || setReading(now)),
    [entries, layout],
  );
  return {
    entries,
    top: entries ? topOf(entries) : "",
    plan: read.state === "ready" ? read.value : null,
    reading,
    error: notListed ?? read.error,
    read(next) {
      setLayout(next);
      read.reload();
    },
    retry: read.reload,
  };
}

/** @param {readonly Entry[]} all */
function listed(all) {
  const entries = visibleEntries(all);
  if (entries.length === 0) throw new Error("There are no files in it.");
  return entries;
}

/** @param {{found: Found, close: () => void}} props */
function Progress({ found: { entries, reading }, close }) {
  const share = reading?.of ? Math.floor((100 * reading.done) / reading.of) : null;
  return html`<p class="upload__reading" role="status"><span class="spinner" aria-hidden="true"></span>${progressText(entries, reading)}</p>
    ${share !== null && html`<div class="progress__track" role="progressbar" aria-label="Read" aria-valuemin="0" aria-valuemax="100" aria-valuenow=${share}><span class="progress__fill" style=${{ width: `${share}%` }} /></div>`}
    <footer class="dialog__foot"><button type="button" class="button" onClick=${close}>Cancel</button></footer>`;
}

/** @param {readonly Entry[] | null} entries @param {Reading | null} reading */
function progressText(entries, reading) {
  if (!entries || !reading) return "Listing the files";
  const files = countOf(entries.length, "file");
  if (reading.step === "labels") return `Collecting the labels of ${files}`;
  if (reading.step === "waiting") return `The server is reading ${files}; nothing is stored yet`;
  return `${countOf(reading.done, "frame")} found`;
}

/** Why the files could not be read, and what to do about it. @param {{found: Found, error: Error, close: () => void}} props */
function NotRead({ found: { entries, top, read, retry }, error, close }) {
  const isUnknown = error instanceof ApiError && error.problem.code === "bad_layout";
  const isTooLarge = error instanceof ApiError && error.status === 413;
  return html`<div class="upload">
    <${FailureLine} error=${isUnknown ? { message: `No frames were recognised in ${entries?.length === 1 ? "this file" : `these ${countOf(entries?.length ?? 0, "file")}`}.` } : error} />
    ${isUnknown && html`<p class="faint">${error.message}</p>`}
    ${isTooLarge && html`<p>The command line takes folders of any size:</p><${Command} text=${commandOf(top, "")} />`}
    <footer class="dialog__foot">
      <button type="button" class="button" onClick=${close}>Cancel</button>
      ${isUnknown && hasImages(entries ?? []) && html`<button type="button" class="button button--primary" onClick=${() => read("pairs")}>Upload the images only</button>`}
      ${entries && !isUnknown && html`<button type="button" class="button button--primary" onClick=${retry}>Try again</button>`}
    </footer>
  </div>`;
}

/** @param {string} top @param {string} name */
const commandOf = (top, name) => `unghost push ${top || "FOLDER"} --dataset ${name || "NAME"}`;

/** @param {{app: App, found: Found, plan: Plan, typed: string | null, setTyped: (name: string) => void, close: () => void}} props */
function Review({ app, found, plan, typed, setTyped, close }) {
  const datasets = useDatasets();
  const known = datasets.value?.items ?? [];
  // Until the list is loaded it is not known whether a dataset of this name exists.
  const isKnown = datasets.value !== null;
  const name = typed ?? (app.topBar.get().dataset || slugOf(found.top));
  const [lossy, setLossy] = useState(false);
  const [replace, setReplace] = useState(false);
  /** What is wrong with the name. */
  const [fault, setFault] = useState("");
  const field = useRef(/** @type {HTMLInputElement | null} */ (null));
  useEffect(() => field.current?.focus(), []);
  const there = known.find((dataset) => dataset.name === name);
  const count = plan.frames.length;

  const { run: start, isBusy, error } = useTask(async () => {
    const described = /** @type {import("./uploader.js").Order["reading"]} */ (plan.settings);
    /** @type {import("./uploader.js").Order["reading"]} */
    const reading = lossy ? { ...described, lossy_segmentation: "nearest" } : described;
    const { classes, config, frames } = plan;
    await app.uploads.start({ dataset: name, isNew: !there, classes, reading, config, frames, replace });
    close();
  });
  /** @param {SubmitEvent} event */
  const submit = (event) => {
    event.preventDefault();
    if (DATASET_NAME.test(name)) void start();
    else setFault(name ? NAME_RULE : "Give the dataset a name.");
  };

  return html`<form class="upload" onSubmit=${submit} novalidate>
    ${plan.layouts.length > 1 && html`<${Segments} label="Layout" value=${plan.layout} choices=${plan.layouts.map((value) => ({ value, text: plan.titles[value] ?? value }))} onChange=${found.read} />`}
    <p class="upload__sum"><b>${plan.titles[plan.layout] ?? plan.layout}</b> · ${summary(plan)}</p>
    ${count > 0 && html`<${PlanTable} plan=${plan} />`}
    <label class="field">
      <span>Dataset</span>
      <input ref=${field} name="dataset" list="upload-datasets" value=${name} spellcheck=${false} autocomplete="off" maxlength="100" aria-invalid=${fault !== ""} aria-describedby="upload-where upload-error"
        onInput=${(/** @type {{currentTarget: HTMLInputElement}} */ event) => (setTyped(event.currentTarget.value.trim()), setFault(""))} />
      <datalist id="upload-datasets">${known.map((dataset) => html`<option value=${dataset.name} />`)}</datalist>
    </label>
    ${datasets.error
      ? html`<${FailureLine} what="List of datasets" error=${datasets.error} onRetry=${datasets.reload} />`
      : html`<p id="upload-where" class="faint">${!isKnown ? "Loading the list of datasets …" : there ? `Adds to a dataset that has ${countOf(there.counts.frames, "frame")}. Frames that are already stored are not stored again.` : "A new dataset will be created."}</p>`}
    <p id="upload-error" class="field__error" role="alert">${fault}</p>
    ${there
      ? html`<label class="switch"><input type="checkbox" checked=${replace} onChange=${() => setReplace(!replace)} /><span>Replace frames whose content has changed; answers on boxes that changed are set aside</span></label>`
      : html`<label class="switch"><input type="checkbox" checked=${lossy} onChange=${() => setLossy(!lossy)} /><span>Accept JPEG segmentations; match each pixel to the nearest colour</span></label>`}
    <${Hints} plan=${plan} name=${name} top=${found.top} isThere=${Boolean(there)} />
    <${FileList} title="Cannot be read" items=${plan.problems.map(({ key, why }) => ({ name: key, why: withoutName(why, key) }))} isOpen=${true} />
    <${FileList} title="Did not match" items=${plan.unmatched.map(({ path, why }) => ({ name: path, why }))} isOpen=${plan.frames.length === 0} />
    ${error && html`<${FailureLine} error=${error} />`}
    <footer class="dialog__foot">
      <button type="button" class="button" onClick=${close}>Cancel</button>
      <button class="button button--primary" disabled=${isBusy || !isKnown || count === 0}>${count === 0 ? "Nothing to upload" : `Upload ${countOf(count, "frame")}`}</button>
    </footer>
  </form>`;
}

/** @param {{plan: Plan, name: string, top: string, isThere: boolean}} props */
function Hints({ plan, name, top, isThere }) {
  const bare = plan.frames.filter(({ files }) => !files.segmentation).length;
  const keys = Object.keys(plan.config).join(" and ");
  const empty = plan.frames.filter(({ annotation }) => !(/** @type {unknown[]} */ (annotation.boxes)?.length)).length;
  return html`
    ${plan.notes.map((note) => html`<p class="upload__hint" key=${note}><${Icon} name="warn" />${note}</p>`)}
    ${bare > 0 && html`<p class="upload__hint"><${Icon} name="warn" />${countOf(bare, "frame")} without a segmentation: their boxes cannot be measured and will be "unmeasured".</p>`}
    ${empty > 0 && html`<p class="upload__hint"><${Icon} name="warn" />${countOf(empty, "frame")} without boxes.</p>`}
    ${keys && isThere && html`<p class="upload__hint">
      <${Icon} name="warn" />recording.yaml also gives ${keys}: the page gives them to new datasets only; this one
      keeps its configuration.
    </p>`}
    ${plan.frames.length > MANY_FRAMES && html`<p class="upload__hint"><${Icon} name="warn" />For this many frames the command line is faster, and resumes where it stopped:</p><${Command} text=${commandOf(top, name)} />`}`;
}

/** @param {Plan} plan */
function summary({ frames }) {
  const boxes = frames.reduce((sum, { annotation }) => sum + (/** @type {unknown[]} */ (annotation.boxes)?.length ?? 0), 0);
  const files = frames.flatMap((frame) => Object.values(frame.files));
  return [countOf(frames.length, "frame"), countOf(boxes, "box", "boxes"), sizeText(files.reduce((sum, { size }) => sum + size, 0))].join(" · ");
}

/** A problem without the name of its frame, which the list shows already. @param {string} why @param {string} name */
const withoutName = (why, name) => (why.startsWith(`${name}: `) ? why.slice(name.length + 2) : why);

/** @param {string} text */
const slugOf = (text) => text.toLowerCase().replace(/[^a-z0-9._-]+/g, "-").replace(/^[^a-z0-9]+|[^a-z0-9]+$/g, "").slice(0, 100);

const MOST_ROWS = 4;

/** The first frames, as they will be sent. @param {{plan: import("./folder.js").Plan}} props */
function PlanTable({ plan }) {
  const rest = plan.frames.length - MOST_ROWS;
  return html`<div class="upload__table"><table>
    <thead><tr><th scope="col">Frame</th><th scope="col">Image</th><th scope="col">Segmentation</th><th scope="col" class="is-number">Boxes</th></tr></thead>
    <tbody>
      ${plan.frames.slice(0, MOST_ROWS).map(
        ({ key, files, annotation }) => html`<tr key=${key}>
          <td title=${key}>${key}</td><${Cell} entry=${files.image} /><${Cell} entry=${files.segmentation} />
          <td class="is-number">${/** @type {unknown[]} */ (annotation.boxes)?.length ?? 0}</td>
        </tr>`,
      )}
      ${rest > 0 && html`<tr><td class="faint" colspan="4">and ${countText(rest)} more</td></tr>`}
    </tbody>
  </table></div>`;
}

/** @param {{entry: import("./folder.js").Entry | undefined}} props */
const Cell = ({ entry }) => (entry ? html`<td title=${entry.path}>${entry.path.slice(entry.path.lastIndexOf("/") + 1)}</td>` : html`<td class="faint">none</td>`);
