// @ts-check
// The kinds of evidence compared, and the run that measures them.

import { listQuery } from "../boxes/filters.js";
import { EVIDENCE, evidenceText } from "../boxes/wording.js";
import { get, post } from "../core/api.js";
import { useLoaded, useTask } from "../core/hooks.js";
import { html, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf, countText, percentText } from "../core/numbers.js";
import { FailureLine, Segments, WideTable, numeric } from "../core/parts.js";
import { linkTo } from "../core/router.js";
import { RunStrip, isOver, useOpenRun, useWatched } from "../jobs/job.js";
import { MeasureCell, SCORE_HEADS } from "./comparison.js";
import { TRUTHS, bandText } from "./measures.js";

/** @import { App } from "../core/app.js" */
/** @import { ChannelScore, Evaluation, Run, Score } from "../core/openapi.js" */

const BY = [
  { value: "all", text: "All boxes" },
  { value: "class", text: "Class" },
  { value: "distance", text: "Distance" },
];

/**
 * @param {{app: App, dataset: string, active: string, truth: Evaluation["truth"], onTruth: (truth: string) => void,
 *   onMeasured: () => void}} props
 */
export function Channels({ app, dataset, active, truth, onTruth, onMeasured }) {
  const loaded = useLoaded(
    (signal) => get("/api/v1/datasets/{dataset}/evaluations", { path: { dataset }, query: { truth }, signal }),
    [dataset, truth],
  );
  const measuring = useMeasuring(app, dataset, () => (loaded.reload(), onMeasured()));
  const [by, setBy] = useState("all");
  // What was loaded last compares with something else.
  const found = loaded.error ? null : loaded.value;
  const isCounted = found !== null && found.boxes > 0;
  return html`<section class="panelbox quality__wide" aria-labelledby="channels-title"
    aria-busy=${loaded.state === "loading"}>
    <header class="panelbox__head"><h2 id="channels-title">Kinds of evidence compared</h2>
      <span class="faint">
        ${
          truth === "people"
            ? "of the answered boxes alone; visible: people kept it"
            : "visible: it has a pixel in the instance image"
        }</span>
      <span class="panelbox__tools">
        ${
          isCounted &&
          html`<${Segments} label="Compare kinds of evidence by" value=${by} choices=${BY} onChange=${setBy} />`
        }
        <${Segments} label="Compare with" value=${truth} choices=${TRUTHS} onChange=${onTruth} />
        ${isCounted && found.not_measured.length > 0 && html`<${MeasureButton} measuring=${measuring} />`}
      </span></header>
    ${
      measuring.run &&
      html`<${RunStrip} app=${app} dataset=${dataset} run=${measuring.run} onClose=${measuring.close} />`
    }
    ${
      measuring.search.error &&
      html`<${FailureLine} what="Runs" error=${measuring.search.error} onRetry=${measuring.search.reload} />`
    }
    ${loaded.error && html`<${FailureLine} error=${loaded.error} onRetry=${loaded.reload} />`}
    ${
      !found &&
      loaded.state === "loading" &&
      html`<div class="skeleton skeleton--row shimmer" aria-hidden="true"></div>
      <p class="sr-only" role="status">Loading the comparison of kinds of evidence</p>`
    }
    ${
      found &&
      (isCounted
        ? html`<${Compared} dataset=${dataset} found=${found} by=${by} active=${active} />`
        : html`<${NoComparison} dataset=${dataset} found=${found} measuring=${measuring} onTruth=${onTruth} />`)
    }
  </section>`;
}

/** @param {{dataset: string, found: Evaluation, by: string, active: string}} props */
const Compared = ({
  dataset,
  found,
  by,
  active,
}) => html`<${ChannelTable} dataset=${dataset} found=${found} by=${by} active=${active} />
<p class="faint channels__note">
  ${countOf(found.boxes, "box", "boxes")} of ${countOf(found.frames, "frame")}
  ; dot: measured, line: 95 % interval. Boxes that a kind could not measure are decided by the segmentation.
  ${found.truth === "instances" && found.channels.instance ? " The instance images also define what is visible here, so their score is an upper bound." : ""}
  ${
    found.not_measured.length > 0
      ? ` Not measured: ${found.not_measured.map((name) => evidenceText(name)).join(", ")}.`
      : ""
  }</p>`;

/**
 * Why there is nothing to compare, and what to do about it.
 * @param {{dataset: string, found: Evaluation, measuring: Measuring, onTruth: (truth: string) => void}} props
 */
function NoComparison({ dataset, found, measuring, onTruth }) {
  if (found.truth === "people") {
    return html`<p
      class="panelbox__empty">Nobody has kept or rejected a box yet, so there is nothing to compare with. <a
        href=${linkTo("queue", { dataset })}>Answer boxes</a></p>`;
  }
  if (found.not_measured.includes("instance")) {
    return html`<div class="panelbox__empty channels__ask">
      <p>
        Only the segmentation has been measured. Order, depth, instances and LiDAR are measured from the files that came
        with the frames; every verdict stays as it is.</p>
      <p><${MeasureButton} measuring=${measuring} /></p></div>`;
  }
  return html`<p class="panelbox__empty">No frame has an instance image, so visibility is unknown. <button
      class="button button--small" onClick=${() => onTruth("people")}>Compare with people</button></p>`;
}

/**
 * @typedef {{run: Run | null, search: ReturnType<typeof useOpenRun>, isBusy: boolean, start: () => void, close: () =>
 *   void}} Measuring
 */

/** @param {{measuring: Measuring}} props */
const MeasureButton = ({ measuring: { start, isBusy } }) =>
  html`<button class="button" disabled=${isBusy} onClick=${start}><${Icon} name="play" />Measure every kind</button>`;

