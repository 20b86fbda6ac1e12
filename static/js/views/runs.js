// @ts-check
// Runs and exports of a dataset: how far they are, what they changed, what can be downloaded.

import { html, useEffect, useState } from "../html.js";
import { jobs } from "../calls/jobs.js";
import { linkTo } from "../router.js";
import { isOver } from "../watch.js";
import { useLoaded, useTitle } from "./hooks.js";
import { Exports } from "./jobs/exports.js";
import { RunDiffPanel } from "./jobs/run_diff.js";
import { RunRow } from "./jobs/run_row.js";
import { Failure } from "./parts.js";
import { TopBar } from "./topbar.js";

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../router.js").Route} Route */
/** @typedef {import("../types_jobs.js").Run} Run */

const FIRST = 25;
const MOST = 1000;
const LOOK_AGAIN_MS = 5000;

/** @param {{app: App, route: Route}} props */
export const RunsView = ({ app, route }) => html`<${RunsOf} key=${route.params.dataset} app=${app} route=${route} />`;

/** One dataset: nothing of another one is left over. @param {{app: App, route: import("../router.js").Route}} props */
function RunsOf({ app, route }) {
  const name = route.params.dataset ?? "";
  useTitle(`Runs and exports · ${name}`);
  const [limit, setLimit] = useState(FIRST);
  const dataset = useLoaded(app, (signal) => app.api.dataset(name, signal), [name]);
  const runs = useLoaded(app, (signal) => jobs.runs(name, { limit }, signal), [name, limit]);
  const reload = () => (runs.reload(), dataset.reload());
  useLookAgain(runs.reload);
  const failed = [dataset, runs].find((loaded) => loaded.state === "error" && !loaded.value);
  const { run = "", against = "" } = route.query;
  return html`<${TopBar} app=${app} crumbs=${[{ text: "Datasets", href: linkTo("datasets") }, { text: name }]} />
    <main id="main" class="page" tabindex="-1" aria-busy=${!runs.value}>
      <div class="page__head"><h1>Runs and exports</h1></div>
      ${failed?.error
        ? html`<${Failure} error=${failed.error} onRetry=${reload} />`
        : html`${run && html`<${RunDiffPanel} key=${`${run} ${against}`} app=${app} dataset=${name} run=${Number(run)} against=${Number(against) || null} runs=${runs.value?.items ?? []} />`}
            <div class="jobs">
              <${Runs} app=${app} dataset=${name} runs=${runs.value?.items ?? null} active=${activeRun(dataset.value)} shown=${Number(run) || null} onOver=${reload} />
              <${Exports} app=${app} dataset=${name} />
            </div>
            ${runs.value?.next_cursor && limit < MOST && html`<p class="more"><button class="button" onClick=${() => setLimit(MOST)}>Older runs</button></p>`}`}
    </main>`;
}

/** @param {import("../types.js").Dataset | null} dataset */
const activeRun = (dataset) => /** @type {{active_run?: number} | null} */ (dataset)?.active_run ?? null;

/** Others start runs, too: look now and then, and at once when somebody comes back. @param {() => void} reload */
function useLookAgain(reload) {
  useEffect(() => {
    const look = () => document.visibilityState === "visible" && reload();
    const timer = setInterval(look, LOOK_AGAIN_MS);
    document.addEventListener("visibilitychange", look);
    return () => {
      clearInterval(timer);
      document.removeEventListener("visibilitychange", look);
    };
  }, [reload]);
}

/** @param {{app: App, dataset: string, runs: readonly Run[] | null, active: number | null, shown: number | null, onOver: () => void}} props */
function Runs({ app, dataset, runs, active, shown, onOver }) {
  const open = runs?.filter((run) => !isOver(run)).length ?? 0;
  return html`<section class="panelbox" aria-labelledby="runs-title">
    <header class="panelbox__head">
      <h2 id="runs-title">Runs</h2>
      <span class="faint">${open ? `${open} at work or waiting` : "a configuration applied to the whole dataset"}</span>
      <span class="panelbox__tools"><a class="button" href=${linkTo("thresholds", { dataset })}>Try thresholds</a></span>
    </header>
    ${runs === null && html`<div aria-hidden="true">${[0, 1, 2].map(() => html`<div class="bone bone--row shimmer"></div>`)}</div><p class="sr-only" role="status">Loading runs</p>`}
    ${runs?.length === 0 && html`<p class="panelbox__empty">No run yet.</p>`}
    <ul class="runs">
      ${runs?.map((run) => html`<li key=${run.id}><${RunRow} app=${app} dataset=${dataset} run=${run} isActive=${run.id === active} isShown=${run.id === shown} onOver=${onOver} /></li>`)}
    </ul>
  </section>`;
}
