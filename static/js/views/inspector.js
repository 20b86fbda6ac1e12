// @ts-check
// Everything about the selected box: verdict, sentence, numbers, what hides it, its history.

import { html } from "../html.js";
import { boundKeys } from "../keymap.js";
import { isVeiled } from "../blind.js";
import { answerOf } from "../reviews.js";
import { swatchOf } from "../palette.js";
import { acceptedText, channelText, countOf, countText, isByShare, labelText, percentText, unbroken } from "../wording.js";
import { AnswerSign } from "./boxlist.js";
import { Comment } from "./comment.js";
import { History } from "./history.js";
import { useValue } from "./hooks.js";
import { Icon } from "./icons.js";
import { Neighbours } from "./neighbours.js";
import { Numbers } from "./numbers.js";
import { Keys, VerdictBadge } from "./parts.js";

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../types.js").Decision} Decision */
/** @typedef {import("../types.js").Frame} Frame */

/**
 * @param {{app: App, frame: Frame, box: Decision | null, boxes: readonly Decision[], isWaiting: boolean,
 *   actions: import("../frame_actions.js").FrameActions, commentRef: {current: HTMLTextAreaElement | null}}} props
 */
export function Inspector({ app, frame, box, boxes, isWaiting, actions, commentRef }) {
  return html`<aside class="panel panel--inspector" aria-label="Selected box">
    ${box
      ? html`<${BoxDetails} key=${box.box_id} app=${app} box=${box} boxes=${boxes} isWaiting=${isWaiting} actions=${actions} commentRef=${commentRef} />`
      : html`<${FrameDetails} app=${app} frame=${frame} boxes=${boxes} onStart=${actions.byName.nextUndecided} />`}
  </aside>`;
}

/** @param {{app: App, box: Decision, boxes: readonly Decision[], isWaiting: boolean, actions: import("../frame_actions.js").FrameActions, commentRef: {current: HTMLTextAreaElement | null}}} props */
function BoxDetails({ app, box, boxes, isWaiting, actions, commentRef }) {
  return html`
    <header class="inspector__head">
      <h2>${box.class} <span class="faint">${box.id}</span></h2>
      <${VerdictBadge} verdict=${box.verdict} />
    </header>
    <${Conflict} app=${app} box=${box} />
    <${AnswerLine} box=${box} isWaiting=${isWaiting} />
    <p class="inspector__sentence">${isVeiled(box) ? "Blind re-check: what the filter says is shown once you have answered." : unbroken(box.explanation || labelText(box))}</p>
    <${MatchBar} box=${box} />
    <${HiddenBy} box=${box} />
    <${Comment} box=${box} onSave=${(/** @type {string} */ text) => actions.answer(answerOf(box) ?? "unsure", text)} fieldRef=${commentRef} />
    <${Neighbours} boxes=${boxes} box=${box} onSelect=${actions.select} />
    <${Numbers} box=${box} />
    ${!isVeiled(box) && html`<${History} app=${app} box=${box} />`}`;
}

/** Two people answered: nothing was overwritten, and this one may insist. @param {{app: App, box: Decision}} props */
function Conflict({ app, box }) {
  const mine = useValue(app.conflicts).get(box.box_id);
  if (!mine) return null;
  const { reviewer = "", verdict = "clear" } = box.review ?? {};
  const theirs = verdict === "clear" ? "took the answer back" : `answered ${verdict}`;
  return html`<section class="conflict" role="alert">
    <p><b>${reviewer || "Somebody else"} ${theirs}</b> while you answered ${mine.verdict}. Yours is not stored.</p>
    <div class="conflict__actions">
      <button class="button" onClick=${() => app.settle(box.box_id)}>Leave it</button>
      <button class="button button--primary" onClick=${() => app.insist(box, mine)}>Use mine: ${mine.verdict}</button>
    </div>
  </section>`;
}

/** @param {{box: Decision, isWaiting: boolean}} props */
function AnswerLine({ box, isWaiting }) {
  const answer = answerOf(box);
  if (!answer) return html`<p class="answerline faint">Nobody has answered yet.</p>`;
  const state = isWaiting ? "not saved yet" : "saved";
  return html`<p class="answerline">
    <${AnswerSign} box=${box} isWaiting=${isWaiting} />
    <span><b>${answer}</b>${box.review?.reviewer ? ` by ${box.review.reviewer}` : ""}</span>
    <span class="answerline__state">${state}</span>
  </p>`;
}

