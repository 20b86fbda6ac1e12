// @ts-check
// How far a run or an export is: its state in words, a bar, and a way to stop it.

import { html, useEffect, useState } from "../../html.js";
import { jobs } from "../../calls/jobs.js";
import { isOver, percentDone, watchRun } from "../../watch.js";
import { countText } from "../../wording.js";
import { Icon } from "../icons.js";

/** @typedef {import("../../types_jobs.js").Run} Run */
/** @typedef {import("../../types_jobs.js").JobState} JobState */

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
  return html`<div class="jobbar ${isUnsure ? "jobbar--unsure" : ""}" role="progressbar" aria-label=${label} aria-valuemin="0" aria-valuemax="100" aria-valuenow=${isUnsure ? undefined : percent}
    aria-valuetext=${isCounted ? `${countText(job.done ?? 0)} of ${countText(job.total ?? 0)} frames` : job.state}>
    <span style=${{ width: `${isUnsure ? 30 : percent}%` }}></span>
  </div>`;
}

/** A run as it is now, for as long as somebody looks. @param {Run | null} run @param {(run: Run) => void} [onOver] @returns {Run | null} */
export function useWatched(run, onOver) {
  const [seen, setSeen] = useState(run);
  useEffect(() => {
    setSeen(run);
    if (!run || isOver(run)) return undefined;
    return watchRun(run.id, (next) => {
      setSeen(next);
      if (isOver(next)) onOver?.(next);
    });
  }, [run]);
  return seen && run && seen.id === run.id ? seen : run;
}

/** @param {{app: import("../../app.js").App, run: Run}} props */
export const CancelButton = ({ app, run }) => html`<${Canceller} app=${app} what=${`run ${run.id}`} cancel=${() => jobs.cancelRun(run.id)} />`;

/** Asked for once; the state of the job says when it is so. @param {{app: import("../../app.js").App, what: string, cancel: () => Promise<unknown>}} props */
export function Canceller({ app, what, cancel }) {
  const [isAsked, setAsked] = useState(false);
  const ask = async () => {
    setAsked(true);
    try {
      await cancel();
    } catch (error) {
      app.notice(error);
      app.toasts.show(error instanceof Error ? error.message : String(error), { kind: "error" });
      setAsked(false);
    }
  };
  return html`<button class="button button--small" disabled=${isAsked} onClick=${ask}>${isAsked ? "Cancelling…" : "Cancel"}<span class="sr-only"> ${what}</span></button>`;
}
