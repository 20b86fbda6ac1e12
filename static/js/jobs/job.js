// @ts-check
// Runs and exports while they are on the page: their state, kept up to date, as bar and badge; cancelling them.

import { ApiError, NoResponse, createRetries, get, post } from "../core/api.js";
import { useLoaded, useTask } from "../core/hooks.js";
import { html, useEffect, useRef, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf, countText } from "../core/numbers.js";
import { linkTo } from "../core/router.js";

/** @typedef {Run["state"]} JobState */
/** @import { Later } from "../core/api.js" */
/** @import { App } from "../core/app.js" */
/** @import { Run } from "../core/openapi.js" */

const STATES = {
  queued: { icon: "clock", text: "queued" },
  running: { icon: "play", text: "running" },
  done: { icon: "check", text: "done" },
  failed: { icon: "warn", text: "failed" },
  cancelled: { icon: "cross", text: "cancelled" },
};

/** @param {{state: JobState}} props */
export function StateBadge({ state }) {
  const { icon, text } = STATES[state] ?? { icon: "question", text: state };
  return html`<span class="statebadge statebadge--${state}"><${Icon} name=${icon} />${text}</span>`;
}

/** @param {{job: {state: JobState, done?: number, total?: number}, label: string}} props */
export function JobBar({ job, label }) {
  const percent = percentDone(job);
  const isCounted = (job.total ?? 0) > 0;
  const isUnsure = job.state === "queued" || !isCounted;
  return html`<div class="jobbar ${isUnsure ? "jobbar--unsure" : ""}" role="progressbar" aria-label=${label}
    aria-valuemin="0" aria-valuemax="100" aria-valuenow=${isUnsure ? undefined : percent}
    aria-valuetext=${isCounted ? `${countText(job.done ?? 0)} of ${countText(job.total ?? 0)} frames` : job.state}>
    <span style=${{ width: `${isUnsure ? 30 : percent}%` }}></span>
  </div>`;
}

/**
 * The current state of a run, kept up to date while the component is on the page.
 * @param {Run | null} run
 * @param {{onOver?: (run: Run) => void, onLost: (error: ApiError) => void}} then `onLost`: its state cannot be loaded
 *   any more, for instance because its dataset was deleted
 * @returns {Run | null}
 */
export function useWatched(run, { onOver, onLost }) {
  const [seen, setSeen] = useState(run);
  useEffect(() => {
    setSeen(run);
    if (!run || isOver(run)) return undefined;
    const load = () => get("/api/v1/runs/{run_id}", { path: { run_id: run.id } });
    const onRun = /** @param {Run} next */ (next) => {
      setSeen(next);
      if (isOver(next)) onOver?.(next);
    };
    return watchJob(load, { onJob: onRun, onLost });
  }, [run]);
  return seen && run && seen.id === run.id ? seen : run;
}

/**
 * Look once for a run of the dataset that has not ended: somebody may have started it before this view was opened.
 * @param {string} dataset @param {(run: Run) => void} onFound @param {Run["kind"]} [kind]  of any kind if left out
 */
export function useOpenRun(dataset, onFound, kind) {
  const { value, error, reload } = useLoaded(
    (signal) => get("/api/v1/datasets/{dataset}/runs", { path: { dataset }, query: { limit: NEWEST }, signal }),
    [dataset],
  );
  useEffect(() => {
    const open = value?.items.findLast((run) => !isOver(run) && (!kind || run.kind === kind));
    if (open) onFound(open);
  }, [value]);
  return { error, reload };
}

/** How many of the newest runs are looked at. Of several that have not ended, the oldest is carried out first. */
const NEWEST = 20;

const LOOK_AGAIN_MS = 5000;

/**
 * Load a list of jobs again every few seconds, since other people start jobs too; every second while one of them has
 * not ended. Only in a visible tab, and one request at a time.
 * @param {{state: "loading" | "ready" | "error", value: unknown, reload: () => void}} list @param {readonly Job[]} jobs
 */
export function useLookAgain(list, jobs) {
  const latest = useRef(list);
  latest.current = list;
  const hasOpen = !jobs.every(isOver);
  useEffect(() => {
    const look = () => {
      const { state, value, reload } = latest.current;
      // Where nothing could be loaded, the person is asked whether to try again.
      const isLeft = state === "loading" || (state === "error" && value === null);
      if (document.visibilityState === "visible" && !isLeft) reload();
    };
    const timer = setInterval(look, hasOpen ? LONGEST_PAUSE_MS : LOOK_AGAIN_MS);
    document.addEventListener("visibilitychange", look);
    return () => {
      clearInterval(timer);
      document.removeEventListener("visibilitychange", look);
    };
  }, [hasOpen]);
}

