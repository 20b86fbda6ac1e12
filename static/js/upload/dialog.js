// @ts-check
// What the server found in the names and labels, and where it shall go.

import { useLoaded } from "../core/hooks.js";
import { html, useEffect, useMemo, useRef, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf, countText, sizeText } from "../core/numbers.js";
import { Command, FileList, Segments } from "../core/parts.js";
import { LAYOUT_NAMES, layoutsOf, readLayout, visibleEntries } from "./layouts.js";
import { baseOf } from "./matching.js";

/** @typedef {import("./sender.js").UploadApp} App */
/** @typedef {import("./matching.js").Entry} Entry */
/** @typedef {import("./layouts.js").Layout} Layout */
/** @typedef {import("./layouts.js").Plan} Plan */

/** From here on the command line is the better way. */
const MANY_FRAMES = 2000;

const NAME = /^[a-z0-9](?:[a-z0-9._-]{0,98}[a-z0-9])?$/;

const NAME_RULE = "Small letters, digits, dots, dashes and underscores; it begins and ends with a letter or digit.";

/** @param {{app: App, dropped: Promise<Entry[]>}} props */
export function UploadDialog({ app, dropped }) {
  const dialog = useRef(/** @type {HTMLDialogElement | null} */ (null));
  const found = useFound(dropped);
  useEffect(() => dialog.current?.showModal(), []);
  return html`<dialog class="dialog dialog--upload" ref=${dialog} aria-labelledby="upload-title" onClose=${() => app.uploads.dropped.set(null)}>
    <div class="dialog__body">
      <header class="dialog__head">
        <h2 id="upload-title">Upload</h2>
        <button class="button button--quiet button--icon" aria-label="Close" onClick=${() => dialog.current?.close()}><${Icon} name="cross" /></button>
      </header>
      ${found.error && html`<p class="upload__fault" role="alert">${found.error}</p>`}
      ${!found.plan && !found.error && html`<p class="upload__reading" role="status"><span class="spinner" aria-hidden="true"></span>${found.entries ? `Reading labels: ${countText(found.read)}` : "Looking at the files"}</p>`}
      ${found.entries && found.layouts.length === 0 && html`<${NoLayout} entries=${found.entries} />`}
      ${found.plan && html`<${Review} app=${app} found=${found} plan=${found.plan} close=${() => dialog.current?.close()} />`}
    </div>
  </dialog>`;
}

/**
 * @typedef {object} Found
 * @property {Entry[] | null} entries
 * @property {string} top  the name of the one folder, or ""
 * @property {Layout[]} layouts
 * @property {Layout | null} layout
 * @property {Plan | null} plan
 * @property {number} read
 * @property {string} error
 * @property {(layout: Layout) => void} choose
 */

/** @param {Promise<Entry[]>} dropped @returns {Found} */
function useFound(dropped) {
  const [files, setFiles] = useState(/** @type {{entries: Entry[], top: string} | null} */ (null));
  const [chosen, choose] = useState(/** @type {Layout | null} */ (null));
  const [plan, setPlan] = useState(/** @type {Plan | null} */ (null));
  const [read, setRead] = useState(0);
  const [error, setError] = useState("");
  const fail = (/** @type {unknown} */ fault) => setError(fault instanceof Error ? fault.message : String(fault));
  useEffect(() => void dropped.then((all) => setFiles({ entries: visibleEntries(all), top: topOf(all) }), fail), [dropped]);
  const layouts = useMemo(() => layoutsOf(files?.entries ?? []), [files]);
  const layout = chosen ?? layouts[0] ?? null;
  useEffect(() => {
    if (!files || !layout) return;
    let isCurrent = true;
    let count = 0;
    setPlan(null);
    setError("");
    const tick = () => void (++count % 50 === 0 && isCurrent && setRead(count));
    readLayout(files.entries, layout, tick).then((next) => isCurrent && setPlan(next), (fault) => isCurrent && fail(fault));
    return () => void (isCurrent = false);
  }, [files, layout]);
  return { entries: files?.entries ?? null, top: files?.top ?? "", layouts, layout, plan, read, error, choose };
}

/** @param {readonly Entry[]} entries */
const topOf = (entries) => (entries[0]?.path.includes("/") ? (entries[0].path.split("/")[0] ?? "") : "");

/** @param {{entries: readonly Entry[]}} props */
function NoLayout({ entries }) {
  return html`<p role="alert">${entries.length ? `None of these ${countText(entries.length)} files is an image, a label or a manifest.` : "There is nothing in it."}</p>
    <p class="faint">Expected a manifest.jsonl, a carlasimu folder, YOLO labels with a data.yaml or classes.txt, Pascal VOC, or images with their segmentations. KITTI and COCO: use <code>unghost push</code>.</p>`;
}

