// @ts-check
// The view of runs and exports, and the difference between two runs.

import { VerdictBar } from "../boxes/signs.js";
import { get } from "../core/api.js";
import { useDataset, useLoaded, useNewest, usePages, useTopBar } from "../core/hooks.js";
import { html, useState } from "../core/html.js";
import { agoText, countOf, countText, tookText } from "../core/numbers.js";
import { BAR, Failure, FailureLine, Older, WideTable, numeric } from "../core/parts.js";
import { linkTo } from "../core/router.js";
import { CancelButton, JobBar, StateBadge, isOver, percentDone, useLookAgain } from "../jobs/job.js";
import { differences } from "../tuning/config.js";
import { DirectionTabs, FlipGrid, directionOf } from "../tuning/flips.js";
import { DiffTable } from "../tuning/versions.js";
import { Exports } from "./exports.js";

/** @import { App } from "../core/app.js" */
/** @import { Route } from "../core/router.js" */
/** @import { Diff as RunDiff, Run } from "../core/openapi.js" */

/** How many runs are shown at first. */
const NEWEST = 25;

/** @param {{app: App, route: Route}} props */
export function RunsView({ app, route }) {
  const name = route.params.dataset ?? "";
  useTopBar(app, { title: `Runs and exports · ${name}`, dataset: name });
  const dataset = useDataset(name);
  const runs = useNewest(
    NEWEST,
    (query, signal) => get("/api/v1/datasets/{dataset}/runs", { path: { dataset: name }, query, signal }),
    [name],
  );
  const reload = () => (runs.reload(), dataset.reload());
  const isLoading = [dataset, runs].some((loaded) => loaded.state === "loading");
  useLookAgain({ state: isLoading ? "loading" : runs.state, value: runs.value, reload }, runs.value?.items ?? []);
  const failed = [dataset, runs].find((loaded) => loaded.state === "error" && !loaded.value);
  const { run = "", against = "" } = route.query;
  return html`<main id="main" class="page" tabindex="-1" aria-busy=${!runs.value}>
    <div class="page__head"><h1>Runs and exports</h1></div>
    ${
      failed?.error
        ? html`<${Failure} error=${failed.error} onRetry=${reload} />`
        : html`${
            run &&
            html`<${RunDiffPanel} key=${`${run} ${against}`} app=${app} dataset=${name} run=${Number(run)}
              against=${Number(against) || null} runs=${runs.value?.items ?? []} />`
          }
        <div class="jobs">
          <${Runs} app=${app} dataset=${name} runs=${runs.value?.items ?? null}
            active=${dataset.value?.active_run ?? null} shown=${Number(run) || null} showOlder=${runs.showOlder} />
          <${Exports} app=${app} dataset=${name} />
        </div>`
    }
  </main>`;
}

/**
 * @param {{app: App, dataset: string, runs: readonly Run[] | null, active: number | null, shown: number | null,
 *   showOlder: (() => void) | null}} props
 */
function Runs({ app, dataset, runs, active, shown, showOlder }) {
  const open = runs?.filter((run) => !isOver(run)).length ?? 0;
  return html`<section class="panelbox" aria-labelledby="runs-title">
    <header class="panelbox__head">
      <h2 id="runs-title">Runs</h2>
      <span class="faint">${open ? `${open} running or queued` : "a configuration applied to the whole dataset"}</span>
      <span
        class="panelbox__tools"><a class="button" href=${linkTo("thresholds", { dataset })}>Try thresholds</a></span>
    </header>
    ${
      runs === null &&
      html`<div
        aria-hidden="true">${[0, 1, 2].map(() => html`<div class="skeleton skeleton--row shimmer"></div>`)}</div>
      <p class="sr-only" role="status">Loading runs</p>`
    }
    ${runs?.length === 0 && html`<p class="panelbox__empty">No run yet.</p>`}
    <ul class="runs">
      ${runs?.map(
        (run) => html`<li key=${run.id}>
          <${RunRow} app=${app} dataset=${dataset} run=${run} isActive=${run.id === active}
            isShown=${run.id === shown} />
        </li>`,
      )}
    </ul>
    <${Older} what="runs" onShow=${showOlder} />
  </section>`;
}

const PAGE = 60;

/**
 * @param {number} run @param {{against: number | null, limit: number, cursor?: string}} query
 * @param {AbortSignal} [signal]
 */
const diffOf = (run, query, signal) => get("/api/v1/runs/{run_id}/diff", { path: { run_id: run }, query, signal });

