// @ts-check
// The report of `unghost worth-it`: what each way of cleaning labels leaves, and what a detector learns from it.

import { ApiError, get } from "../core/api.js";
import { useLoaded } from "../core/hooks.js";
import { html } from "../core/html.js";
import { countText } from "../core/numbers.js";
import { Command, FailureLine, WideTable, numeric } from "../core/parts.js";
import { MeasureCell } from "./comparison.js";
import { percentOf } from "./measures.js";

/** @import { Arm, Experiment as Report } from "../core/openapi.js" */

/** What an arm's labels are, by its name without a number of pixels. @type {Readonly<Record<string, string>>} */
const ARMS = {
  raw: "every box as the simulator projects it",
  clipped: "every box, with an exact rectangle",
  paper: "what the paper's filter keeps",
  carlasimu: "what the authors' published code keeps",
  ordered: "what the order of the objects keeps",
  depth: "what the depth image keeps",
  instance: "what the instance image keeps",
  auto: "what the filter keeps by default",
  perfect: "the objects of the truth: a ceiling",
  random: "as many boxes as auto keeps, at random",
};

/** @param {{dataset: string}} props */
export function Experiment({ dataset }) {
  const route = "/api/v1/datasets/{dataset}/experiment";
  const loaded = useLoaded((signal) => get(route, { path: { dataset }, signal }), [dataset]);
  const isMissing = loaded.error instanceof ApiError && loaded.error.status === 404;
  return html`<section class="panelbox quality__wide" aria-labelledby="experiment-title"
    aria-busy=${loaded.state === "loading"}>
    <header class="panelbox__head"><h2 id="experiment-title">Is it worth it?</h2>
      <span class="faint">what a detector is told, and what it learns from that</span></header>
    ${loaded.error && !isMissing && html`<${FailureLine} error=${loaded.error} onRetry=${loaded.reload} />`}
    ${
      isMissing &&
      html`<div class="panelbox__empty">
        <p>Count the ghosts among your labels, with every way of cleaning them. Without <code>--no-train</code> it also
          trains a detector on each.</p>
        <${Command} text=${`unghost worth-it SOURCE --no-train --dataset ${dataset}`} /></div>`
    }
    ${!loaded.error && loaded.value && html`<${Arms} report=${loaded.value} />`}
  </section>`;
}

/** @param {{report: Report}} props */
function Arms({ report }) {
  const arms = Object.entries(report.arms);
  const most = Math.max(0.01, ...arms.map(([, { map50 }]) => map50?.high ?? 0));
  const hasTrials = arms.some(([, { trials }]) => trials > 0);
  const heads = [
    "Labels",
    numeric("Boxes"),
    numeric("Ghosts", "Labels of which nothing is visible"),
    numeric("Lost objects", "Objects without a label"),
  ];
  const trialHeads = [
    { text: "mAP50", title: "Of the detectors that were trained on these labels" },
    { text: `Against ${report.baseline}`, title: "In percentage points, with the 95 % interval" },
  ];
  return html`<${WideTable} label="Ways of cleaning labels" kind="groups channels"
    caption="Labels of each way of cleaning, and detectors trained on them"
    heads=${hasTrials ? [...heads, ...trialHeads] : heads}>
      ${arms.map(
        ([name, arm]) => html`<tr key=${name}>
          <th scope="row">${name}<span class="faint channels__about">${ARMS[name.split("@")[0] ?? ""]}</span></th>
          ${[arm.labels?.labels, arm.labels?.ghosts, arm.labels?.lost].map(
            (count, at) => html`<td class="is-num num" key=${at}>${count === undefined ? "–" : countText(count)}</td>`,
          )}
          ${
            hasTrials &&
            html`<td><${MeasureCell} measure=${arm.map50} name="mAP50" most=${most} /></td>
            <td>${arm.difference && html`<${Against} difference=${arm.difference} />`}</td>`
          }
        </tr>`,
      )}<//>
  <p class="faint channels__note">${report.verdict} ${report.truth}
    ${" "}${countText(report.frames)} frames, ${countText(report.objects)} objects.
    ${report.trainer && html` Trained by <code>${report.trainer}</code>.`}</p>`;
}

/** @param {{difference: NonNullable<Arm["difference"]>}} props */
const Against = ({ difference: { value, low, high, shown } }) => html`<span class="num">${signed(value)}</span>
${" "}<span class="faint num">${signed(low)} to ${signed(high)}</span>
${!shown && html` <span class="faint">no difference shown</span>`}`;

/** In percentage points, with its sign. @param {number} share */
const signed = (share) => `${share < 0 ? "−" : "+"}${percentOf(Math.abs(share))}`;
