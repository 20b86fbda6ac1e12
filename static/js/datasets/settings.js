// @ts-check
// How segmentations are read, what was refused, the end of a dataset.

import { datasetCalls } from "../core/api.js";
import { useLoaded, useValue } from "../core/hooks.js";
import { html, useEffect, useRef, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf } from "../core/numbers.js";
import { FileList } from "../core/parts.js";
import { linkTo } from "../core/router.js";

/** @typedef {import("../core/app.js").App} App */
/** @typedef {import("../core/types.js").Dataset} Dataset */

/** How segmentations are read; a change measures every frame again. */
const READING = /** @type {const} */ ([
  { key: "palette", text: "Palette", values: ["auto", "carla-0.9.0", "carla-0.9.10", "carla-0.9.14", "paper-table1"] },
  { key: "encoding", text: "Encoding", values: ["auto", "palette", "raw"] },
  { key: "channel_order", text: "Channel order", values: ["auto", "rgb", "bgr"] },
  { key: "lossy_segmentation", text: "JPEG segmentations", values: ["refuse", "nearest"] },
]);

/** @param {{app: App, dataset: Dataset, onClose: () => void, onChanged: () => void}} props */
export function DatasetDialog({ app, dataset, onClose, onChanged }) {
  const dialog = useRef(/** @type {HTMLDialogElement | null} */ (null));
  useEffect(() => dialog.current?.showModal(), []);
  const close = () => dialog.current?.close();
  return html`<dialog class="dialog dialog--upload" ref=${dialog} aria-labelledby="dataset-title" onClose=${onClose}>
    <div class="dialog__body settings">
      <header class="dialog__head">
        <h2 id="dataset-title">${dataset.name}</h2>
        <button class="button button--quiet button--icon" aria-label="Close" onClick=${close}><${Icon} name="cross" /></button>
      </header>
      <${Problems} app=${app} dataset=${dataset} />
      <${Reading} app=${app} dataset=${dataset} onDone=${() => (onChanged(), close())} />
      <${Removal} app=${app} dataset=${dataset} />
    </div>
  </dialog>`;
}

/** Frames that were refused and have not come in since. @param {{app: App, dataset: Dataset}} props */
function Problems({ app, dataset }) {
  const loaded = useLoaded(app, (signal) => datasetCalls.problems(dataset.name, signal), [dataset.name]);
  if (loaded.state === "error") return html`<p class="upload__fault" role="alert">${loaded.error.message}</p>`;
  const items = (loaded.value?.items ?? []).map(({ key, error }) => ({ name: key, why: error.detail ?? error.title ?? "refused" }));
  if (loaded.value && items.length === 0) return html`<p class="faint">No frame was refused.</p>`;
  return html`<${FileList} title="Refused frames" items=${items} isOpen=${true} />`;
}

/** @param {{app: App, dataset: Dataset, onDone: () => void}} props */
function Reading({ app, dataset, onDone }) {
  const [error, setError] = useState("");
  /** @param {SubmitEvent & {currentTarget: HTMLFormElement}} event */
  const submit = async (event) => {
    event.preventDefault();
    const given = [...new FormData(event.currentTarget)].map(([key, value]) => [key, String(value)]);
    const changes = Object.fromEntries(given.filter(([key = "", value]) => /** @type {any} */ (dataset)[key] !== value));
    if (Object.keys(changes).length === 0) return onDone();
    try {
      const isMeasured = await datasetCalls.change(dataset.name, changes);
      app.toasts.show(isMeasured ? "Every frame is measured again." : "Saved.", isMeasured ? { action: { text: "Show the run", href: linkTo("runs", { dataset: dataset.name }) } } : {});
      return onDone();
    } catch (fault) {
      app.notice(fault);
      return setError(fault instanceof Error ? fault.message : String(fault));
    }
  };
  return html`<form class="upload" onSubmit=${submit}>
    <label class="field"><span>Description</span><textarea name="description" rows="2" maxlength="2000" defaultValue=${dataset.description}>${dataset.description}</textarea></label>
    <div class="settings__grid">
      ${READING.map(
        ({ key, text, values }) => html`<label class="field"><span>${text}</span>
          <select name=${key}>${values.map((value) => html`<option value=${value} selected=${dataset[key] === value}>${value}</option>`)}</select>
        </label>`,
      )}
    </div>
    <p class="faint">A change in how segmentations are read measures ${countOf(dataset.counts.frames, "frame")} again; answers stay.</p>
    <p class="field__error" role="alert">${error}</p>
    <div><button class="button button--primary">Save</button></div>
  </form>`;
}

/** Only for admins, and only with the name typed. @param {{app: App, dataset: Dataset}} props */
function Removal({ app, dataset }) {
  const person = useValue(app.person);
  const [typed, setTyped] = useState("");
  const [error, setError] = useState("");
  if (person?.role !== "admin") return null;
  const remove = () =>
    datasetCalls.remove(dataset.name).then(
      () => (app.toasts.show(`${dataset.name} is deleted.`), app.router.go(linkTo("datasets"))),
      (/** @type {Error} */ fault) => (app.notice(fault), setError(fault.message)),
    );
  return html`<details class="settings__end">
    <summary>Delete this dataset</summary>
    <p>Its frames, boxes and all answers are gone for good. Type <b>${dataset.name}</b> to go on.</p>
    <div class="settings__confirm">
      <label class="field"><span class="sr-only">Name of the dataset</span><input value=${typed} autocomplete="off" spellcheck=${false} onInput=${(/** @type {{currentTarget: HTMLInputElement}} */ event) => setTyped(event.currentTarget.value)} /></label>
      <button class="button button--danger" disabled=${typed !== dataset.name} onClick=${remove}>Delete</button>
    </div>
    <p class="field__error" role="alert">${error}</p>
  </details>`;
}
