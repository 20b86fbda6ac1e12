// @ts-check
// Thresholds tried live over the whole dataset: histograms, counts and the boxes that flip.

import { html, useEffect, useState } from "../html.js";
import { jobs } from "../calls/jobs.js";
import { linkTo } from "../router.js";
import { effectiveEdits } from "../tuning.js";
import { isOver } from "../watch.js";
import { countOf } from "../wording.js";
import { useLoaded, useTitle } from "./hooks.js";
import { useWatched } from "./jobs/progress.js";
import { Failure, Notice } from "./parts.js";
import { TopBar } from "./topbar.js";
import { ChannelLine } from "./tuning/channel_line.js";
import { AllClasses, ClassCards } from "./tuning/classes.js";
import { ConfigPanel } from "./tuning/config_panel.js";
import { FlipPanel } from "./tuning/flip_panel.js";
import { Reasons } from "./tuning/reasons.js";
import { RunStrip } from "./tuning/run_strip.js";
import { SaveDialog } from "./tuning/save_dialog.js";
import { useTuning } from "./tuning/state.js";
import { Summary } from "./tuning/summary.js";
import { Versions } from "./tuning/versions.js";

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../router.js").Route} Route */
/** @typedef {import("../types_jobs.js").ConfigVersion} ConfigVersion */
/** @typedef {import("../types_jobs.js").Run} Run */

/** @param {{app: App, route: Route}} props */
export const ThresholdsView = ({ app, route }) => html`<${ThresholdsOf} key=${route.params.dataset} app=${app} route=${route} />`;

/** One dataset: nothing of another one is left over. @param {{app: App, route: import("../router.js").Route}} props */
function ThresholdsOf({ app, route }) {
  const name = route.params.dataset ?? "";
  useTitle(`Thresholds · ${name}`);
  const dataset = useLoaded(app, (signal) => app.api.dataset(name, signal), [name]);
  const active = useLoaded(app, (signal) => jobs.activeConfig(name, signal), [name]);
  const failed = [dataset, active].find((loaded) => loaded.state === "error");
  const counts = dataset.value?.counts;
  return html`<${TopBar} app=${app} crumbs=${[{ text: "Datasets", href: linkTo("datasets") }, { text: name }]} />
    <main id="main" class="page page--tuning" tabindex="-1" aria-busy=${!active.value}>
      <div class="page__head">
        <h1>Thresholds</h1>
        ${counts && html`<span class="faint">${countOf(counts.boxes, "box", "boxes")} in ${countOf(counts.frames, "frame")}</span>`}
      </div>
      ${failed?.error
        ? html`<${Failure} error=${failed.error} onRetry=${failed.reload} />`
        : counts?.boxes === 0
          ? html`<${Empty} />`
          : counts && active.value
            ? html`<${Tuner} key=${name} app=${app} route=${route} dataset=${name} active=${active.value} onApplied=${active.reload} />`
            : html`<${Skeleton} />`}
    </main>`;
}

/** @param {{app: App, route: Route, dataset: string, active: ConfigVersion, onApplied: () => void}} props */
function Tuner({ app, route, dataset, active, onApplied }) {
  const { class: selected = "", scale = "", flips: way = "" } = route.query;
  const tuning = useTuning(app, dataset, active, route.query);
  const [isSaving, setSaving] = useState(false);
  const [saved, setSaved] = useState(0);
  const [started, setStarted] = useState(/** @type {Run | null} */ (null));
  const run = useWatched(started, (over) => over.state === "done" && over.activate && onApplied());
  const isRunning = run !== null && !isOver(run);
  useOpenRun(dataset, setStarted);
  // What has become active is no longer a change.
  useEffect(() => tuning.setEdits((held) => effectiveEdits(active.config, held)), [active]);
  /** @param {string} digest */
  const onSaved = (digest) => {
    setSaved((n) => n + 1);
    app.toasts.show(`Saved as version ${digest.slice(0, 8)}.`);
  };
  if (!tuning.preview && !tuning.baseline) return tuning.error ? html`<${Failure} error=${tuning.error} onRetry=${tuning.retry} />` : html`<${Skeleton} />`;
  // Before pixels have been looked at there is nothing to draw or to count.
  const isUnknown = tuning.preview?.needs_pixels === true;
  return html`<${Summary} tuning=${tuning} isRunning=${isRunning} onReset=${() => tuning.setEdits({})} onSave=${() => setSaving(true)} />
    ${run && html`<${RunStrip} app=${app} dataset=${dataset} run=${run} onClose=${() => setStarted(null)} />`}
    ${tuning.error && html`<p class="problem" role="alert">${tuning.error.message} <button class="button button--small" onClick=${tuning.retry}>Try again</button></p>`}
    ${!isUnknown && html`<${ChannelLine} config=${tuning.tried} />`}
    <div class="tuning ${isUnknown ? "tuning--unknown" : ""}">
      <div class="tuning__main">
        ${!isUnknown && html`<${AllClasses} app=${app} tuning=${tuning} scale=${scale} selected=${selected} />
          <${ClassCards} app=${app} tuning=${tuning} scale=${scale} selected=${selected} />
          <${Reasons} tuning=${tuning} selected=${selected} />`}
        <${Versions} app=${app} dataset=${dataset} tuning=${tuning} saved=${saved} isRunning=${isRunning} onRun=${setStarted} />
        <${ConfigPanel} tuning=${tuning} />
      </div>
      ${!isUnknown && html`<${FlipPanel} app=${app} tuning=${tuning} selected=${selected} way=${way} onWay=${(/** @type {string} */ flips) => tuning.look({ class: selected, scale, flips })} />`}
    </div>
    ${isSaving && html`<${SaveDialog} app=${app} dataset=${dataset} tuning=${tuning} onClose=${() => setSaving(false)} onSaved=${onSaved} onRun=${setStarted} />`}`;
}

/** Somebody may have started a run before. @param {string} dataset @param {(run: Run) => void} onFound */
function useOpenRun(dataset, onFound) {
  useEffect(() => {
    const stop = new AbortController();
    jobs.runs(dataset, { limit: 1 }, stop.signal).then(
      ({ items: [newest] }) => newest && !isOver(newest) && onFound(newest),
      () => {},
    );
    return () => stop.abort();
  }, [dataset]);
}

const Empty = () => html`<${Notice} icon="layers" title="No boxes yet"><p>Histograms are drawn as soon as frames with boxes have been pushed to this dataset.</p><//>`;

const Skeleton = () => html`<div aria-hidden="true">
    <div class="bone bone--row shimmer"></div><div class="bone bone--chart shimmer"></div>
    <div class="classcards">${[0, 1, 2, 3].map(() => html`<div class="bone bone--tall shimmer"></div>`)}</div>
  </div>
  <p class="sr-only" role="status">Loading thresholds</p>`;
