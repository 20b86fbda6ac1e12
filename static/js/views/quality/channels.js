// @ts-check
// What each kind of evidence gets right, side by side, and the run that measures them all.

import { html, useEffect, useState } from "../../html.js";
import { jobs } from "../../calls/jobs.js";
import { loadEvaluation, startEvaluation } from "../../calls/quality.js";
import { linkTo } from "../../router.js";
import { isOver } from "../../watch.js";
import { channelText, countOf } from "../../wording.js";
import { useLoaded } from "../hooks.js";
import { Icon } from "../icons.js";
import { useWatched } from "../jobs/progress.js";
import { Segments } from "../parts.js";
import { RunStrip } from "../tuning/run_strip.js";
import { ChannelTable } from "./channel_table.js";

/** @typedef {import("../../app.js").App} App */
/** @typedef {import("../../types_jobs.js").Run} Run */
/** @typedef {import("../../types_quality.js").Evaluation} Evaluation */

const TRUTHS = [
  { value: "instances", text: "Instances" },
  { value: "people", text: "People" },
];
const BY = [
  { value: "all", text: "All boxes" },
  { value: "class", text: "Class" },
  { value: "distance", text: "Distance" },
];

/** @param {{app: App, dataset: string, active: string, truth: string, onTruth: (truth: string) => void, onMeasured: () => void}} props */
export function Channels({ app, dataset, active, truth, onTruth, onMeasured }) {
  const loaded = useLoaded(app, (signal) => loadEvaluation(dataset, truth, signal), [dataset, truth]);
  const measuring = useMeasuring(app, dataset, () => (loaded.reload(), onMeasured()));
  const [by, setBy] = useState("all");
  const found = loaded.value;
  const isCounted = found !== null && found.boxes > 0;
  return html`<section class="panelbox quality__wide" aria-labelledby="channels-title" aria-busy=${loaded.state === "loading"}>
    <header class="panelbox__head"><h2 id="channels-title">Channels compared</h2>
      <span class="faint">${truth === "people" ? "visible is what people kept" : "visible is what has a pixel in the instance image"}</span>
      <span class="panelbox__tools">
        ${isCounted && html`<${Segments} label="Compare channels by" value=${by} choices=${BY} onChange=${setBy} />`}
        <${Segments} label="Compare with" value=${truth} choices=${TRUTHS} onChange=${onTruth} />
        ${isCounted && found.not_measured.length > 0 && html`<${MeasureButton} measuring=${measuring} />`}
      </span></header>
    ${measuring.run && html`<${RunStrip} app=${app} dataset=${dataset} run=${measuring.run} onClose=${measuring.close} />`}
    ${loaded.state === "error" && !found && html`<p class="panelbox__empty" role="alert">${loaded.error.message} <button class="button button--small" onClick=${loaded.reload}>Try again</button></p>`}
    ${!found && loaded.state === "loading" && html`<div class="bone bone--row shimmer" aria-hidden="true"></div><p class="sr-only" role="status">Loading the comparison of channels</p>`}
    ${found && (isCounted ? html`<${Compared} dataset=${dataset} found=${found} by=${by} active=${active} />` : html`<${Nothing} dataset=${dataset} found=${found} measuring=${measuring} onTruth=${onTruth} />`)}
  </section>`;
}

/** @param {{dataset: string, found: Evaluation, by: string, active: string}} props */
const Compared = ({ dataset, found, by, active }) => html`<${ChannelTable} dataset=${dataset} found=${found} by=${by} active=${active} />
  <p class="faint channels__note">${countOf(found.boxes, "box", "boxes")} of ${countOf(found.frames, "frame")}; dot: measured, line: 95 % interval. Where a channel has no number for a box, the segmentation judges.
    ${found.truth === "instances" && found.channels.instance ? " The instance channel reads the image that says what is visible, so it is the ceiling rather than a rival." : ""}
    ${found.not_measured.length > 0 ? ` Not measured: ${found.not_measured.map((name) => channelText(name)).join(", ")}.` : ""}</p>`;

/** Why there is nothing to compare, and what would change that. @param {{dataset: string, found: Evaluation, measuring: Measuring, onTruth: (truth: string) => void}} props */
function Nothing({ dataset, found, measuring, onTruth }) {
  if (found.truth === "people") {
    return html`<p class="panelbox__empty">Nobody has kept or rejected a box yet, so there is nothing to compare with. <a href=${linkTo("queue", { dataset })}>Answer boxes</a></p>`;
  }
  if (found.not_measured.includes("instance")) {
    return html`<div class="panelbox__empty channels__ask">
      <p>Only the segmentation has been measured. Order, depth, instances and LiDAR are measured from the files that came with the frames; every verdict stays as it is.</p>
      <p><${MeasureButton} measuring=${measuring} /></p></div>`;
  }
  return html`<p class="panelbox__empty">No frame came with an instance image, which would say what is visible. <button class="button button--small" onClick=${() => onTruth("people")}>Compare with people</button></p>`;
}

/** @typedef {{run: Run | null, isBusy: boolean, start: () => void, close: () => void}} Measuring */

/** @param {{measuring: Measuring}} props */
const MeasureButton = ({ measuring: { start, isBusy } }) => html`<button class="button" disabled=${isBusy} onClick=${start}><${Icon} name="play" />Measure every channel</button>`;

/** The run that measures: asked for here, or already at work when one comes. @param {App} app @param {string} dataset @param {() => void} onDone @returns {Measuring} */
function useMeasuring(app, dataset, onDone) {
  const [asked, setAsked] = useState(/** @type {Run | null} */ (null));
  const [isSending, setSending] = useState(false);
  /** @param {Run} run */
  const settle = (run) => {
    if (run.state === "done") setAsked(null);
    onDone();
  };
  const run = useWatched(asked, settle);
  useEffect(() => {
    const stop = new AbortController();
    const look = async () => {
      const { items } = await jobs.runs(dataset, { limit: 5 }, stop.signal);
      const open = items.find((one) => one.kind === "measure" && !isOver(one));
      if (open) setAsked((now) => now ?? open);
    };
    // Without an answer the button is still there; who presses it is told what is wrong.
    look().catch(() => {});
    return () => stop.abort();
  }, [dataset]);
  const start = async () => {
    setSending(true);
    try {
      const started = await startEvaluation(dataset);
      if (isOver(started)) settle(started);
      else setAsked(started);
    } catch (error) {
      app.notice(error);
      app.toasts.show(error instanceof Error ? error.message : String(error), { kind: "error" });
    }
    setSending(false);
  };
  return { run, isBusy: isSending || (run !== null && !isOver(run)), start: () => void start(), close: () => setAsked(null) };
}
