// @ts-check
// Channels as rows; or the F1 of each, per class or band of distance.

import { html } from "../../html.js";
import { bandText } from "../../measures.js";
import { listQuery } from "../../queue/listed.js";
import { linkTo } from "../../router.js";
import { CHANNELS, channelText, countText, percentText } from "../../wording.js";
import { MeasureCell } from "./whisker.js";

/** @typedef {import("../../types_quality.js").Evaluation} Evaluation */
/** @typedef {import("../../types_quality.js").ChannelScore} ChannelScore */
/** @typedef {import("../../types_quality.js").Score} Score */

/** @param {{dataset: string, found: Evaluation, by: string, active: string}} props */
export function ChannelTable({ dataset, found, by, active }) {
  const channels = Object.entries(found.channels);
  if (by === "all") return html`<${Whole} dataset=${dataset} channels=${channels} boxes=${found.boxes} active=${active} />`;
  return html`<div class="tablewrap" role="group" aria-label="Channels" tabindex="0"><table class="table groups channels channels--matrix">
    <caption class="sr-only">F1 of each channel by ${by}</caption>
    <thead><tr><th scope="col">${by === "class" ? "Class" : "Distance"}</th>${channels.map(([name]) => html`<th scope="col" key=${name}>${channelText(name)} <span class="faint">F1</span></th>`)}</tr></thead>
    <tbody>${groupsOf(channels, by).map(({ key, text, scores }) => html`<tr key=${key}>
      <th scope="row">${text}</th>
      ${scores.map((score, at) => html`<td key=${at}><${MeasureCell} measure=${score?.f1 ?? null} name=${`F1 of ${channelText(channels[at]?.[0] ?? "")}`} /></td>`)}
    </tr>`)}</tbody>
  </table></div>`;
}

/** @param {readonly [string, ChannelScore][]} channels @param {string} by @returns {{key: string, text: string, scores: (Score | undefined)[]}[]} */
function groupsOf(channels, by) {
  const [, first] = channels[0] ?? [];
  if (!first) return [];
  if (by === "class") return Object.keys(first.by_class).map((name) => ({ key: name, text: name, scores: channels.map(([, one]) => one.by_class[name]) }));
  return first.by_distance.map(({ band }) => ({ key: band, text: bandText(band), scores: channels.map(([, one]) => one.by_distance.find((score) => score.band === band)) }));
}

/** @param {{dataset: string, channels: readonly [string, ChannelScore][], boxes: number, active: string}} props */
const Whole = ({ dataset, channels, boxes, active }) => html`<div class="tablewrap" role="group" aria-label="Channels" tabindex="0"><table class="table groups channels">
  <caption class="sr-only">Precision, recall and F1 of each channel</caption>
  <thead><tr><th scope="col">Channel</th><th class="is-num" scope="col" title="Boxes that it had a number for">Judged</th><th scope="col">Precision</th><th scope="col">Recall</th><th scope="col">F1</th><th class="is-num" scope="col">Kept ghosts</th><th class="is-num" scope="col">Lost boxes</th><th scope="col">Worst</th></tr></thead>
  <tbody>${channels.map(([name, score]) => html`<tr key=${name}>
    <th scope="row">${channelText(name)}${name === active && html` <span class="tagword">active</span>`}<span class="faint channels__about">${CHANNELS[name]?.about}</span></th>
    <td class="is-num num" title=${`${countText(score.judged)} of ${countText(boxes)} boxes`}>${percentText((100 * score.judged) / boxes)}</td>
    <td><${MeasureCell} measure=${score.precision} name="Precision" /></td>
    <td><${MeasureCell} measure=${score.recall} name="Recall" /></td>
    <td><${MeasureCell} measure=${score.f1} name="F1" /></td>
    <td class="is-num num">${countText(score.kept_hidden)}</td>
    <td class="is-num num">${countText(score.rejected_visible)}</td>
    <td><${WorstLink} dataset=${dataset} name=${name} worst=${score.worst} /></td>
  </tr>`)}</tbody>
</table></div>`;

/** What a channel got wrong most visibly, one after the other. @param {{dataset: string, name: string, worst: ChannelScore["worst"]}} props */
function WorstLink({ dataset, name, worst }) {
  if (worst.length === 0) return html`<span class="faint">none</span>`;
  const link = linkTo("queue", { dataset }, listQuery(worst.map(({ box_id }) => box_id)));
  return html`<a class="channels__worst" href=${link}>Look at ${countText(worst.length)}<span class="sr-only"> that ${channelText(name)} got wrong</span></a>`;
}