/** What decided: how much matched, against what was needed, or another channel. @param {{box: Decision}} props */
function MatchBar({ box }) {
  const { match_percent: match, threshold } = box;
  if (!isByShare(box) && !isVeiled(box)) return html`<${OtherChannel} box=${box} />`;
  if (match === null || match === undefined) return null;
  const text = `${percentText(match)} of the box is ${acceptedText(box)}${threshold === null ? "" : `, ${percentText(threshold)} needed`}`;
  return html`<div class="match">
    <div class="match__text"><span>${acceptedText(box)}</span><span class="num">${percentText(match)}</span></div>
    <div class="match__track" role="img" aria-label=${text}>
      <span class="match__fill match__fill--${box.verdict}" style=${{ width: `${Math.min(100, match)}%` }} />
      ${threshold !== null && html`<span class="match__tick" style=${{ left: `${Math.min(100, threshold)}%` }} />`}
    </div>
    ${threshold !== null && html`<div class="match__scale"><span style=${{ left: `${Math.min(92, Math.max(0, threshold))}%` }}>${percentText(threshold)} needed</span></div>`}
    ${box.toss_up && html`<p class="match__note"><${Icon} name="warn" />A toss-up: too few pixels to tell from the threshold.</p>`}
  </div>`;
}

/** Another channel decided; what it says is the sentence above, and the share is beside the point. @param {{box: Decision}} props */
function OtherChannel({ box }) {
  const { match_percent: match, visible_pixels: seen } = box;
  return html`<div class="match match--other">
    <div class="match__text"><span>Decided by ${channelText(box.evidence ?? "")}</span>
      ${typeof seen === "number" && html`<span class="num">${countOf(seen, "pixel")} seen</span>`}</div>
    ${typeof match === "number" && html`<p class="match__note">${percentText(match)} of the box is ${acceptedText(box)}, which did not decide.</p>`}
  </div>`;
}

/** @param {{box: Decision}} props */
function HiddenBy({ box }) {
  if (!box.hidden_by?.length) return null;
  return html`<section class="hidden-by">
    <h3>${box.verdict === "rejected" && isByShare(box) ? "Hidden by" : "Also in the box"}</h3>
    <ul>
      ${box.hidden_by.map(
        ({ name, percent }) => html`<li>
          <span class="hidden-by__name"><span class="swatch" style=${{ background: swatchOf(name) }} />${name}</span>
          <span class="hidden-by__track" aria-hidden="true"><span style=${{ width: `${Math.min(100, percent)}%` }} /></span>
          <span class="num">${percentText(percent)}</span>
        </li>`,
      )}
    </ul>
  </section>`;
}

/** No box is selected: the frame itself, and where to start. @param {{app: App, frame: Frame, boxes: readonly Decision[], onStart: () => void}} props */
function FrameDetails({ app, frame, boxes, onStart }) {
  const undecided = boxes.filter((box) => answerOf(box) === null).length;
  const { segmentation } = frame;
  const keys = boundKeys(useValue(app.keys)).find(({ action }) => action === "nextUndecided")?.keys ?? [];
  const facts = [
    ["Size", frame.width && frame.height ? `${frame.width} × ${frame.height}` : "unknown"],
    ["Map", frame.map],
    ["CARLA", frame.carla_version],
    ["Segmentation", segmentation ? `${segmentation.palette}, ${segmentation.encoding}, ${segmentation.channel_order}${segmentation.lossy ? ", lossy" : ""}` : "none"],
    ["Revision", frame.revision > 1 ? String(frame.revision) : null],
  ];
  return html`
    <header class="inspector__head"><h2>This frame</h2></header>
    <p class="inspector__sentence">${undecided ? `${countText(undecided)} of ${countText(boxes.length)} boxes have no answer yet.` : "Every box here has an answer."}</p>
    ${undecided > 0 && html`<button class="button button--primary" onClick=${onStart}>Go to the next undecided<${Keys} app=${app} keys=${keys} /></button>`}
    <dl class="facts">${facts.map(([name, value]) => value && html`<div><dt>${name}</dt><dd>${value}</dd></div>`)}</dl>
    ${segmentation?.notes?.map((note) => html`<p class="faint">${note}</p>`)}`;
}
