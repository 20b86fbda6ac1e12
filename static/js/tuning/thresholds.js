// @ts-check
// The thresholds view, and its summary of what a tried configuration would decide.

import { StrokeSwatch, VerdictBar } from "../boxes/signs.js";
import { get } from "../core/api.js";
import { useFields } from "../core/form.js";
import { useDataset, useLoaded, useTopBar } from "../core/hooks.js";
import { html, useEffect, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf, countText, percentText } from "../core/numbers.js";
import { Failure, FailureLine, Notice, Segments } from "../core/parts.js";
import { RunStrip, isOver, useOpenRun, useWatched } from "../jobs/job.js";
import { AllClasses, ClassCards, Reasons } from "./classes.js";
import { editsFor, effectiveEdits, keyValue, valueOf, valueText, worthTrying } from "./config.js";
import { EvidenceSwitch } from "./evidence.js";
import { Delta, DirectionSign, FlipPanel } from "./flips.js";
import { useTuning } from "./preview.js";
import { ConfigPanel, SaveDialog, Versions } from "./versions.js";

/** @import { App } from "../core/app.js" */
/** @import { ConfigVersion, Dataset, FilterConfigIn, FlipCounts, Measure, Run } from "../core/openapi.js" */
/** @import { VerdictCounts } from "../core/openapi.js" */
/** @import { Route } from "../core/router.js" */
/** @import { Tuning } from "./preview.js" */

/** @param {{app: App, route: Route}} props */
export function ThresholdsView({ app, route }) {
  const name = route.params.dataset ?? "";
  useTopBar(app, { title: `Thresholds · ${name}`, dataset: name });
  const dataset = useDataset(name);
  const active = useLoaded(
    (signal) => get("/api/v1/datasets/{dataset}/config", { path: { dataset: name }, signal }),
    [name],
  );
  const failed = [dataset, active].find((loaded) => loaded.state === "error");
  const counts = dataset.value?.counts;
  return html`<main id="main" class="page page--tuning" tabindex="-1" aria-busy=${!active.value}>
    <div class="page__head">
      <h1>Thresholds</h1>
      ${
        counts &&
        html`<span class="faint">${countOf(counts.boxes, "box", "boxes")} in ${countOf(counts.frames, "frame")}</span>`
      }
    </div>
    ${
      failed?.error
        ? html`<${Failure} error=${failed.error} onRetry=${failed.reload} />`
        : counts?.boxes === 0
          ? html`<${Notice} icon="layers" title="No boxes yet">
            <p>Histograms are shown once frames with boxes have been uploaded to this dataset.</p>
          <//>`
          : counts && active.value
            ? html`<${Tuner} key=${name} app=${app} route=${route} dataset=${name} settings=${dataset.value}
              active=${active.value} onApplied=${active.reload} />`
            : html`<${Skeleton} />`
    }
  </main>`;
}

/**
 * @param {{app: App, route: Route, dataset: string, settings: Dataset, active:
 *   ConfigVersion, onApplied: () => void}} props
 */
function Tuner({ app, route, dataset, settings, active, onApplied }) {
  const { class: selected = "", scale = "" } = route.query;
  const direction = route.query.flips ?? "";
  const tuning = useTuning(app, dataset, active, route.query);
  const keys = useFields("FilterConfigIn");
  const [isSaving, setSaving] = useState(false);
  const [saved, setSaved] = useState(0);
  const [started, setStarted] = useState(/** @type {Run | null} */ (null));
  const run = useWatched(started, {
    onOver: (over) => over.state === "done" && over.activate && onApplied(),
    onLost: (error) => {
      setStarted(null);
      app.toasts.fail(error);
    },
  });
  const isRunning = run !== null && !isOver(run);
  /** The run that was started here last: its strip is shown where the person looks. */
  const [own, setOwn] = useState(/** @type {number | null} */ (null));
  /** @param {Run} begun */
  const onRun = (begun) => {
    setStarted(begun);
    setOwn(begun.id);
  };
  const search = useOpenRun(dataset, (found) => setStarted((now) => now ?? found));
  // What has become active is no longer a change.
  useEffect(() => tuning.setEdits((held) => effectiveEdits(active.config, held)), [active]);
  /** @param {string} digest */
  const onSaved = (digest) => {
    setSaved((n) => n + 1);
    app.toasts.show(`Saved as version ${digest.slice(0, 8)}.`);
  };
  if (!tuning.preview && !tuning.baseline)
    return tuning.error ? html`<${Failure} error=${tuning.error} onRetry=${tuning.retry} />` : html`<${Skeleton} />`;
  // Before pixels have been looked at there is nothing to draw or to count.
  const isUnknown = tuning.preview?.needs_pixels === true;
  return html`<${Summary} tuning=${tuning} isRunning=${isRunning} onReset=${() => tuning.setEdits({})}
    onSave=${() => setSaving(true)} />
  ${
    run &&
    html`<${RunStrip} key=${run.id} app=${app} dataset=${dataset} run=${run} isOwn=${run.id === own}
      onClose=${() => setStarted(null)} />`
  }
  ${search.error && html`<${FailureLine} what="Runs" error=${search.error} onRetry=${search.reload} />`}
  ${tuning.error && html`<${FailureLine} error=${tuning.error} onRetry=${tuning.retry} />`}
  <${Overturned} tuning=${tuning} />
  <${EvidenceSwitch} key=${active.digest} app=${app} dataset=${dataset} active=${active} onApplied=${onApplied} />
  ${!isUnknown && html`<${ChannelLine} config=${tuning.tried} keys=${keys.value ?? []} />`}
  <div class="tuning ${isUnknown ? "tuning--unknown" : ""}">
    <div class="tuning__main">
      ${
        !isUnknown &&
        html`<${AllClasses} app=${app} tuning=${tuning} scale=${scale} selected=${selected} />
        <${ClassCards} app=${app} tuning=${tuning} scale=${scale} selected=${selected} />
        <${Reasons} tuning=${tuning} selected=${selected} />`
      }
      <${Versions} dataset=${dataset} tuning=${tuning} saved=${saved} isRunning=${isRunning} onRun=${onRun} />
      <${ConfigPanel} tuning=${tuning} keys=${keys} settings=${settings} />
    </div>
    ${
      !isUnknown &&
      html`<${FlipPanel} app=${app} tuning=${tuning} selected=${selected} direction=${direction}
        onDirection=${(/** @type {string} */ flips) => tuning.look({ class: selected, scale, flips })} />`
    }
  </div>
  ${
    isSaving &&
    html`<${SaveDialog} dataset=${dataset} tuning=${tuning} onClose=${() => setSaving(false)}
      onSaved=${onSaved} onRun=${onRun} onOutdated=${onApplied} />`
  }`;
}

const Skeleton = () => html`<div aria-hidden="true">
  <div class="skeleton skeleton--row shimmer"></div><div class="skeleton skeleton--chart shimmer"></div>
  <div class="classcards">${[0, 1, 2, 3].map(() => html`<div class="skeleton skeleton--tall shimmer"></div>`)}</div>
