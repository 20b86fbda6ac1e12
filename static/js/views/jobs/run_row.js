// @ts-check
// One run: what it applied, how far it is, what it changed, and what one can do with it.

import { html } from "../../html.js";
import { tookText } from "../../export_form.js";
import { linkTo } from "../../router.js";
import { isOver, percentDone } from "../../watch.js";
import { agoText, countOf, countText } from "../../wording.js";
import { VerdictBar } from "../parts.js";
import { CancelButton, JobBar, StateBadge, useWatched } from "./progress.js";

/** @typedef {import("../../types_jobs.js").Run} Run */

const KINDS = /** @type {Record<string, string>} */ ({ measure: "measured again", decide: "decided again" });

/** @param {{app: import("../../app.js").App, dataset: string, run: Run, isActive: boolean, isShown: boolean, onOver: () => void}} props */
export function RunRow({ app, dataset, run: loaded, isActive, isShown, onOver }) {
  const run = useWatched(loaded, onOver) ?? loaded;
  return html`<article class="run ${isShown ? "is-shown" : ""}" aria-label=${`Run ${run.id}`}>
    <div class="run__what">
      <span class="run__name">Run ${run.id}</span><${StateBadge} state=${run.state} />
      ${isActive && html`<span class="tagword">active</span>`}
      ${!run.activate && html`<span class="faint run__note">tried, not made active</span>`}
    </div>
    <p class="run__about faint"><code title=${run.config}>${run.config.slice(0, 8)}</code> · ${KINDS[run.kind] ?? run.kind} · ${run.created_by}, ${agoText(run.created_at)}${tookOf(run)}</p>
    <div class="run__how"><${How} run=${run} /></div>
    <div class="run__actions">
      ${!isOver(run) && html`<${CancelButton} app=${app} run=${run} />`}
      ${run.state === "done" && run.total > 0 && html`<a class="button button--small" href=${linkTo("runs", { dataset }, isShown ? {} : { run: String(run.id) })}>${isShown ? "Close" : "What changed"}<span class="sr-only"> in run ${run.id}</span></a>`}
    </div>
  </article>`;
}

/** @param {Run} run */
function tookOf(run) {
  const took = tookText(run.started_at, run.finished_at);
  return took && run.total > 0 ? ` · took ${took}` : "";
}

/** @param {{run: Run}} props */
function How({ run }) {
  if (run.state === "failed") return html`<p class="run__error"><strong>${run.error?.title ?? "Failed"}.</strong> ${run.error?.detail ?? "No reason was given."}</p>`;
  if (run.state === "cancelled") return html`<p class="faint">Stopped at ${countText(run.done)} of ${countOf(run.total, "frame")}; nothing was changed.</p>`;
  if (!isOver(run)) {
    return html`<${JobBar} job=${run} label=${`Run ${run.id}`} />
      <p class="faint num">${run.state === "queued" ? "waits for its turn" : `${countText(run.done)} of ${countOf(run.total, "frame")}, ${percentDone(run)} %`}</p>`;
  }
  const { kept = 0, rejected = 0, unmeasured = 0 } = run.counts;
  const boxes = kept + rejected + unmeasured;
  if (boxes === 0) return html`<p class="faint">Began with the dataset.</p>`;
  return html`<${VerdictBar} counts=${{ boxes, kept, rejected, unmeasured, reviewed: 0, to_review: 0 }} />
    <p class="faint num">${countText(kept)} kept · ${countText(rejected)} rejected · <strong class="run__changed">${run.changed ? `${countText(run.changed)} changed` : "nothing changed"}</strong></p>`;
}