/** @param {{app: App, run: Run}} props */
export const CancelButton = ({ app, run }) =>
  html`<${Canceller} app=${app} what=${`run ${run.id}`}
    cancel=${() => post("/api/v1/runs/{run_id}/cancel", { path: { run_id: run.id } })} />`;

/**
 * A button that cancels a job. It stays disabled until the job's state says that it is cancelled.
 * @param {{app: App, what: string, cancel: () => Promise<unknown>}} props
 */
export function Canceller({ app, what, cancel }) {
  const [isAsked, setAsked] = useState(false);
  const { run } = useTask(
    async () => {
      setAsked(true);
      await cancel();
    },
    (error) => {
      app.toasts.fail(error);
      setAsked(false);
    },
  );
  return html`<button class="button button--small" disabled=${isAsked}
    onClick=${run}>${isAsked ? "Cancelling…" : "Cancel"}<span class="sr-only"> ${what}</span></button>`;
}

/**
 * The state of a run, as a strip above a view.
 * @param {{app: App, dataset: string, run: Run, isOwn?: boolean, onClose: () => void}} props
 *   `isOwn`: the person has just started it: the strip is scrolled to
 */
export function RunStrip({ app, dataset, run, isOwn = false, onClose }) {
  const strip = useRef(/** @type {HTMLElement | null} */ (null));
  useEffect(() => void (isOwn && strip.current?.scrollIntoView({ block: "center" })), [isOwn]);
  return html`<section ref=${strip} class="runstrip runstrip--${run.state}" aria-label=${`Run ${run.id}`}>
    <${StateBadge} state=${run.state} />
    <p class="runstrip__text" role="status">${wordsOf(run)}</p>
    ${!isOver(run) && html`<${JobBar} job=${run} label=${`Run ${run.id}`} /><${CancelButton} app=${app} run=${run} />`}
    ${
      run.state === "done" &&
      html`<a class="button button--small"
        href=${linkTo("runs", { dataset }, { run: String(run.id) })}>See what changed</a>`
    }
    ${
      isOver(run) &&
      html`<button class="button button--quiet button--icon" aria-label="Close"
        onClick=${onClose}><${Icon} name="cross" /></button>`
    }
  </section>`;
}

/** @param {Run} run */
function wordsOf(run) {
  const what = run.kind === "measure" ? "measures every frame again" : "decides again from the stored measurements";
  switch (run.state) {
    case "queued":
      return `Run ${run.id} is queued.`;
    case "running":
      return `Run ${run.id} ${what}: ${countText(run.done)} of ${countOf(run.total, "frame")}.`;
    case "done":
      return `Run ${run.id} is done: ${countOf(run.changed, "box has", "boxes have")} a different verdict or reason.`;
    case "cancelled":
      return `Run ${run.id} was cancelled. The active run is unchanged.`;
    default:
      return `Run ${run.id} failed: ${run.error?.detail ?? "no reason was given"}`;
  }
}

/** @typedef {{state: Run["state"]}} Job */

const OVER = new Set(["done", "failed", "cancelled"]);

const FIRST_PAUSE_MS = 200;
const LONGEST_PAUSE_MS = 1000;

/** @param {Job} job */
export const isOver = (job) => OVER.has(job.state);

/**
 * Percent done; a job that has not counted its frames yet has done nothing.
 * @param {Job & {done?: number, total?: number}} job
 */
export function percentDone({ state, done = 0, total = 0 }) {
  if (state === "done") return 100;
  return total > 0 ? Math.min(100, Math.floor((100 * done) / total)) : 0;
}

/**
 * Load a job again and again until it has ended. (Its stream of events would hold a connection for as long as the job
 * lasts, and a browser opens only six to a server, for all its tabs together.)
 * @template {Job} J @param {() => Promise<J>} load
 * @param {{onJob: (job: J) => void, onLost: (error: ApiError) => void}} then `onLost`: the server refuses; it is not
 *   asked again
 * @param {Later} [later] @returns {() => void} stop watching
 */
export function watchJob(load, { onJob, onLost }, later = (run, delayMs) => void setTimeout(run, delayMs)) {
  const retries = createRetries(later);
  let isStopped = false;
  let pauseMs = FIRST_PAUSE_MS;
  async function look() {
    if (isStopped) return;
    try {
      const job = await load();
      if (isStopped) return;
      retries.reset();
      isStopped = isOver(job);
      onJob(job);
    } catch (error) {
      if (isStopped) return;
      if (error instanceof ApiError && !error.isTemporary) return onLost(error);
      if (!(error instanceof ApiError || error instanceof NoResponse)) throw error;
      return retries.wait(() => void look(), error instanceof ApiError ? error.retryAfterS : null);
    }
    pause();
  }
  function pause() {
    later(() => void look(), pauseMs);
    pauseMs = Math.min(2 * pauseMs, LONGEST_PAUSE_MS);
  }
  pause();
  return () => void (isStopped = true);
}