/**
 * The run that measures all channels: started here, or already running when the view is opened.
 * @param {App} app @param {string} dataset @param {() => void} onDone @returns {Measuring}
 */
function useMeasuring(app, dataset, onDone) {
  const [asked, setAsked] = useState(/** @type {Run | null} */ (null));
  /** @param {Run} run */
  const afterEnd = (run) => {
    if (run.state === "done") setAsked(null);
    onDone();
  };
  const run = useWatched(asked, {
    onOver: afterEnd,
    onLost: (error) => {
      setAsked(null);
      app.toasts.fail(error);
    },
  });
  const search = useOpenRun(dataset, (found) => setAsked((now) => now ?? found), "measure");
  /** Measure every channel that the frames' files allow. */
  const start = useTask(async () => {
    const started = await post("/api/v1/datasets/{dataset}/evaluations", { path: { dataset } });
    if (isOver(started)) afterEnd(started);
    else setAsked(started);
  }, app.toasts.fail);
  return {
    run,
    search,
    isBusy: start.isBusy || (run !== null && !isOver(run)),
    start: () => void start.run(),
    close: () => setAsked(null),
  };
}

/** @param {{dataset: string, found: Evaluation, by: string, active: string}} props */
function ChannelTable({ dataset, found, by, active }) {
  const channels = Object.entries(found.channels);
  if (by === "all")
    return html`<${OverallTable} dataset=${dataset} channels=${channels} found=${found} active=${active} />`;
  return html`<${WideTable} label="Kinds of evidence" kind="groups channels channels--matrix"
    caption=${`F1 of each kind of evidence by ${by}`}
    heads=${[
      by === "class" ? "Class" : "Distance",
      ...channels.map(([name]) => ({ text: html`${evidenceText(name)} <span class="faint">F1</span>` })),
    ]}>
    ${groupsOf(channels, by).map(
      ({ key, text, scores }) => html`<tr key=${key}>
        <th scope="row">${text}</th>
        ${scores.map(
          (score, at) => html`<td key=${at}>
            <${MeasureCell} measure=${score?.f1 ?? null} name=${`F1 of ${evidenceText(channels[at]?.[0] ?? "")}`} />
          </td>`,
        )}
      </tr>`,
    )}<//>`;
}

/**
 * @param {readonly [string, ChannelScore][]} channels @param {string} by
 * @returns {{key: string, text: string, scores: (Score | undefined)[]}[]}
 */
function groupsOf(channels, by) {
  const [, first] = channels[0] ?? [];
  if (!first) return [];
  if (by === "class")
    return Object.keys(first.by_class).map((name) => ({
      key: name,
      text: name,
      scores: channels.map(([, one]) => one.by_class[name]),
    }));
  return first.by_distance.map(({ band }) => ({
    key: band,
    text: bandText(band),
    scores: channels.map(([, one]) => one.by_distance.find((score) => score.band === band)),
  }));
}

const CHANNEL_HEADS = [
  "Evidence",
  numeric("Measured", "Boxes that it could measure"),
  ...SCORE_HEADS,
  { text: "Worst", title: "The boxes that it got most clearly wrong" },
];

/** @param {{dataset: string, channels: readonly [string, ChannelScore][], found: Evaluation, active: string}} props */
const OverallTable = ({
  dataset,
  channels,
  found: { boxes, unfiltered },
  active,
}) => html`<${WideTable} label="Kinds of evidence" kind="groups channels" heads=${CHANNEL_HEADS}
  caption="Precision, recall and F1 of each kind of evidence">
    ${
      unfiltered &&
      html`<tr><th scope="row">No filter<span class="faint channels__about">Every box as it is recorded</span></th>
        <td class="is-num num">–</td><td><${MeasureCell} measure=${unfiltered.precision} name="Precision" /></td>
        <td><${MeasureCell} measure=${unfiltered.recall} name="Recall" /></td>
        <td><${MeasureCell} measure=${unfiltered.f1} name="F1" /></td>
        <td class="is-num num">${countText(unfiltered.kept_hidden)}</td><td class="is-num num">0</td><td></td></tr>`
    }
      ${channels.map(
        ([name, score]) => html`<tr key=${name}>
          <th scope="row">${evidenceText(name)}${name === active && html` <span class="tagword">active</span>`}
            <span class="faint channels__about">${EVIDENCE[name]?.about}</span></th>
          <td class="is-num num" title=${`${countText(score.judged)} of ${countText(boxes)} boxes`}>
            ${percentText((100 * score.judged) / boxes)}
          </td>
          <td><${MeasureCell} measure=${score.precision} name="Precision" /></td>
          <td><${MeasureCell} measure=${score.recall} name="Recall" /></td>
          <td><${MeasureCell} measure=${score.f1} name="F1" /></td>
          <td class="is-num num">${countText(score.kept_hidden)}</td>
          <td class="is-num num">${countText(score.rejected_visible)}</td>
          <td><${WorstLink} dataset=${dataset} name=${name} worst=${score.worst} /></td>
        </tr>`,
      )}
  <//>`;

/**
 * A link to the boxes that a kind of evidence got most clearly wrong.
 * @param {{dataset: string, name: string, worst: ChannelScore["worst"]}} props
 */
function WorstLink({ dataset, name, worst }) {
  if (worst.length === 0) return html`<span class="faint">none</span>`;
  const link = linkTo("queue", { dataset }, listQuery(worst.map(({ box_id }) => box_id)));
  return html`<a class="channels__worst"
    href=${link}>Look at ${countText(worst.length)}<span class="sr-only"> that ${evidenceText(name)} got wrong</span>
  </a>`;
}
