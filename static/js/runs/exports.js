// @ts-check
// Exports: start, follow, download; texts for options. Those for formats come from the API.

import { get, post, remove } from "../core/api.js";
import { AskField, describeApi, fieldsOf, optionsOf } from "../core/form.js";
import { useLoaded, useNewest, useTask } from "../core/hooks.js";
import { html, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { agoText, countOf, countText, sizeText } from "../core/numbers.js";
import { Dialog, FailureLine, Older, WideTable, numeric, useCopy, useDialog } from "../core/parts.js";
import { Canceller, JobBar, StateBadge, isOver, percentDone, useLookAgain } from "../jobs/job.js";

/** @import { App } from "../core/app.js" */
/** @import { Field, Schema, Words } from "../core/form.js" */
/** @import { Export } from "../core/openapi.js" */
/** @typedef {Export["format"]} Format */
/**
 * `options`: the keys of the options that a format has; it refuses any other.
 * @typedef {{formats: {value: Format, text: string, help: string, options: readonly string[]}[], fields: Field[]}}
 *   ExportForm
 */

/** How many exports are shown at first. */
const NEWEST = 50;

/** @param {{app: App, dataset: string}} props */
export function Exports({ app, dataset }) {
  const loaded = useNewest(
    NEWEST,
    (query, signal) => get("/api/v1/datasets/{dataset}/exports", { path: { dataset }, query, signal }),
    [dataset],
  );
  const form = useLoaded(async () => exportForm(await describeApi()), []);
  const [isAsking, setAsking] = useState(false);
  const [leaving, setLeaving] = useState(/** @type {Export | null} */ (null));
  const items = loaded.value?.items;
  useLookAgain(loaded, items ?? []);
  const onMade = () => {
    setAsking(false);
    loaded.reload();
  };
  return html`<section class="panelbox" aria-labelledby="exports-title">
    <header class="panelbox__head">
      <h2 id="exports-title">Exports</h2>
      <span class="panelbox__tools">
        <button class="button button--primary" aria-expanded=${isAsking}
          onClick=${() => setAsking(!isAsking)}><${Icon} name="plus" />New export</button></span>
    </header>
    ${
      isAsking &&
      form.value &&
      html`<${ExportAsk} dataset=${dataset} form=${form.value} onMade=${onMade} onClose=${() => setAsking(false)} />`
    }
    ${isAsking && form.error && html`<${FailureLine} error=${form.error} onRetry=${form.reload} />`}
    ${loaded.error && !items && html`<${FailureLine} error=${loaded.error} onRetry=${loaded.reload} />`}
    ${
      items?.length === 0 &&
      !isAsking &&
      html`<p class="panelbox__empty">
        No export yet. Exports use people's answers, or the filter's verdict where there is none.
      </p>`
    }
    <ul class="runs">
      ${items?.map(
        (one) => html`<li key=${one.id}>
          <${ExportRow} app=${app} item=${one} form=${form.value} onDelete=${() => setLeaving(one)} />
        </li>`,
      )}
    </ul>
    ${
      leaving &&
      html`<${DeleteDialog} item=${leaving} form=${form.value}
        onClose=${() => setLeaving(null)} onDeleted=${loaded.reload} />`
    }
    <${Older} what="exports" onShow=${loaded.showOlder} />
  </section>`;
}

/**
 * Asks before an export is deleted.
 * @param {{item: Export, form: ExportForm | null | undefined, onClose: () => void, onDeleted: () => void}} props
 */
function DeleteDialog({ item, form, onClose, onDeleted }) {
  const dialog = useDialog();
  const { run, isBusy, error } = useTask(async () => {
    await remove("/api/v1/exports/{export_id}", { path: { export_id: item.id } });
    onDeleted();
    dialog.close();
  });
  const title = `Delete export ${item.id} (${formatText(item.format, form)})?`;
  const file = item.download ? `Its file of ${sizeText(item.size_bytes)} is deleted, too. ` : "";
  return html`<${Dialog} dialog=${dialog} id="delete-title" title=${title} isLight=${true} onClose=${onClose}>
    ${error && html`<${FailureLine} error=${error} />`}
    <p>${file}A new export has the boxes and answers as they are then.</p>
    <footer class="dialog__foot">
      <button class="button" onClick=${dialog.close}>Keep</button>
      <button class="button button--primary" disabled=${isBusy} onClick=${run}>Delete</button>
    </footer>
  <//>`;
}

/** @param {{app: App, item: Export, form: ExportForm | null | undefined, onDelete: () => void}} props */
function ExportRow({ app, item, form, onDelete }) {
  const about = optionsText(item.options, form ? fieldsFor(item.format, form) : []);
  // By a link, so that a large file does not pass through the page's memory.
  const { run, isBusy } = useTask(async () => {
    const { url } = await post("/api/v1/exports/{export_id}/download-links", { path: { export_id: item.id } });
    Object.assign(document.createElement("a"), { href: url, download: "" }).click();
  }, app.toasts.fail);
  return html`<article class="run" aria-label=${`Export ${item.id}`}>
    <div class="run__what"><span class="run__name">${formatText(item.format, form)}</span>
      <${StateBadge} state=${item.state} /></div>
    <p class="run__about faint">Export ${item.id} · ${agoText(item.created_at)}${about && ` · ${about}`}</p>
    <div class="run__how">
      ${
        !isOver(item) &&
        html`<${JobBar} job=${item} label=${`Export ${item.id}`} />
        <p class="faint num">
          ${
            item.total
              ? `${countText(item.done ?? 0)} of ${countOf(item.total, "frame")}, ${percentDone(item)} %`
              : "being written"
          }</p>`
      }
      ${item.state === "cancelled" && html`<p class="faint">Stopped; nothing was written.</p>`}
      ${item.state === "failed" && html`<p class="run__error"><strong>Failed.</strong> ${item.error?.detail ?? ""}</p>`}
      ${
        item.state === "done" &&
        html`<${ExportCounts} counts=${item.counts ?? {}} />
        ${
          item.sha256
            ? html`<${Sum} sum=${item.sha256} />`
            : html`<p class="faint">No file: ${item.error?.detail ?? "it was deleted"}.</p>`
        }`
      }
    </div>
    <div class="run__actions">
      ${
        !isOver(item) &&
        html`<${Canceller} app=${app} what=${`export ${item.id}`}
          cancel=${() => post("/api/v1/exports/{export_id}/cancel", { path: { export_id: item.id } })} />`
      }
      ${
        item.download &&
        html`<button class="button button--small" disabled=${isBusy}
          onClick=${run}><${Icon} name="download" /><span class="sr-only">Download export ${item.id}, </span>
          ${sizeText(item.size_bytes)}</button>`
      }
      ${
        isOver(item) &&
        html`<button class="button button--small" onClick=${onDelete}>
          Delete<span class="sr-only"> export ${item.id}</span>
        </button>`
      }
    </div>
  </article>`;
}

/** The counts of the archive's manifest; zeros are left out. @param {{counts: Record<string, unknown>}} props */
function ExportCounts({ counts }) {
  const { lines, classes } = countLinesOf(counts);
  return html`<dl class="exportcounts num">
    ${lines.map(({ text, count }) => html`<div key=${text}><dt>${text}</dt><dd>${countText(count)}</dd></div>`)}
  </dl>
  ${
    classes.length > 0 &&
    html`<details class="perclass"><summary>Per class</summary>
      <${WideTable} label="Per class"
        heads=${["Class", numeric("In"), numeric("Written"), numeric("Dropped"), numeric("Clipped")]}>
        ${classes.map(
          (row) => html`<tr key=${row.name}><th scope="row">${row.name}</th>
            ${row.counts.map((n) => html`<td class="is-num num">${countText(n)}</td>`)}</tr>`,
        )}<//>
    </details>`
  }`;
}

/** @param {{sum: string}} props */
function Sum({ sum }) {
  const { isCopied, copy } = useCopy(sum);
  return html`<p class="sum faint">sha256 <code title=${sum}>${sum.slice(0, 16)}…</code>
    <button class="button button--quiet button--icon button--small"
      aria-label=${isCopied ? "Copied" : "Copy the SHA-256"} title="Copy"
      onClick=${copy}><${Icon} name=${isCopied ? "check" : "copy"} /></button></p>`;
}

/** @type {Words} */
const OPTION_WORDS = {
  fields: {
    include: "Boxes that go in",
    include_unmeasured: "Unmeasured boxes, with their frames",
    allow_missing_images: "Frames without an image, too",
    rejected: "Rejected boxes",
    boxes: "Rectangle",
    split: "Shares of train, val, test",
    split_by: "Shares of",
    val_maps: "Maps for validation",
    bands: "Labels per distance, metres",
    drawn: "Pictures with the boxes",
    pictures: "Frames with pictures",
  },
  choices: {
    split_by: { sequence: "whole sequences", map: "each map's frames, exactly" },
    include: { effective: "kept, people's answers first", kept: "kept by the filter", all: "all, rejected ones too" },
    rejected: { drop: "left out", dontcare: "marked as to be ignored" },
    boxes: { visible: "what is inside the image", amodal: "whole, beyond the image", tight: "tight around the pixels" },
    images: { copy: "copied into the archive", none: "left out, labels alone" },
  },
  hints: {
    split: "as they came, or 0.8, 0.1, 0.1",
    val_maps: "none, or Town05, Town06",
    bands: "none, or 50, 100, 200",
  },
};

/** @param {Schema} openapi @returns {ExportForm} */
export function exportForm(openapi) {
  /**
   * @type {{enum?: Format[], "x-titles"?: Record<string, string>, "x-briefs"?: Record<string, string>, "x-options"?:
   *   Record<string, string[]>}}
   */
  const {
    enum: names = [],
    "x-titles": titles = {},
    "x-briefs": briefs = {},
    "x-options": options = {},
  } = openapi.components?.schemas?.ExportIn?.properties?.format ?? {};
  return {
    formats: names.map((value) => ({
      value,
      text: titles[value] ?? value,
      help: briefs[value] ?? "",
      options: options[value] ?? [],
    })),
    fields: fieldsOf(openapi, "ExportOptions", OPTION_WORDS),
  };
}

/** The fields of the options that a format has. @param {string | undefined} format @param {ExportForm} form */
export function fieldsFor(format, { formats, fields }) {
  const options = formats.find(({ value }) => value === format)?.options ?? [];
  return fields.filter(({ key }) => options.includes(key));
}

/**
 * A format's title, or its name where the form is not there yet.
 * @param {string} format @param {ExportForm | null | undefined} form
 */
export const formatText = (format, form) => form?.formats.find(({ value }) => value === format)?.text ?? format;

/**
 * The options of an export that differ from the defaults.
 * @param {Record<string, unknown>} options @param {readonly Field[]} fields of its format
 */
export function optionsText(options, fields) {
  const special = fields.filter(
    ({ key, initial }) => key in options && JSON.stringify(options[key]) !== JSON.stringify(initial),
  );
  return special.map((field) => wordsOf(field, options[field.key])).join(" · ");
}

/** @param {Field} field @param {unknown} value */
function wordsOf({ key, text, choices }, value) {
  const shares = key === "split" && Array.isArray(value) ? value : null;
  if (shares) return `split ${shares.map((share) => Math.round(100 * share)).join("/")}`;
  const chosen = choices.find((choice) => choice.value === value);
  if (chosen) return `${text.toLowerCase()}: ${chosen.text}`;
  if (typeof value === "boolean") return value ? text.toLowerCase() : `not: ${text.toLowerCase()}`;
  return `${text.toLowerCase()}: ${Array.isArray(value) ? value.join(", ") : String(value)}`;
}

/** @type {readonly (readonly [string, string, string])[]} part of the manifest, its key, how it is said */
const COUNT_LINES = [
  ["frames", "in", "frames"],
  ["boxes", "out", "boxes written"],
  ["boxes", "dontcare", "to be ignored"],
  ["boxes", "dropped", "dropped"],
  ["boxes", "clipped", "clipped"],
  ["unmeasured", "written", "unmeasured, written as they came"],
  ["unmeasured", "frames_left_out", "frames left out"],
  ["unmeasured", "left_out", "unmeasured, left out with them"],
];

/** What is counted of frames beside those of each part. */
const NO_PARTS = ["in", "without_boxes", "without_image", "left_out"];

/** The frames of each part, with its share and, if an export made the parts, its sequences. @param {Schema} counts */
function partLinesOf({ frames = {}, sequences = {} }) {
  const parts = Object.entries(frames).filter(([name]) => !NO_PARTS.includes(name));
  const total = parts.reduce((sum, [, count]) => sum + Number(count), 0);
  return parts.map(([name, count]) => {
    const drives = name in sequences ? `, ${countOf(Number(sequences[name]), "sequence")}` : "";
    return { text: `in ${name} (${Math.round((100 * Number(count)) / total)} %${drives})`, count: Number(count) };
  });
}

/** What the parts of an export would be, before it is made. @param {{dataset: string, shares: unknown}} props */
function PlannedParts({ dataset, shares }) {
  const split = [shares ?? []].flat().join(",");
  const { value, error } = useLoaded(
    (signal) => get("/api/v1/datasets/{dataset}/parts", { path: { dataset }, query: { split }, signal }),
    [dataset, split],
  );
  if (error) return html`<${FailureLine} error=${error} />`;
  const lines = value ? partLinesOf(value).map(({ text, count }) => `${countText(count)} ${text}`) : [];
  return html`<p class="ask__parts faint num" role="status">${lines.length > 0 && `Frames: ${lines.join(" · ")}`}</p>`;
}

/** The counts of an archive's manifest, with texts. @param {Schema} counts */
export function countLinesOf(counts) {
  const lines = COUNT_LINES.map(([part, key, text]) => ({ text, count: Number(counts[part]?.[key] ?? 0) }));
  const classes = Object.entries(counts.classes ?? {}).map(([name, row]) => ({
    name,
    counts: ["in", "out", "dropped", "clipped"].map((key) => Number(/** @type {Schema} */ (row)[key] ?? 0)),
  }));
  const [all, ...boxes] = lines;
  return { lines: [...(all ? [all] : []), ...partLinesOf(counts), ...boxes].filter(({ count }) => count > 0), classes };
}

/** @param {{dataset: string, form: ExportForm, onMade: () => void, onClose: () => void}} props */
function ExportAsk({ dataset, form, onMade, onClose }) {
  const [format, setFormat] = useState(form.formats[0]?.value);
  const [chosen, setChosen] = useState(/** @type {Record<string, unknown>} */ ({}));
  const fields = fieldsFor(format, form);
  const { run, isBusy, error } = useTask(async () => {
    if (!format) return;
    await post("/api/v1/datasets/{dataset}/exports", {
      path: { dataset },
      body: { format, options: optionsOf(fields, chosen) },
    });
    onMade();
  });
  /** @param {Event} event */
  const onSubmit = (event) => {
    event.preventDefault();
    void run();
  };
  return html`<form class="ask" onSubmit=${onSubmit}>
    <fieldset class="ask__formats">
      <legend>Format</legend>
      ${form.formats.map(
        ({ value, text, help }) => html`<label class="formatcard ${value === format ? "is-chosen" : ""}">
          <input type="radio" name="format" value=${value} checked=${value === format}
            onChange=${() => setFormat(value)} />
          <span class="formatcard__name">${text}</span><span class="formatcard__help">${help}</span>
        </label>`,
      )}
    </fieldset>
    ${
      fields.length > 0 &&
      html`<div class="ask__fields">
        ${fields.map(
          (field) => html`<${AskField} key=${field.key} field=${field}
            value=${field.key in chosen ? chosen[field.key] : field.initial}
            onChange=${(/** @type {unknown} */ value) => setChosen({ ...chosen, [field.key]: value })} />`,
        )}
      </div>`
    }
    ${
      fields.some(({ key }) => key === "split") &&
      !chosen.val_maps &&
      chosen.split_by !== "map" &&
      html`<${PlannedParts} dataset=${dataset} shares=${chosen.split} />`
    }
    ${error && html`<${FailureLine} error=${error} />`}
    <p class="ask__foot"><span class="faint">The first export as YOLO or COCO fixes the order of the classes.</span>
      <button type="button" class="button" onClick=${onClose}>Cancel</button>
      <button class="button button--primary" disabled=${isBusy || !format}>Make export</button></p>
  </form>`;
}
