// @ts-check
// What the tried configuration would decide, against the active one; and what to do with it.

import { html } from "../../html.js";
import { THRESHOLD, valueOf } from "../../tuning.js";
import { countOf, countText } from "../../wording.js";
import { Icon } from "../icons.js";
import { StrokeSwatch, VerdictBar } from "../parts.js";

/** @typedef {import("./state.js").Tuning} Tuning */

/** @param {{tuning: Tuning, onReset: () => void, onSave: () => void, isRunning: boolean}} props */
export function Summary({ tuning, onReset, onSave, isRunning }) {
  const { preview, baseline, edits, counted } = tuning;
  const changed = Object.keys(edits).length;
  const isCurrent = counted === tuning.tried;
  return html`<section class="summary ${isCurrent ? "" : "is-behind"}" aria-label="What would be decided" data-threshold=${counted ? String(valueOf(counted, THRESHOLD)) : ""}>
    <div class="summary__numbers">
      ${preview?.needs_pixels ? html`<${NeedsPixels} />` : html`<${Counts} counts=${preview?.counts ?? null} before=${baseline?.counts ?? null} />
        <${Flips} flips=${preview?.flips ?? null} />`}
    </div>
    <div class="summary__actions">
      <span class="summary__state">${changed ? `${countOf(changed, "change")} tried, nothing is stored` : "The active configuration"}</span>
      <button class="button button--quiet" disabled=${changed === 0} onClick=${onReset}><${Icon} name="undo" />Reset</button>
      <button class="button button--primary" disabled=${changed === 0 || isRunning} onClick=${onSave}>Save as new config version…</button>
    </div>
  </section>`;
}

function NeedsPixels() {
  return html`<p class="summary__pixels"><${Icon} name="image" /><span><strong>This one has to look at pixels again.</strong>${" "}
    What it would decide cannot be told from the stored numbers. Applying it measures every frame anew, in the background.</span></p>`;
}

/** @param {{counts: import("../../types_jobs.js").VerdictCounts | null, before: import("../../types_jobs.js").VerdictCounts | null}} props */
function Counts({ counts, before }) {
  const all = counts ? counts.kept + counts.rejected + counts.unmeasured : 0;
  return html`<div class="summary__verdicts">
    <div class="figures">
      <${Figure} verdict="kept" count=${counts?.kept} before=${before?.kept} />
      <${Figure} verdict="rejected" count=${counts?.rejected} before=${before?.rejected} />
      ${counts && counts.unmeasured > 0 && html`<${Figure} verdict="unmeasured" count=${counts.unmeasured} before=${before?.unmeasured} />`}
    </div>
    ${counts && html`<${VerdictBar} counts=${{ ...counts, boxes: all, reviewed: 0, to_review: 0 }} />`}
  </div>`;
}

/** @param {{verdict: string, count: number | undefined, before: number | undefined}} props */
function Figure({ verdict, count, before }) {
  return html`<div class="figure" data-figure=${verdict}>
    <span class="figure__name"><${StrokeSwatch} verdict=${verdict} />${verdict}</span>
    <span class="figure__value num">${count === undefined ? "–" : countText(count)}</span>
    <${Delta} count=${count} before=${before} />
  </div>`;
}

/** How much more or less than now. @param {{count: number | undefined, before: number | undefined}} props */
export function Delta({ count, before }) {
  const by = count === undefined || before === undefined ? 0 : count - before;
  return html`<span class="delta num ${by === 0 ? "is-none" : ""}">${by === 0 ? "±0" : `${by > 0 ? "+" : "−"}${countText(Math.abs(by))}`}</span>`;
}

/** @param {{flips: import("../../types_jobs.js").FlipCounts & {total: number} | null}} props */
function Flips({ flips }) {
  return html`<div class="figures figures--flips">
    <div class="figure" data-figure="lost">
      <span class="figure__name"><${Way} way="lost" />kept → rejected</span>
      <span class="figure__value num">${flips ? countText(flips.kept_to_rejected) : "–"}</span>
      <span class="delta">would flip</span>
    </div>
    <div class="figure" data-figure="won">
      <span class="figure__name"><${Way} way="won" />rejected → kept</span>
      <span class="figure__value num">${flips ? countText(flips.rejected_to_kept) : "–"}</span>
      <span class="delta">would flip</span>
    </div>
  </div>`;
}

/** The sign of a flip: what it leaves and what it becomes. @param {{way: "lost" | "won"}} props */
export const Way = ({ way }) => html`<span class="way way--${way}" aria-hidden="true"><${Icon} name=${way === "lost" ? "cross" : "check"} /></span>`;