</div>
<p class="sr-only" role="status">Loading thresholds</p>`;

/**
 * Says what decides, and by which keys, if it is not the segmentation alone.
 * @param {{config: FilterConfigIn, keys: readonly import("../core/form.js").Field[]}} props
 */
function ChannelLine({ config, keys }) {
  const channel = config.evidence ?? "semantic";
  const own = keys.filter(({ evidence }) => evidence.includes(channel));
  if (channel === "semantic" || own.length === 0) return null;
  const name = channel === "auto" ? "The strongest evidence of each frame" : html`<code>${channel}</code>`;
  return html`<p class="tuning__channel">${name} decides, by ${own.map(
    (field, at) =>
      html`${at > 0 ? (at === own.length - 1 ? " and " : ", ") : ""}
      <code>${field.key}</code> (${valueText(keyValue(config, field))})`,
  )}; thresholds of matching pixels decide the boxes that it could not measure.</p>`;
}

/** @param {{tuning: Tuning, onReset: () => void, onSave: () => void, isRunning: boolean}} props */
function Summary({ tuning, onReset, onSave, isRunning }) {
  const { preview, baseline, edits, counted } = tuning;
  const changed = Object.keys(edits).length;
  const isCurrent = counted === tuning.tried;
  return html`<section class="summary ${isCurrent ? "" : "is-behind"}" aria-label="What would be decided"
    data-threshold=${counted ? String(valueOf(counted, tuning.share.key)) : ""}>
    <div class="summary__numbers">
      ${
        preview?.needs_pixels
          ? html`<p class="summary__pixels"><${Icon} name="image" />
            <span><strong>This change requires reading the images again.</strong>${" "}
              Its effect cannot be computed from the stored measurements. Applying it measures all frames again, in the
              background.</span></p>`
          : html`<${Counts} counts=${preview?.counts ?? null} before=${baseline?.counts ?? null} />
          <${Flips} flips=${preview?.flips ?? null} />
          <${Scores} tuning=${tuning} />`
      }
    </div>
    <div class="summary__actions">
      <span class="summary__state">${changed ? `${countOf(changed, "change")}, not saved` : "The active configuration"}
      </span>
      <button class="button button--quiet" disabled=${changed === 0}
        onClick=${onReset}><${Icon} name="undo" />Reset</button>
      <button class="button button--primary" disabled=${changed === 0 || isRunning}
        onClick=${onSave}>Save as new config version…</button>
    </div>
  </section>`;
}

/** @param {{counts: VerdictCounts | null, before: VerdictCounts | null}} props */
function Counts({ counts, before }) {
  const all = counts ? counts.kept + counts.rejected + counts.unmeasured : 0;
  return html`<div class="summary__verdicts">
    <div class="figures">
      <${Figure} verdict="kept" count=${counts?.kept} before=${before?.kept} />
      <${Figure} verdict="rejected" count=${counts?.rejected} before=${before?.rejected} />
      ${
        counts &&
        counts.unmeasured > 0 &&
        html`<${Figure} verdict="unmeasured" count=${counts.unmeasured} before=${before?.unmeasured} />`
      }
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

