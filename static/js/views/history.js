// @ts-check
// What was said about a box so far, newest first: by the filter and by people.

import { html } from "../html.js";
import { seenRevision } from "../reviews.js";
import { ANSWER_TEXT, agoText, percentText, reasonText, unbroken } from "../wording.js";
import { useLoaded } from "./hooks.js";
import { Icon } from "./icons.js";

/** @typedef {import("../types.js").HistoryItem} HistoryItem */

/** @param {{app: import("../app.js").App, box: import("../types.js").Decision}} props */
export function History({ app, box }) {
  const loaded = useLoaded(app, (signal) => app.api.history(box.box_id, signal), [box.box_id, seenRevision(box), box.run]);
  const items = loaded.value?.items ?? [];
  return html`<section class="history" aria-busy=${loaded.state === "loading"}>
    <h3>History</h3>
    ${loaded.state === "error" && html`<p class="faint">${loaded.error.message} <button class="button button--small" onClick=${loaded.reload}>Try again</button></p>`}
    ${loaded.state === "loading" && !loaded.value && html`<div class="bone" /><div class="bone bone--short" />`}
    <ol>${items.map((item) => html`<li class="history__item">${item.kind === "review" ? html`<${ReviewLine} item=${item} />` : html`<${DecisionLine} item=${item} />`}</li>`)}</ol>
  </section>`;
}

const SIGNS = /** @type {Record<string, string>} */ ({ keep: "check", reject: "cross", unsure: "question", clear: "undo" });

/** @param {{item: HistoryItem}} props */
function ReviewLine({ item }) {
  return html`<span class="sign sign--${item.verdict}"><${Icon} name=${SIGNS[item.verdict] ?? "question"} /></span>
    <div>
      <p><b>${item.reviewer}</b> ${ANSWER_TEXT[item.verdict] ?? item.verdict} <${When} at=${item.at} /></p>
      ${item.comment && html`<p class="history__comment">${item.comment}</p>`}
    </div>`;
}

/** @param {{item: HistoryItem}} props */
function DecisionLine({ item }) {
  const { verdict, reason = "", match_percent: match, threshold, run } = item;
  // Without a threshold the share decided nothing.
  const isByShare = typeof match === "number" && typeof threshold === "number";
  const numbers = isByShare ? ` · ${percentText(match)} of ${percentText(threshold)}` : "";
  return html`<span class="sign sign--filter"><${Icon} name="filter" /></span>
    <div><p>Run ${run}: <b>${verdict}</b>, ${reasonText(reason)}${unbroken(numbers)} <${When} at=${item.at} /></p></div>`;
}

/** @param {{at: string}} props */
const When = ({ at }) => html`<time class="faint" datetime=${at} title=${at}>${agoText(at)}</time>`;
