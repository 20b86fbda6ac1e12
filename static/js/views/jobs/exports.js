// @ts-check
// Exports: ask for one, watch it, download it, check it.

import { html, useEffect, useState } from "../../html.js";
import { jobs } from "../../calls/jobs.js";
import { booksOf, exportForm, formatText, optionsText } from "../../export_form.js";
import { sizeText } from "../../wording.js";
import { isOver, percentDone } from "../../watch.js";
import { agoText, countOf, countText } from "../../wording.js";
import { useLoaded } from "../hooks.js";
import { Icon } from "../icons.js";
import { ExportAsk } from "./export_ask.js";
import { Canceller, JobBar, StateBadge } from "./progress.js";

/** @typedef {import("../../app.js").App} App */
/** @typedef {import("../../types_jobs.js").Export} Export */

const SHOWN = 50;
const ASK_AGAIN_MS = 800;

/** @param {{app: App, dataset: string}} props */
export function Exports({ app, dataset }) {
  const loaded = useLoaded(app, (signal) => jobs.exports(dataset, { limit: SHOWN }, signal), [dataset]);
  const form = useLoaded(app, async (signal) => exportForm(await jobs.description(signal)), []);
  const [isAsking, setAsking] = useState(false);
  const items = loaded.value?.items;
  const isOpen = items?.some((one) => !isOver(one)) ?? false;
  useEffect(() => {
    if (!isOpen) return undefined;
    const timer = setInterval(loaded.reload, ASK_AGAIN_MS);
    return () => clearInterval(timer);
  }, [isOpen]);
  const onMade = () => {
    setAsking(false);
    loaded.reload();
  };
  return html`<section class="panelbox" aria-labelledby="exports-title">
    <header class="panelbox__head">
      <h2 id="exports-title">Exports</h2>
      <span class="panelbox__tools"><button class="button button--primary" aria-expanded=${isAsking} onClick=${() => setAsking(!isAsking)}><${Icon} name="plus" />New export</button></span>
    </header>
    ${isAsking && form.value && html`<${ExportAsk} app=${app} dataset=${dataset} form=${form.value} onMade=${onMade} onClose=${() => setAsking(false)} />`}
    ${isAsking && form.state === "error" && html`<p class="problem" role="alert">${form.error.message}</p>`}
    ${loaded.state === "error" && !items && html`<p class="panelbox__empty" role="alert">${loaded.error.message} <button class="button button--small" onClick=${loaded.reload}>Try again</button></p>`}
    ${items?.length === 0 && !isAsking && html`<p class="panelbox__empty">No export yet. Labels are written from what people answered, else from what the filter decided.</p>`}
    <ul class="runs">
      ${items?.map((one) => html`<li key=${one.id}><${ExportRow} app=${app} item=${one} fields=${form.value?.fields ?? []} /></li>`)}
    </ul>
  </section>`;
}

/** @param {{app: App, item: Export, fields: readonly import("../../export_form.js").Field[]}} props */
function ExportRow({ app, item, fields }) {
  const about = optionsText(item.options, fields);
  return html`<article class="run" aria-label=${`Export ${item.id}`}>
    <div class="run__what"><span class="run__name">${formatText(item.format)}</span><${StateBadge} state=${item.state} /></div>
    <p class="run__about faint">Export ${item.id} · ${agoText(item.created_at)}${about && ` · ${about}`}</p>
    <div class="run__how">
      ${!isOver(item) && html`<${JobBar} job=${item} label=${`Export ${item.id}`} /><p class="faint num">${item.total ? `${countText(item.done ?? 0)} of ${countOf(item.total, "frame")}, ${percentDone(item)} %` : "being written"}</p>`}
      ${item.state === "cancelled" && html`<p class="faint">Stopped; nothing was written.</p>`}
      ${item.state === "failed" && html`<p class="run__error"><strong>${item.error?.title ?? "Failed"}.</strong> ${item.error?.detail ?? ""}</p>`}
      ${item.state === "done" && html`<${Books} counts=${item.counts ?? {}} /><${Sum} sum=${item.sha256 ?? ""} />`}
    </div>
    <div class="run__actions">
      ${!isOver(item) && html`<${Canceller} app=${app} what=${`export ${item.id}`} cancel=${() => jobs.cancelExport(item.id)} />`}
      ${item.state === "done" && html`<button class="button button--small" onClick=${() => download(app, item.id)}><${Icon} name="download" /><span class="sr-only">Download export ${item.id}, </span>${sizeText(item.size_bytes)}</button>`}
    </div>
  </article>`;
}

/** By the browser itself, however large it is: nothing of it passes through the page. @param {App} app @param {number} id */
async function download(app, id) {
  try {
    const { url } = await jobs.downloadLink(id);
    const link = document.createElement("a");
    link.href = url;
    link.download = "";
    link.click();
  } catch (error) {
    app.notice(error);
    app.toasts.show(/** @type {Error} */ (error).message, { kind: "error" });
  }
}

/** What the archive's own manifest counts; what there is none of is not said. @param {{counts: Record<string, unknown>}} props */
function Books({ counts }) {
  const { lines, classes } = booksOf(counts);
  return html`<dl class="books num">
      ${lines.map(({ text, count }) => html`<div key=${text}><dt>${text}</dt><dd>${countText(count)}</dd></div>`)}
    </dl>
    ${classes.length > 0 &&
    html`<details class="perclass"><summary>Per class</summary>
      <div class="tablewrap"><table class="table">
        <thead><tr><th scope="col">Class</th><th class="is-num" scope="col">In</th><th class="is-num" scope="col">Written</th><th class="is-num" scope="col">Dropped</th><th class="is-num" scope="col">Clipped</th></tr></thead>
        <tbody>${classes.map((row) => html`<tr key=${row.name}><th scope="row">${row.name}</th>${row.counts.map((n) => html`<td class="is-num num">${countText(n)}</td>`)}</tr>`)}</tbody>
      </table></div>
    </details>`}`;
}

/** @param {{sum: string}} props */
function Sum({ sum }) {
  const [isCopied, setCopied] = useState(false);
  const copy = async () => {
    await navigator.clipboard?.writeText(sum);
    setCopied(true);
    setTimeout(() => setCopied(false), 1500);
  };
  return html`<p class="sum faint">sha256 <code title=${sum}>${sum.slice(0, 16)}…</code>
    <button class="button button--quiet button--icon button--small" aria-label=${isCopied ? "Copied" : "Copy the SHA-256"} title="Copy" onClick=${copy}><${Icon} name=${isCopied ? "check" : "copy"} /></button></p>`;
}
