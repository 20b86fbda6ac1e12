// @ts-check
// How far a run is: told by the server's events, or asked for when there are none. No DOM.

import { ApiError } from "./api.js";
import { jobs } from "./calls/jobs.js";
import { EventStream } from "./events.js";

/** @typedef {import("./types_jobs.js").Run} Run */
/** @typedef {{state: import("./types_jobs.js").JobState}} Job */

const OVER = new Set(["done", "failed", "cancelled"]);
const ASK_AGAIN_MS = 1000;

/** @param {Job} job */
export const isOver = (job) => OVER.has(job.state);

/** Percent done; a job that has not counted its frames yet has done nothing. @param {Job & {done?: number, total?: number}} job */
export function percentDone({ state, done = 0, total = 0 }) {
  if (state === "done") return 100;
  return total > 0 ? Math.min(100, Math.floor((100 * done) / total)) : 0;
}

/**
 * Tell of a run until it is over. `onRun` may be told the same state twice.
 * @param {number} id
 * @param {(run: Run) => void} onRun
 * @param {{open?: (url: string) => EventStream, load?: (id: number) => Promise<Run>, pauseMs?: number}} [how]
 * @returns {() => void} stop watching
 */
export function watchRun(id, onRun, { open = (url) => new EventStream(url), load = jobs.run, pauseMs = ASK_AGAIN_MS } = {}) {
  let isStopped = false;
  const source = open(jobs.eventsUrl(id));
  const stop = () => {
    isStopped = true;
    source.close();
  };
  /** @param {Event} event */
  const hear = (event) => {
    if (isStopped || !(event instanceof MessageEvent) || !event.data) return;
    const run = JSON.parse(event.data);
    if (isOver(run)) stop();
    onRun(run);
  };
  source.addEventListener("progress", hear);
  source.addEventListener("end", hear);
  // A lost connection is opened again by the stream itself; a refused one is closed.
  source.addEventListener("error", () => {
    if (!isStopped && source.readyState === 2) void ask();
  });

  const ask = async () => {
    while (!isStopped) {
      try {
        const run = await load(id);
        if (isStopped) return;
        if (isOver(run)) stop();
        onRun(run);
      } catch (error) {
        if (error instanceof ApiError && !error.isTemporary) return stop();
      }
      if (!isStopped) await new Promise((done) => setTimeout(done, pauseMs));
    }
  };
  return stop;
}