/** What the truth is, where a choice has to be made, and in a sentence. */
const TRUTH = {
  instances: { text: "Instances", of: (/** @type {number} */ n) => `of ${countOf(n, "box", "boxes")} with instances` },
  people: { text: "Answers", of: (/** @type {number} */ n) => `of ${countOf(n, "answered box", "answered boxes")}` },
};
const SCORES = /** @type {const} */ ([
  { name: "precision", title: "Of the boxes that are kept, the share whose object is visible" },
  { name: "recall", title: "Of the boxes whose object is visible, the share that is kept" },
]);

/** Precision and recall of what is tried, where the truth of some boxes is known. @param {{tuning: Tuning}} props */
function Scores({ tuning }) {
  const { preview, truths, truth } = tuning;
  const scores = preview?.scores;
  if (!truth || !scores) return null;
  const { of } = TRUTH[truth.truth];
  return html`<div class="summary__truth">
    <div class="figures">
      ${SCORES.map(
        ({ name, title }) => html`<div class="figure" data-figure=${name} title=${title}>
          <span class="figure__name">${name}</span>
          <span class="figure__value num">${scores.after[name] ? `${tenths(scores.after[name].value)} %` : "–"}</span>
          <${Delta} count=${points(scores.after[name])} before=${points(scores.before[name])} />
        </div>`,
      )}
    </div>
    <p class="faint">${
      truths.length > 1
        ? html`<${Segments} label="Compared with" value=${truth.truth}
          choices=${truths.map(({ truth: value }) => ({ value, text: TRUTH[value].text }))}
          onChange=${(/** @type {string} */ value) => tuning.look({ truth: value })} />`
        : ""
    }${of(scores.boxes)}</p>
  </div>`;
}

/** In percent, with one decimal. @param {number} share */
const tenths = (share) => Math.round(1000 * share) / 10;

/** @param {Measure | null} measure */
const points = (measure) => (measure ? tenths(measure.value) : undefined);

/** So many verdicts of a class that the truth contradicts are worth a hint. */
const FEW_ERRORS = 3;

/**
 * Classes whose verdicts the truth contradicts, with the threshold that agrees better.
 * @param {{tuning: Tuning}} props
 */
function Overturned({ tuning }) {
  const { truth, tried, change, active } = tuning;
  const better = worthTrying(truth?.suggested ?? []).flatMap((suggestion) => {
    const errors = truth?.by_class[suggestion.class];
    const count = errors ? errors.kept_reject + errors.rejected_keep : 0;
    const edits = editsFor([suggestion]);
    const isTried = Object.keys(effectiveEdits(tried, edits)).length === 0;
    return count >= FEW_ERRORS && !isTried ? [{ suggestion, count, edits }] : [];
  });
  if (!truth || better.length === 0 || !active) return null;
  return html`<ul class="overturned" aria-label="What the truth contradicts">
    ${better.map(
      ({ suggestion: { class: name, suggested }, count, edits }) => html`<li key=${name}>
        <span>
          ${truth.truth === "people" ? countOf(count, "answer") : `Instances of ${countOf(count, "box", "boxes")}`} of <b>${name}</b>${" "}
          ${truth.truth === "people" ? "overturned" : "contradict"} the filter.</span>
        <button class="button button--small" onClick=${() => change(edits)}>Try ${percentText(suggested)}</button>
      </li>`,
    )}
  </ul>`;
}

/** @param {{flips: FlipCounts & {total: number} | null}} props */
function Flips({ flips }) {
  return html`<div class="figures figures--flips">
    <div class="figure" data-figure="kept_to_rejected">
      <span class="figure__name"><${DirectionSign} direction="kept_to_rejected" />kept → rejected</span>
      <span class="figure__value num">${flips ? countText(flips.kept_to_rejected) : "–"}</span>
      <span class="delta">would flip</span>
    </div>
    <div class="figure" data-figure="rejected_to_kept">
      <span class="figure__name"><${DirectionSign} direction="rejected_to_kept" />rejected → kept</span>
      <span class="figure__value num">${flips ? countText(flips.rejected_to_kept) : "–"}</span>
      <span class="delta">would flip</span>
    </div>
  </div>`;
}
