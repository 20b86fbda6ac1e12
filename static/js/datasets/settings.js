// @ts-check
// The dialog of a dataset's settings: refused frames, what can be changed, deleting the dataset.

import { get, patch, remove } from "../core/api.js";
import { Control, useFields } from "../core/form.js";
import { useLoaded, useTask, useValue } from "../core/hooks.js";
import { html, useState } from "../core/html.js";
import { countOf } from "../core/numbers.js";
import { Dialog, FailureLine, FileList, RecordingDownload, useDialog } from "../core/parts.js";
import { linkTo } from "../core/router.js";

/** @import { App } from "../core/app.js" */
/** @import { Field, Words } from "../core/form.js" */
/** @import { Dataset } from "../core/openapi.js" */

/** @type {Words} */
const WORDS = { fields: { lossy_segmentation: "JPEG segmentations" } };

/** @param {{app: App, dataset: Dataset, onClose: () => void, onChanged: () => void}} props */
export function DatasetDialog({ app, dataset, onClose, onChanged }) {
  const dialog = useDialog();
  // JSON is YAML, too.
  const recording = dataset.recording && `${JSON.stringify(dataset.recording, null, 2)}\n`;
  return html`<${Dialog} dialog=${dialog} id="dataset-title" title=${dataset.name} kind="upload" onClose=${onClose}>
    <div class="settings">
      <${Problems} app=${app} dataset=${dataset} />
      ${
        recording &&
        html`<${RecordingDownload} text=${recording}
          about="How the folder of these frames was read; beside the data, it lets every command read it like this." />`
      }
      <${Changes} app=${app} dataset=${dataset} onDone=${() => (onChanged(), dialog.close())} />
      <${Removal} app=${app} dataset=${dataset} />
    </div>
  <//>`;
}

/**
 * Frames that were refused and have not been uploaded successfully since.
 * @param {{app: App, dataset: Dataset}} props
 */
function Problems({ app, dataset }) {
  const loaded = useLoaded(
    (signal) =>
      get("/api/v1/datasets/{dataset}/problems", { path: { dataset: dataset.name }, query: { limit: 200 }, signal }),
    [dataset.name],
  );
  if (loaded.state === "error")
    return html`<${FailureLine} what="Refused frames" error=${loaded.error} onRetry=${loaded.reload} />`;
  const items = (loaded.value?.items ?? []).map(({ key, error }) => ({ name: key, why: error.detail }));
  if (loaded.value && items.length === 0) return html`<p class="faint">No frame was refused.</p>`;
  // The counts may be older than the list.
  const total = loaded.value?.next_cursor ? Math.max(dataset.counts.problems, items.length) : items.length;
  return html`<${FileList} title="Refused frames" items=${items} total=${total} isOpen=${true} />`;
}

/**
 * What can be changed of a dataset: its description, and how its segmentations are read.
 * @param {{app: App, dataset: Dataset, onDone: () => void}} props
 */
function Changes({ app, dataset, onDone }) {
  const fields = useFields("DatasetPatch", WORDS);
  const [chosen, setChosen] = useState(/** @type {Record<string, any>} */ ({}));
  /** @type {Readonly<Record<string, unknown>>} */
  const stored = dataset;
  const { run, isBusy, error } = useTask(async () => {
    const body = Object.fromEntries(Object.entries(chosen).filter(([key, value]) => stored[key] !== value));
    if (Object.keys(body).length === 0) return onDone();
    const changed = await patch("/api/v1/datasets/{dataset}", { path: { dataset: dataset.name }, body });
    // The answer is a run where every frame is measured again.
    if ("state" in changed)
      app.toasts.show("All frames are being measured again.", {
        action: { text: "Show the run", href: linkTo("runs", { dataset: dataset.name }) },
      });
    else app.toasts.show("Saved.");
    return onDone();
  });
  /** @param {SubmitEvent} event */
  const submit = (event) => {
    event.preventDefault();
    void run();
  };
  /** @param {Field} field */
  const ask = (field) => html`<label class="field" title=${field.help}><span>${field.text}</span>
    <${Control} field=${field} value=${chosen[field.key] ?? stored[field.key]}
      onChange=${(/** @type {unknown} */ value) => setChosen({ ...chosen, [field.key]: value })} /></label>`;
  if (fields.state === "error")
    return html`<${FailureLine} what="Settings" error=${fields.error} onRetry=${fields.reload} />`;
  if (!fields.value) return html`<div class="skeleton skeleton--tall shimmer"></div>`;
  return html`<form class="upload" onSubmit=${submit}>
    ${fields.value.filter(({ kind }) => kind === "text").map(ask)}
    <div class="settings__grid">${fields.value.filter(({ kind }) => kind !== "text").map(ask)}</div>
    <p class="faint">If you change how segmentations are read,
      ${" "}${countOf(dataset.counts.frames, "frame")} will be measured again. Answers are kept. What classes are
      measured as, tags, evidence and profile are changed in the
      ${" "}<a href=${linkTo("thresholds", { dataset: dataset.name })}>configuration</a>.</p>
    ${error && html`<${FailureLine} error=${error} />`}
    <div><button class="button button--primary" disabled=${isBusy}>Save</button></div>
  </form>`;
}

/** Only for admins, and only with the name typed. @param {{app: App, dataset: Dataset}} props */
function Removal({ app, dataset }) {
  const person = useValue(app.person);
  const [typed, setTyped] = useState("");
  const { run, isBusy, error } = useTask(async () => {
    await remove("/api/v1/datasets/{dataset}", { path: { dataset: dataset.name }, query: { confirm: dataset.name } });
    app.toasts.show(`${dataset.name} was deleted.`);
    app.router.go(linkTo("datasets"));
  });
  if (person?.role !== "admin") return null;
  return html`<details class="settings__end">
    <summary>Delete this dataset</summary>
    <p>Its frames, boxes and all answers will be deleted permanently. Type <b>${dataset.name}</b> to confirm.</p>
    <div class="settings__confirm">
      <label class="field"><span class="sr-only">Name of the dataset</span>
        <input value=${typed} autocomplete="off" spellcheck=${false}
          onInput=${(/** @type {{currentTarget: HTMLInputElement}} */ event) => setTyped(event.currentTarget.value)} />
      </label>
      <button class="button button--danger" disabled=${isBusy || typed !== dataset.name} onClick=${run}>Delete</button>
    </div>
    ${error && html`<${FailureLine} error=${error} />`}
  </details>`;
}
