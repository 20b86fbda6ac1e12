// @ts-check
// What lies between two runs: counts per class, and the boxes that changed sides.

import { html, useState } from "../../html.js";
import { jobs } from "../../calls/jobs.js";
import { linkTo } from "../../router.js";
import { differences } from "../../tuning.js";
import { countOf, countText } from "../../wording.js";
import { useLoaded } from "../hooks.js";
import { usePages } from "../pages.js";
import { DiffTable } from "../tuning/save_dialog.js";
import { FlipGrid, WayTabs, wayOf } from "../tuning/flips.js";

/** @typedef {import("../../types_jobs.js").Run} Run */
/** @typedef {import("../../types_jobs.js").RunDiff} RunDiff */
/** @typedef {import("../../app.js").App} App */

const PAGE = 60;

/** @param {{app: App, dataset: string, run: number, against: number | null, runs: readonly Run[]}} props */
export function RunDiffPanel({ app, dataset, run, against, runs }) {
  const loaded = useLoaded(app, (signal) => jobs.diff(run, { against: against ?? undefined, limit: 1 }, signal), [run, against]);
  const diff = loaded.value;
  return html`<section class="panelbox rundiff" aria-labelledby="diff-title" aria-busy=${loaded.state === "loading"}>
    <header class="panelbox__head">
      <h2 id="diff-title">What run ${run} changed</h2>
      <${Against} dataset=${dataset} run=${run} against=${diff?.against ?? against} runs=${runs} />
      <span class="panelbox__tools"><a class="button button--quiet" href=${linkTo("runs", { dataset })}>Close</a></span>
    </header>
    ${loaded.state === "error" && html`<p class="panelbox__empty" role="alert">${loaded.error.message}</p>`}
    ${loaded.state === "loading" && html`<div class="bone bone--tall shimmer"></div>`}
    ${diff && html`<${Between} app=${app} diff=${diff} runs=${runs} />`}
  </section>`;
}

/** @param {{dataset: string, run: number, against: number | null, runs: readonly Run[]}} props */
function Against({ dataset, run, against, runs }) {
  const others = runs.filter((other) => other.state === "done" && other.id !== run);
  const isListed = others.some(({ id }) => id === against);
  /** @param {{currentTarget: HTMLSelectElement}} event */
  const onChange = ({ currentTarget }) => void (location.hash = linkTo("runs", { dataset }, { run: String(run), against: currentTarget.value }));
  return html`<label class="select rundiff__against"><span class="faint">against</span>
    <select aria-label="Run to compare with" value=${String(against ?? "")} onChange=${onChange}>
      ${!isListed && html`<option value=${String(against ?? "")}>${against ? `run ${against}` : "choose a run"}</option>`}
      ${others.map(({ id, config }) => html`<option value=${String(id)}>run ${id} (${config.slice(0, 8)})</option>`)}
    </select>
  </label>`;
}

/** @param {{app: App, diff: RunDiff, runs: readonly Run[]}} props */
function Between({ app, diff, runs }) {
  if (diff.total === 0) return html`<p class="panelbox__empty">No box changed sides${diff.against ? ` since run ${diff.against}` : ""}.</p><${Keys} app=${app} diff=${diff} runs=${runs} />`;
  return html`<div class="rundiff__body">
    <div class="rundiff__tables"><${PerClass} diff=${diff} /><${Keys} app=${app} diff=${diff} runs=${runs} /></div>
    <${Boxes} app=${app} diff=${diff} />
  </div>`;
}

/** @param {{diff: RunDiff}} props */
function PerClass({ diff }) {
  const rows = Object.entries(diff.by_class).sort(([, a], [, b]) => b - a);
  const most = Math.max(1, ...rows.map(([, n]) => n));
  return html`<div class="tablewrap"><table class="table">
    <thead><tr><th scope="col">Class</th><th class="is-num" scope="col">Flips</th><th class="table__bar" aria-hidden="true"></th></tr></thead>
    <tbody>
      ${rows.map(([name, n]) => html`<tr key=${name}><th scope="row">${name}</th><td class="is-num num">${countText(n)}</td><td class="table__bar" aria-hidden="true"><span class="meter meter--accent"><i style=${{ width: `${(100 * n) / most}%` }}></i></span></td></tr>`)}
      <tr><th scope="row">All classes</th><td class="is-num num">${countText(diff.total)}</td><td class="table__bar" aria-hidden="true"></td></tr>
    </tbody>
  </table></div>`;
}

/** Which keys the two configurations differ in. @param {{app: App, diff: RunDiff, runs: readonly Run[]}} props */
function Keys({ app, diff, runs }) {
  const [before, after] = [diff.against, diff.run].map((id) => runs.find((run) => run.id === id)?.config);
  const loaded = useLoaded(app, async (signal) => (before && after ? Promise.all([jobs.config(before, signal), jobs.config(after, signal)]) : null), [before, after]);
  if (!loaded.value) return null;
  const rows = differences(loaded.value[0].config, loaded.value[1].config);
  return rows.length === 0
    ? html`<p class="faint">Both runs applied the same configuration.</p>`
    : html`<${DiffTable} rows=${rows} names=${[`Run ${diff.against}`, `Run ${diff.run}`]} />`;
}

/** @param {{app: App, diff: RunDiff}} props */
function Boxes({ app, diff }) {
  const [way, setWay] = useState("");
  const { items, isDone, error, more } = usePages(app, `diff ${diff.run} ${diff.against}`, PAGE, (limit, cursor) =>
    jobs.diff(diff.run, { against: diff.against ?? undefined, limit, cursor }),
  );
  const shown = items.filter((flip) => !way || wayOf(flip) === way);
  return html`<div class="rundiff__boxes">
    <${WayTabs} way=${way} lost=${diff.kept_to_rejected} won=${diff.rejected_to_kept} onChange=${setWay} />
    <div class="rundiff__flips"><${FlipGrid} app=${app} items=${shown} />
      ${error && html`<p role="alert">${error.message}</p>`}
      ${!isDone && items.length > 0 && html`<p class="flippanel__more"><span class="faint">${countText(items.length)} of ${countOf(diff.total, "box", "boxes")}, nearest to the threshold first</span><button class="button button--small" onClick=${more}>Show more</button></p>`}
    </div>
  </div>`;
}