/** The configuration that a run applied. @param {number} run @param {AbortSignal} signal */
async function configOf(run, signal) {
  const { config: digest } = await get("/api/v1/runs/{run_id}", { path: { run_id: run }, signal });
  return get("/api/v1/configs/{digest}", { path: { digest }, signal });
}

/** @param {{app: App, dataset: string, run: number, against: number | null, runs: readonly Run[]}} props */
function RunDiffPanel({ app, dataset, run, against, runs }) {
  const loaded = useLoaded((signal) => diffOf(run, { against, limit: 1 }, signal), [run, against]);
  const diff = loaded.value;
  return html`<section class="panelbox rundiff" aria-labelledby="diff-title" aria-busy=${loaded.state === "loading"}>
    <header class="panelbox__head">
      <h2 id="diff-title">What run ${run} changed</h2>
      <${ComparedRunSelect} dataset=${dataset} run=${run} against=${diff?.against ?? against} runs=${runs} />
      <span class="panelbox__tools"><a class="button button--quiet" href=${linkTo("runs", { dataset })}>Close</a></span>
    </header>
    ${loaded.error && html`<${FailureLine} error=${loaded.error} onRetry=${loaded.reload} />`}
    ${loaded.state === "loading" && html`<div class="skeleton skeleton--tall shimmer"></div>`}
    ${diff && html`<${Between} app=${app} diff=${diff} />`}
  </section>`;
}

/** @param {{dataset: string, run: number, against: number | null, runs: readonly Run[]}} props */
function ComparedRunSelect({ dataset, run, against, runs }) {
  const others = runs.filter((other) => other.state === "done" && other.id !== run);
  const isListed = others.some(({ id }) => id === against);
  /** @param {{currentTarget: HTMLSelectElement}} event */
  const onChange = ({ currentTarget }) =>
    void (location.hash = linkTo("runs", { dataset }, { run: String(run), against: currentTarget.value }));
  return html`<label class="select rundiff__against"><span class="faint">against</span>
    <select aria-label="Run to compare with" value=${String(against ?? "")} onChange=${onChange}>
      ${
        !isListed &&
        html`<option value=${String(against ?? "")}>${against ? `run ${against}` : "choose a run"}</option>`
      }
      ${others.map(({ id, config }) => html`<option value=${String(id)}>run ${id} (${config.slice(0, 8)})</option>`)}
    </select>
  </label>`;
}

/** @param {{app: App, diff: RunDiff}} props */
function Between({ app, diff }) {
  if (diff.total === 0)
    return html`<p class="panelbox__empty">No verdict changed${diff.against ? ` since run ${diff.against}` : ""}.</p>
    <${Keys} diff=${diff} />`;
  return html`<div class="rundiff__body">
    <div class="rundiff__tables"><${PerClass} diff=${diff} /><${Keys} diff=${diff} /></div>
    <${Boxes} app=${app} diff=${diff} />
  </div>`;
}

/** @param {{diff: RunDiff}} props */
function PerClass({ diff }) {
  const rows = Object.entries(diff.by_class).sort(([, a], [, b]) => b - a);
  const most = Math.max(1, ...rows.map(([, n]) => n));
  return html`<${WideTable} label="Flips by class" heads=${["Class", numeric("Flips"), BAR]}>
        ${rows.map(
          ([name, n]) => html`<tr key=${name}><th scope="row">${name}</th><td class="is-num num">${countText(n)}</td>
            <td class="table__bar" aria-hidden="true">
              <span class="meter meter--accent"><i style=${{ width: `${(100 * n) / most}%` }}></i></span>
            </td></tr>`,
        )}
        <tr><th scope="row">All classes</th><td class="is-num num">${countText(diff.total)}</td>
          <td class="table__bar" aria-hidden="true"></td></tr>
    <//>`;
}

/** Which keys the two configurations differ in. @param {{diff: RunDiff}} props */
function Keys({ diff: { run, against } }) {
  const loaded = useLoaded(
    async (signal) => (against ? Promise.all([configOf(against, signal), configOf(run, signal)]) : null),
    [against, run],
  );
  if (loaded.error)
    return html`<${FailureLine} what="Configurations" error=${loaded.error} onRetry=${loaded.reload} />`;
  if (!loaded.value) return null;
  const rows = differences(loaded.value[0].config, loaded.value[1].config);
  return rows.length === 0
    ? html`<p class="faint">Both runs applied the same configuration.</p>`
    : html`<${DiffTable} rows=${rows} names=${[`Run ${against}`, `Run ${run}`]} />`;
}

/** @param {number} run @returns {(verdict: string) => string} */
const inRun = (run) => (verdict) => `${verdict} in run ${run}`;

