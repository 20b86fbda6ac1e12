// @ts-check
// Runs and exports while they are on the page: followed by server-sent events, shown as bar and badge, cancelled.

import { ApiError, get, post, send, url } from "../core/api.js";
import { useTask } from "../core/hooks.js";
import { html, useEffect, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf, countText } from "../core/numbers.js";
import { linkTo } from "../core/router.js";

/** @typedef {import("../core/openapi.js").Run["state"]} JobState */
/** @typedef {import("../core/openapi.js").Run} Run */

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

/**
 * The current state of a job, kept up to date while the component is on the page.
 * @template {Job & {id: number}} J
 * @param {(id: number) => Watched<J>} watchedOf @param {J | null} job @param {(job: J) => void} [onOver]
 * @returns {J | null}
 */
export function useWatched(watchedOf, job, onOver) {
  const [seen, setSeen] = useState(job);
  useEffect(() => {
    setSeen(job);
    if (!job || isOver(job)) return undefined;
    return watchJob(watchedOf(job.id), (next) => {
      setSeen(next);
      if (isOver(next)) onOver?.(next);
    });
  }, [job]);
  return seen && job && seen.id === job.id ? seen : job;
}

const LOOK_AGAIN_MS = 5000;

/** Other people start jobs, too: reload every few seconds, and when the browser tab becomes visible. @param {() => void} reload */
export function useLookAgain(reload) {
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

/** @param {{app: import("../core/app.js").App, run: Run}} props */
export const CancelButton = ({ app, run }) => html`<${Canceller} app=${app} what=${`run ${run.id}`} cancel=${() => post("/api/v1/runs/{run_id}/cancel", { path: { run_id: run.id } })} />`;

/** A button that cancels a job. It stays disabled until the job's state says that it is cancelled. @param {{app: import("../core/app.js").App, what: string, cancel: () => Promise<unknown>}} props */
export function Canceller({ app, what, cancel }) {
  const [isAsked, setAsked] = useState(false);
  const { run } = useTask(async () => {
    setAsked(true);
    await cancel();
  }, (error) => {
    app.toasts.fail(error);
    setAsked(false);
  });
  return html`<button class="button button--small" disabled=${isAsked} onClick=${run}>${isAsked ? "Cancelling…" : "Cancel"}<span class="sr-only"> ${what}</span></button>`;
}

/** Values of `readyState`, as those of an EventSource. */
const CONNECTING = 0;
const OPEN = 1;
const CLOSED = 2;
const RETRY_MS = 1000;

/** @typedef {{event: string, data: string}} Told */

export class EventStream extends EventTarget {
  #stop = new AbortController();
  #lastId = "";
  #retryMs = RETRY_MS;
  readyState = CONNECTING;

  /** @param {string} url */
  constructor(url) {
    super();
    this.url = url;
    void this.#run();
  }

  close() {
    this.readyState = CLOSED;
    this.#stop.abort();
  }

  async #run() {
    while (this.readyState !== CLOSED) {
      const isRefused = await this.#listen();
      if (this.readyState === CLOSED) return;
      this.readyState = isRefused ? CLOSED : CONNECTING;
      this.dispatchEvent(new Event("error"));
      if (!isRefused) await new Promise((done) => setTimeout(done, this.#retryMs));
    }
  }

  /** @returns {Promise<boolean>} true: the server refused the stream, and reconnecting is useless */
  async #listen() {
    /** @type {Record<string, string>} */
    const headers = { Accept: "text/event-stream" };
    if (this.#lastId) headers["Last-Event-ID"] = this.#lastId;
    try {
      const answer = await send(this.url, { headers, cache: "no-store", signal: this.#stop.signal });
      if (answer.status !== 200 || !answer.body) return true;
      this.readyState = OPEN;
      await this.#read(answer.body);
      return false;
    } catch (error) {
      // Only an answer of the server is a refusal; a broken connection is tried again.
      return error instanceof ApiError;
    }
  }

  /** @param {ReadableStream<Uint8Array>} body */
  async #read(body) {
    const reader = body.getReader();
    const decoder = new TextDecoder();
    let rest = "";
    /** @type {Told} */
    let told = { event: "message", data: "" };
    for (let { value, done } = await reader.read(); !done; { value, done } = await reader.read()) {
      const lines = (rest + decoder.decode(value, { stream: true })).split(/\r\n|\r|\n/);
      rest = lines.pop() ?? "";
      for (const line of lines) told = this.#hear(line, told);
    }
  }

  /** @param {string} line @param {Told} told @returns {Told} the event received so far */
  #hear(line, told) {
    if (line === "") {
      if (told.data && this.readyState !== CLOSED) this.dispatchEvent(new MessageEvent(told.event, { data: told.data.slice(0, -1) }));
      return { event: "message", data: "" };
    }
    const [, field = "", value = ""] = /^([^:]*):? ?(.*)$/.exec(line) ?? [];
    if (field === "id") this.#lastId = value;
    if (field === "retry" && /^\d+$/.test(value)) this.#retryMs = Number(value);
    if (field === "event") return { ...told, event: value };
    return field === "data" ? { ...told, data: `${told.data}${value}\n` } : told;
  }
}

/** @param {{app: import("../core/app.js").App, dataset: string, run: Run, onClose: () => void}} props */
export function RunStrip({ app, dataset, run, onClose }) {
  return html`<section class="runstrip runstrip--${run.state}" aria-label=${`Run ${run.id}`}>
    <${StateBadge} state=${run.state} />
    <p class="runstrip__text" role="status">${wordsOf(run)}</p>
    ${!isOver(run) && html`<${JobBar} job=${run} label=${`Run ${run.id}`} /><${CancelButton} app=${app} run=${run} />`}
    ${run.state === "done" && html`<a class="button button--small" href=${linkTo("runs", { dataset }, { run: String(run.id) })}>See what changed</a>`}
    ${isOver(run) && html`<button class="button button--quiet button--icon" aria-label="Close" onClick=${onClose}><${Icon} name="cross" /></button>`}
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

/** @typedef {{state: import("../core/openapi.js").Run["state"]}} Job */

const OVER = new Set(["done", "failed", "cancelled"]);

const ASK_AGAIN_MS = 1000;

/** @param {Job} job */
export const isOver = (job) => OVER.has(job.state);

/** Percent done; a job that has not counted its frames yet has done nothing. @param {Job & {done?: number, total?: number}} job */
export function percentDone({ state, done = 0, total = 0 }) {
  if (state === "done") return 100;
  return total > 0 ? Math.min(100, Math.floor((100 * done) / total)) : 0;
}

/** @template {Job} J @typedef {{events: string, load: () => Promise<J>}} Watched  the address of a job's events, and how its state is loaded if events are refused */

/** @param {number} id @returns {Watched<Run>} */
export const runEvents = (id) => ({
  events: url("/api/v1/runs/{run_id}/events", { path: { run_id: id } }),
  load: () => get("/api/v1/runs/{run_id}", { path: { run_id: id } }),
});

/** @param {number} id @returns {Watched<import("../core/openapi.js").Export>} */
export const exportEvents = (id) => ({
  events: url("/api/v1/exports/{export_id}/events", { path: { export_id: id } }),
  load: () => get("/api/v1/exports/{export_id}", { path: { export_id: id } }),
});

/**
 * Follow a job until it has ended. `onJob` may be called twice with the same state.
 * @template {Job} J
 * @param {Watched<J>} watched
 * @param {(job: J) => void} onJob
 * @param {{open?: (address: string) => EventStream, pauseMs?: number}} [how]
 * @returns {() => void} stop watching
 */
export function watchJob({ events, load }, onJob, { open = (address) => new EventStream(address), pauseMs = ASK_AGAIN_MS } = {}) {
  let isStopped = false;
  const source = open(events);
  const stop = () => {
    isStopped = true;
    source.close();
  };
  /** @param {Event} event */
  const hear = (event) => {
    if (isStopped || !(event instanceof MessageEvent) || !event.data) return;
    const job = JSON.parse(event.data);
    if (isOver(job)) stop();
    onJob(job);
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
        const job = await load();
        if (isStopped) return;
        if (isOver(job)) stop();
        onJob(job);
      } catch (error) {
        if (error instanceof ApiError && !error.isTemporary) return stop();
      }
      if (!isStopped) await new Promise((done) => setTimeout(done, pauseMs));
    }
  };
  return stop;
}