/** @param {{app: App, found: Found, plan: Plan, close: () => void}} props */
function Review({ app, found, plan, close }) {
  const datasets = useLoaded(app, (signal) => app.api.datasets({ limit: 500 }, signal), []);
  const known = datasets.value?.items ?? [];
  // Until then nobody knows whether the name is that of a dataset which is there.
  const isKnown = datasets.state !== "loading";
  const [name, setName] = useState(() => app.head.get().dataset || slugOf(found.top));
  const [lossy, setLossy] = useState(false);
  const [replace, setReplace] = useState(false);
  const [refusal, setRefusal] = useState("");
  const [isBusy, setBusy] = useState(false);
  const field = useRef(/** @type {HTMLInputElement | null} */ (null));
  useEffect(() => field.current?.focus(), []);
  const there = known.find((dataset) => dataset.name === name);
  const count = plan.frames.length;

  /** @param {SubmitEvent} event */
  const submit = async (event) => {
    event.preventDefault();
    if (!NAME.test(name)) return setRefusal(name ? NAME_RULE : "Give the dataset a name.");
    setBusy(true);
    /** @type {Record<string, string>} */
    const reading = lossy ? { lossy_segmentation: "nearest" } : {};
    const order = { dataset: name, isNew: !there, classes: plan.classes, reading, frames: plan.frames, replace };
    return app.uploads.start(order).then(close, (error) => {
      app.notice(error);
      setRefusal(error.message);
      setBusy(false);
    });
  };

  return html`<form class="upload" onSubmit=${submit} novalidate>
    ${found.layouts.length > 1 && html`<${Segments} label="Layout" value=${plan.layout} choices=${found.layouts.map((value) => ({ value, text: LAYOUT_NAMES[value] }))} onChange=${found.choose} />`}
    <p class="upload__sum"><b>${LAYOUT_NAMES[plan.layout]}</b> · ${summary(plan)}</p>
    ${count > 0 && html`<${PlanTable} plan=${plan} />`}
    <label class="field">
      <span>Dataset</span>
      <input ref=${field} name="dataset" list="upload-datasets" value=${name} spellcheck=${false} autocomplete="off" maxlength="100" aria-invalid=${refusal !== ""} aria-describedby="upload-where upload-error"
        onInput=${(/** @type {{currentTarget: HTMLInputElement}} */ event) => (setName(event.currentTarget.value.trim()), setRefusal(""))} />
      <datalist id="upload-datasets">${known.map((dataset) => html`<option value=${dataset.name} />`)}</datalist>
    </label>
    <p id="upload-where" class="faint">${!isKnown ? "Looking which datasets there are …" : there ? `Adds to a dataset that has ${countOf(there.counts.frames, "frame")}. What is there already is not stored twice.` : "A new dataset is made."}</p>
    <p id="upload-error" class="field__error" role="alert">${refusal}</p>
    ${there
      ? html`<label class="switch"><input type="checkbox" checked=${replace} onChange=${() => setReplace(!replace)} /><span>Replace frames whose content has changed</span></label>`
      : html`<label class="switch"><input type="checkbox" checked=${lossy} onChange=${() => setLossy(!lossy)} /><span>Take JPEG segmentations, by the nearest colour</span></label>`}
    <${Hints} plan=${plan} name=${name} top=${found.top} />
    <${FileList} title="Cannot be read" items=${plan.problems.map(({ key, why }) => ({ name: key, why: withoutName(why, key) }))} isOpen=${true} />
    <${FileList} title="Did not match" items=${plan.unmatched.map(({ path, why }) => ({ name: path, why }))} isOpen=${plan.frames.length === 0} />
    <footer class="dialog__foot">
      <button type="button" class="button" onClick=${close}>Cancel</button>
      <button class="button button--primary" disabled=${isBusy || !isKnown || count === 0}>${count === 0 ? "Nothing to upload" : `Upload ${countOf(count, "frame")}`}</button>
    </footer>
  </form>`;
}

/** @param {{plan: Plan, name: string, top: string}} props */
function Hints({ plan, name, top }) {
  const bare = plan.frames.filter(({ files }) => !files.segmentation).length;
  const empty = plan.frames.filter(({ annotation }) => !(/** @type {unknown[]} */ (annotation.boxes)?.length)).length;
  const command = `unghost push ${top || "FOLDER"} --dataset ${name || "NAME"}`;
  return html`
    ${bare > 0 && html`<p class="upload__hint"><${Icon} name="warn" />${countOf(bare, "frame")} without a segmentation: nothing can be measured there, the boxes will be unmeasured.</p>`}
    ${empty > 0 && html`<p class="upload__hint"><${Icon} name="warn" />${countOf(empty, "frame")} without a box.</p>`}
    ${plan.frames.length > MANY_FRAMES && html`<p class="upload__hint"><${Icon} name="warn" />For this many frames the command line is faster, and goes on where it stopped:</p><${Command} text=${command} />`}`;
}

/** @param {Plan} plan */
function summary({ frames }) {
  const boxes = frames.reduce((sum, { annotation }) => sum + (/** @type {unknown[]} */ (annotation.boxes)?.length ?? 0), 0);
  const files = frames.flatMap((frame) => Object.values(frame.files));
  return [countOf(frames.length, "frame"), countOf(boxes, "box", "boxes"), sizeText(files.reduce((sum, { size }) => sum + size, 0))].join(" · ");
}

/** A fault that names its place says it once. @param {string} why @param {string} name */
const withoutName = (why, name) => (why.startsWith(`${name}: `) ? why.slice(name.length + 2) : why);

/** @param {string} text */
const slugOf = (text) => text.toLowerCase().replace(/[^a-z0-9._-]+/g, "-").replace(/^[^a-z0-9]+|[^a-z0-9]+$/g, "").slice(0, 100);

const MOST_ROWS = 4;

/** The first frames, as they will be sent. @param {{plan: import("./layouts.js").Plan}} props */
export function PlanTable({ plan }) {
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

/** @param {{entry: import("./matching.js").Entry | undefined}} props */
const Cell = ({ entry }) => (entry ? html`<td title=${entry.path}>${baseOf(entry.path)}</td>` : html`<td class="faint">none</td>`);