/** @param {{app: App, diff: RunDiff}} props */
function Boxes({ app, diff }) {
  const [direction, setDirection] = useState("");
  const { items, isDone, error, more } = usePages(`diff ${diff.run} ${diff.against}`, PAGE, (limit, cursor) =>
    diffOf(diff.run, { against: diff.against, limit, cursor }),
  );
  const shown = items.filter((flip) => !direction || directionOf(flip) === direction);
  const words = { before: inRun(diff.against), after: inRun(diff.run) };
  return html`<div class="rundiff__boxes">
    <${DirectionTabs} direction=${direction} counts=${diff} onChange=${setDirection} />
    <div class="rundiff__flips"><${FlipGrid} items=${shown} words=${words} />
      ${error && html`<${FailureLine} error=${error} onRetry=${more} />`}
      ${
        !isDone &&
        items.length > 0 &&
        html`<p class="flippanel__more">
          <span class="faint">
            ${countText(items.length)} of ${countOf(diff.total, "box", "boxes")}, nearest to the threshold first</span>
          <button class="button button--small" onClick=${more}>Show more</button></p>`
      }
    </div>
  </div>`;
}

/**
 * Whether a run was stored, as done, when its dataset was created: it has decided nothing. A run that was carried out
 * has not ended at the very moment when it started.
 * @param {Pick<Run, "total" | "started_at" | "finished_at">} run
 */
export const isFirst = ({ total, started_at, finished_at }) =>
  total === 0 && started_at !== null && started_at === finished_at;

const KINDS = /** @type {Record<string, string>} */ ({ measure: "measured again", decide: "decided again" });

/** @param {{app: App, dataset: string, run: Run, isActive: boolean, isShown: boolean}} props */
function RunRow({ app, dataset, run, isActive, isShown }) {
  const took = run.total > 0 ? tookText(run.started_at, run.finished_at) : "";
  return html`<article class="run ${isShown ? "is-shown" : ""}" aria-label=${`Run ${run.id}`}>
    <div class="run__what">
      <span class="run__name">Run ${run.id}</span><${StateBadge} state=${run.state} />
      ${isActive && html`<span class="tagword">active</span>`}
      ${!run.activate && html`<span class="faint run__note">not activated</span>`}
    </div>
    <p class="run__about faint"><code title=${run.config}>${run.config.slice(0, 8)}</code>
      ${isFirst(run) ? "" : ` · ${KINDS[run.kind] ?? run.kind}`} · ${run.created_by}, ${agoText(run.created_at)}
      ${took && ` · took ${took.replaceAll(" ", "\u00a0")}`}</p>
    <div class="run__how"><${RunSummary} run=${run} /></div>
    <div class="run__actions">
      ${!isOver(run) && html`<${CancelButton} app=${app} run=${run} />`}
      ${
        run.state === "done" &&
        run.total > 0 &&
        html`<a class="button button--small"
          href=${linkTo("runs", { dataset }, isShown ? {} : { run: String(run.id) })}>
          ${isShown ? "Close" : "What changed"}<span class="sr-only"> in run ${run.id}</span></a>`
      }
    </div>
  </article>`;
}

/** @param {{run: Run}} props */
function RunSummary({ run }) {
  if (run.state === "failed")
    return html`<p class="run__error"><strong>Failed.</strong> ${run.error?.detail ?? "No reason was given."}</p>`;
  if (run.state === "cancelled")
    return html`<p
      class="faint">Stopped at ${countText(run.done)} of ${countOf(run.total, "frame")}; nothing was changed.</p>`;
  if (!isOver(run)) {
    return html`<${JobBar} job=${run} label=${`Run ${run.id}`} />
    <p class="faint num">
      ${
        run.state === "queued"
          ? "queued"
          : `${countText(run.done)} of ${countOf(run.total, "frame")}, ${percentDone(run)} %`
      }</p>`;
  }
  const { kept = 0, rejected = 0, unmeasured = 0 } = run.counts;
  const boxes = kept + rejected + unmeasured;
  if (boxes === 0)
    return html`<p class="faint">${isFirst(run) ? "Created with the dataset." : "There were no boxes."}</p>`;
  return html`<${VerdictBar} counts=${{ boxes, kept, rejected, unmeasured, reviewed: 0, to_review: 0 }} />
  <p class="faint num">
    ${countText(kept)} kept · ${countText(rejected)} rejected · <strong class="run__changed"
      title="Boxes with another verdict or reason than before">
      ${run.changed ? `${countText(run.changed)} changed` : "nothing changed"}</strong></p>`;
}
