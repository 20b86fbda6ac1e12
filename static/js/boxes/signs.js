// @ts-check
// Small drawings for verdicts and answers: badges, strokes, bars, progress, signs of answers.

import { html } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf, countText } from "../core/numbers.js";
import { answerOf } from "./box.js";

/** @import { Decision } from "./box.js" */
/** @import { FrameCounts } from "../core/openapi.js" */

/** The icon of each answer; "clear" takes an answer back. @type {Record<string, string>} */
export const ANSWER_ICONS = { keep: "check", reject: "cross", unsure: "question", clear: "minus" };

/** @param {{box: Decision, isWaiting: boolean}} props */
export function AnswerSign({ box, isWaiting }) {
  const answer = answerOf(box);
  if (!answer) return null;
  return html`<span class="sign sign--${answer} ${isWaiting ? "is-waiting" : ""}" role="img"
    aria-label=${`answered ${answer}${isWaiting ? ", not saved yet" : ""}`}>
    <${Icon} name=${ANSWER_ICONS[answer]} />
  </span>`;
}

/** @param {{verdict: string}} props */
export function VerdictBadge({ verdict }) {
  const icon = { kept: "check", rejected: "cross", withheld: "blind" }[verdict] ?? "question";
  return html`<span
    class="badge badge--${verdict}"><${Icon} name=${icon} />${verdict === "withheld" ? "hidden" : verdict}</span>`;
}

/** The swatch draws the stroke that the stage draws: solid, dashed, dotted. @param {{verdict: string}} props */
export const StrokeSwatch = ({ verdict }) => html`<span class="stroke stroke--${verdict}" aria-hidden="true"></span>`;

/**
 * Kept, rejected and unmeasured as one bar, with the numbers for screen readers.
 * @param {{counts: FrameCounts}} props
 */
export function VerdictBar({ counts }) {
  const { boxes, kept, rejected, unmeasured } = counts;
  const text = `${countText(kept)} kept, ${countText(rejected)} rejected, ${countText(unmeasured)} unmeasured`;
  /** @param {number} n */
  const share = (n) => ({ flexGrow: String(n) });
  return html`<div class="vbar" role="img" aria-label=${boxes ? text : "no boxes"}>
    ${kept > 0 && html`<span class="vbar__kept" style=${share(kept)} />`}
    ${rejected > 0 && html`<span class="vbar__rejected" style=${share(rejected)} />`}
    ${unmeasured > 0 && html`<span class="vbar__unmeasured" style=${share(unmeasured)} />`}
  </div>`;
}

/** How many boxes people have answered. @param {{counts: FrameCounts}} props */
export function ReviewProgress({ counts }) {
  const all = counts.reviewed + counts.to_review;
  const percent = all ? Math.floor((100 * counts.reviewed) / all) : counts.boxes ? 100 : 0;
  const left = counts.to_review ? countOf(counts.to_review, "needs review", "need review") : "nothing to review";
  return html`<div class="progress">
    <div class="progress__text">
      <span>${countOf(counts.reviewed, "answer")}</span>
      <span
        title="Boxes without keep or reject that the queue asks about: the filter may be wrong, and an eye can decide">
        ${left}</span>
    </div>
    <div class="progress__track" role="progressbar" aria-label="reviewed" aria-valuemin="0" aria-valuemax="100"
      aria-valuenow=${percent}>
      <span class="progress__fill" style=${{ width: `${percent}%` }} />
    </div>
  </div>`;
}
