// @ts-check
// The bar with buttons for answers on a box, and the notice that somebody else has answered first.

import { answerOf } from "../boxes/box.js";
import { html } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { Keys, keepFocus, useKeys } from "../core/keymap.js";

/** @import { Decision } from "../boxes/box.js" */
/** @import { Actions, App } from "../core/app.js" */
/** @import { ReviewApp } from "./answers.js" */
/** @import { SingleAnswer } from "./outbox.js" */
/** @typedef {{action: string, icon: string, text: string}} AnswerRow */

/** The answers, by the names of their actions. @type {readonly AnswerRow[]} */
export const ANSWERS = [
  { action: "keep", icon: "check", text: "Keep" },
  { action: "reject", icon: "cross", text: "Reject" },
  { action: "unsure", icon: "question", text: "Unsure" },
];

/** The first key of an action. @param {{app: App, action: string}} props */
function FirstKey({ app, action }) {
  const keys =
    useKeys(app)
      .find((row) => row.action === action)
      ?.keys.slice(0, 1) ?? [];
  return html`<${Keys} app=${app} keys=${keys} />`;
}

/**
 * The button of an answer, with its key.
 * @param {{app: App, row: AnswerRow, actions: Actions, isGiven?: boolean, isDisabled?: boolean,
 *   children?: unknown}} props  `isGiven`: whether the box has this answer; undefined for many boxes
 */
export const AnswerButton = ({ app, row: { action, icon, text }, actions, isGiven, isDisabled = false, children }) =>
  html`<button class="answer answer--${action}" aria-pressed=${isGiven} disabled=${isDisabled}
    onClick=${actions[action]}>
    <${Icon} name=${icon} /><span>${text}</span><${FirstKey} app=${app} action=${action} />${children}
  </button>`;

/** @param {{app: App, box: Decision | null, isWaiting: boolean, actions: Actions}} props */
export function AnswerBar({ app, box, isWaiting, actions }) {
  const given = box ? answerOf(box) : null;
  return html`<div class="bar bar--answer" role="toolbar" aria-label="Answer" onMouseDown=${keepFocus}>
    ${ANSWERS.map(
      (row) => html`<${AnswerButton} app=${app} row=${row} actions=${actions} isGiven=${given === row.action}
        isDisabled=${!box}>
        ${
          given === row.action &&
          html`<span class="answer__state ${isWaiting ? "is-waiting" : ""}"
            title=${isWaiting ? "not saved yet" : "saved"}></span>`
        }
      <//>`,
    )}
    <span class="bar__rule" aria-hidden="true"></span>
    <button class="answer answer--undo" onClick=${actions.undo} aria-label="Undo"
      title="Undo your last answer"><${Icon} name="undo" /><${FirstKey} app=${app} action="undo" /></button>
  </div>`;
}

/**
 * Somebody else has answered first: their answer is kept, and this person can replace it.
 * @param {{app: ReviewApp, box: Decision, item: SingleAnswer,
 *   isNamed?: boolean, children?: unknown}} props  `isNamed`: the box is not the one on show
 */
export function OvertakenNotice({ app, box, item, isNamed = false, children }) {
  const { reviewer = "", verdict = "clear" } = box.review ?? {};
  const theirs = verdict === "clear" ? "removed the answer" : `answered ${verdict}`;
  return html`<section class="overtaken" role="alert">
    <p>${isNamed && html`<${Icon} name="warn" /> ${box.class} ${box.id}: `}
      <b>${reviewer || "Somebody else"} ${theirs}</b> while you answered ${item.verdict}. Your answer was not saved.</p>
    <div class="overtaken__actions">
      <button class="button button--small" onClick=${() => app.closeOvertaken(box.box_id)}>Keep theirs</button>
      <button class="button button--small button--primary"
        onClick=${() => app.insist(item)}>Use mine: ${item.verdict}</button>
      ${children}
    </div>
  </section>`;
}
