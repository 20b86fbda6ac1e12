// @ts-check
// The run that applies a configuration, from asking to what it has changed.

import { html } from "../../html.js";
import { linkTo } from "../../router.js";
import { isOver } from "../../watch.js";
import { countOf, countText } from "../../wording.js";
import { Icon } from "../icons.js";
import { CancelButton, JobBar, StateBadge } from "../jobs/progress.js";

/** @typedef {import("../../types_jobs.js").Run} Run */

/** @param {{app: import("../../app.js").App, dataset: string, run: Run, onClose: () => void}} props */
export function RunStrip({ app, dataset, run, onClose }) {
  return html`<section class="runstrip runstrip--${run.state}" aria-label=${`Run ${run.id}`}>
    <${StateBadge} state=${run.state} />
    <p class="runstrip__text" role="status">${wordsOf(run)}</p>
    ${!isOver(run) && html`<${JobBar} job=${run} label=${`Run ${run.id}`} /><${CancelButton} app=${app} run=${run} />`}
    ${run.state === "done" && html`<a class="button button--small" href=${linkTo("runs", { dataset }, { run: String(run.id) })}>See what changed</a>`}
    ${isOver(run) && html`<button class="button button--quiet button--icon" aria-label="Close" onClick=${onClose}><${Icon} name="cross" /></button>`}
  </section>`;
}

/** @param {Run} run */
function wordsOf(run) {
  const what = run.kind === "measure" ? "measures every frame again" : "decides again from the stored numbers";
  switch (run.state) {
    case "queued":
      return `Run ${run.id} waits for its turn.`;
    case "running":
      return `Run ${run.id} ${what}: ${countText(run.done)} of ${countOf(run.total, "frame")}.`;
    case "done":
      return `Run ${run.id} is done: ${countOf(run.changed, "box has", "boxes have")} another verdict or reason.`;
    case "cancelled":
      return `Run ${run.id} was cancelled. What was active still is.`;
    default:
      return `Run ${run.id} failed: ${run.error?.detail ?? run.error?.title ?? "no reason was given"}`;
  }
}
