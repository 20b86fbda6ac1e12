// @ts-check
// By what boxes are decided: every kind of evidence in plain words, and the switch to another one, with what that
// changes.

import { EVIDENCE, evidenceText } from "../boxes/wording.js";
import { get, post, put } from "../core/api.js";
import { useLoaded, useTask } from "../core/hooks.js";
import { html, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf } from "../core/numbers.js";
import { FailureLine, Select } from "../core/parts.js";
import { linkTo } from "../core/router.js";
import { RunStrip, isOver, useWatched } from "../jobs/job.js";
import { effectiveEdits, queryOf } from "./config.js";

/** @import { App } from "../core/app.js" */
/** @import { ConfigVersion, FilterConfigIn as ConfigBody, Preview, Run } from "../core/openapi.js" */

const STRONGEST = "auto";
const TAGS = "semantic";

/** Fewest visible pixels, by default: where tags decide, and where the strongest evidence does. */
const BY_TAGS_PX = 1;
const STRONGEST_PX = 10;

/**
 * For a view that does not know the active version. Nothing where the strongest evidence decides.
 * @param {{app: App, dataset: string}} props
 */
export function StrongerEvidence({ app, dataset }) {
  const path = { dataset };
  const active = useLoaded((signal) => get("/api/v1/datasets/{dataset}/config", { path, signal }), [dataset]);
  if (!active.value || active.value.config.evidence === STRONGEST) return null;
  return html`<${EvidenceSwitch} app=${app} dataset=${dataset} active=${active.value} isQuiet=${true}
    onApplied=${active.reload} />`;
}

/**
 * @param {{app: App, dataset: string, active: ConfigVersion, isQuiet?: boolean, onApplied: () => void}} props
 *   `isQuiet`: shown only if another kind would change verdicts
 */
export function EvidenceSwitch({ app, dataset, active, isQuiet = false, onApplied }) {
  const now = String(active.config.evidence ?? TAGS);
  const [kind, setKind] = useState(now === STRONGEST ? "" : STRONGEST);
  const others = Object.keys(EVIDENCE).filter((name) => name !== now);
  const choices = others.map((value) => ({ value, text: evidenceText(value) }));
  const config = /** @type {ConfigBody} */ ({ ...active.config, evidence: kind || now });
  // The strongest evidence keeps small remainders that the thresholds of tags would have cut.
  if (config.evidence === STRONGEST && config.min_visible_pixels === BY_TAGS_PX)
    config.min_visible_pixels = STRONGEST_PX;
  const edits = { evidence: kind, min_visible_pixels: config.min_visible_pixels };
  const path = { dataset };
  const preview = useLoaded(
    async (signal) => {
      const body = { config, limit: 0, bins: 2 };
      return kind ? post("/api/v1/datasets/{dataset}/preview", { path, body, signal }) : null;
    },
    [dataset, active, kind],
  );
  const [started, setStarted] = useState(/** @type {Run | null} */ (null));
  const undo = () => {
    const tell = () => app.toasts.show(`Boxes are decided by ${nameOf(now)} again, in the background.`);
    void put("/api/v1/datasets/{dataset}/config", { path, body: { digest: active.digest } }).then(
      tell,
      app.toasts.fail,
    );
  };
  const run = useWatched(started, {
    onOver: ({ state }) => {
      const text = `Boxes are decided by ${nameOf(kind)}. Answers stay.`;
      if (state === "done") app.toasts.show(text, { action: { text: "Undo", run: undo } });
      onApplied();
    },
    onLost: app.toasts.fail,
  });
  const isRunning = run !== null && !isOver(run);
  const {
    run: apply,
    isBusy,
    error,
  } = useTask(async () => {
    // Loaded now: few of those who see the switch use it.
    const { requireActive } = await import("./versions.js");
    await requireActive(dataset, active.digest, onApplied);
    setStarted(await post("/api/v1/datasets/{dataset}/runs", { path, body: { config, activate: true } }));
  });
  if (isQuiet && !run && !changesSomething(preview.value)) return null;
  const needsPixels = preview.value?.needs_pixels;
  return html`<section class="evidence" aria-label="What boxes are decided by">
    <label class="evidence__choice">
      <span>${kind ? "Decide by" : "Boxes are decided by"}</span>
      <${Select} label="Evidence" value=${kind} choices=${choices} any=${`${evidenceText(now)} (active)`}
        onChange=${setKind} />
    </label>
    <p class="evidence__effect" role="status">${kind ? effectText(preview.value, kind, now) : EVIDENCE[now]?.plain}</p>
    ${
      kind &&
      preview.value &&
      decides(preview.value, kind) &&
      html`<span class="evidence__actions">
        ${
          !needsPixels &&
          html`<a class="button button--small"
            href=${linkTo("thresholds", path, queryOf(effectiveEdits(active.config, edits)))}>Show them</a>`
        }
        <button class="button button--small button--primary" disabled=${isBusy || isRunning} onClick=${apply}>
          ${needsPixels ? "Measure and decide" : "Decide so"}
        </button>
      </span>`
    }
    <details class="evidence__about"><summary>What is this?</summary>
      <dl>${Object.entries(EVIDENCE).map(
        ([name, { plain }]) => html`<div key=${name}><dt>${evidenceText(name)}</dt><dd>${plain}</dd></div>`,
      )}</dl>
      <p class="faint"><${Icon} name="question" />Which kind is right how often, compared on this dataset:
        ${" "}<a href=${linkTo("quality", path)}>Quality</a>.</p>
    </details>
    ${run && html`<${RunStrip} app=${app} dataset=${dataset} run=${run} onClose=${() => setStarted(null)} />`}
    ${error && html`<${FailureLine} error=${error} />`}
    ${preview.error && html`<${FailureLine} error=${preview.error} onRetry=${preview.reload} />`}
  </section>`;
}

/** A kind of evidence within a sentence. @param {string} kind */
const nameOf = (kind) => (kind === "lidar" ? "LiDAR" : evidenceText(kind).toLowerCase());

/** @param {Preview | null} preview */
const changesSomething = (preview) => preview !== null && (preview.needs_pixels || (preview.flips?.total ?? 0) > 0);

/**
 * Whether a kind decides any box. Of files that were not measured that is not known, and taken to be so.
 * @param {Preview} preview @param {string} kind
 */
const decides = ({ needs_pixels: isUnknown, decided_by: boxes }, kind) =>
  isUnknown || kind === STRONGEST || (boxes?.[/** @type {keyof typeof boxes} */ (kind)] ?? 0) > 0;

const NOT_MEASURED =
  "Not measured yet: measuring reads the stored files again. Frames without such files stay decided by tags; " +
  "answers stay.";

/** @param {Preview | null} preview @param {string} kind @param {string} now  by what boxes are decided */
function effectText(preview, kind, now) {
  if (!preview) return "Counting what that changes …";
  const { plain = "", text = "" } = EVIDENCE[kind] ?? {};
  if (preview.needs_pixels) return `${plain} ${NOT_MEASURED}`;
  if (!decides(preview, kind)) return `No frame has what it needs. ${plain}`;
  const go = preview.flips?.kept_to_rejected ?? 0;
  const back = preview.flips?.rejected_to_kept ?? 0;
  const instead = `Instead of ${nameOf(now)}`;
  if (go + back === 0) return `${instead}: no verdict would change.`;
  const isStronger = kind === STRONGEST || kind === "instance";
  const change = isStronger
    ? `${countOf(go, "ghost goes", "ghosts go")}, ${countOf(back, "object comes back", "objects come back")}`
    : `${text} would reject ${countOf(go, "kept box", "kept boxes")} and ` +
      `keep ${countOf(back, "rejected box", "rejected boxes")}`;
  return `${instead}: ${change}. Answers stay.`;
}
