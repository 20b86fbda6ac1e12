// @ts-check
// The bar with buttons for answers on a box, and the notice that somebody else has answered first.

import { answerOf } from "../boxes/box.js";
import { html } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { Keys, keepFocus, useKeys } from "../core/keymap.js";

/** @typedef {import("../core/app.js").Actions} Actions */
/** @typedef {import("../core/app.js").App} App */
/** @typedef {import("../boxes/box.js").Decision} Decision */

/** @type {readonly {action: string, answer: string, icon: string, text: string}[]} */
const ANSWERS = [
  { action: "keep", answer: "keep", icon: "check", text: "Keep" },
  { action: "reject", answer: "reject", icon: "cross", text: "Reject" },
  { action: "unsure", answer: "unsure", icon: "question", text: "Unsure" },
];

/** @param {{app: App, box: Decision | null, isWaiting: boolean, actions: Actions}} props */
export function AnswerBar({ app, box, isWaiting, actions }) {
  const rows = useKeys(app);
  /** @param {string} action */
  const keysOf = (action) => rows.find((row) => row.action === action)?.keys.slice(0, 1) ?? [];
  const given = box ? answerOf(box) : null;
  return html`<div class="bar bar--answer" role="toolbar" aria-label="Answer" onMouseDown=${keepFocus}>
    ${ANSWERS.map(
      ({ action, answer, icon, text }) => html`<button class="answer answer--${answer}" aria-pressed=${given === answer} disabled=${!box} onClick=${actions[action]}>
        <${Icon} name=${icon} /><span>${text}</span><${Keys} app=${app} keys=${keysOf(action)} />
        ${given === answer && html`<span class="answer__state ${isWaiting ? "is-waiting" : ""}" title=${isWaiting ? "not saved yet" : "saved"}></span>`}
      </button>`,
    )}
    <span class="bar__rule" aria-hidden="true"></span>
    <button class="answer answer--undo" onClick=${actions.undo} aria-label="Undo" title="Undo your last answer"><${Icon} name="undo" /><${Keys} app=${app} keys=${keysOf("undo")} /></button>
  </div>`;
}

/**
 * Somebody else has answered first: their answer is kept, and this person can replace it.
 * @param {{app: import("./answers.js").ReviewApp, box: Decision, item: import("./outbox.js").SingleAnswer,
 *   isNamed?: boolean, children?: unknown}} props  `isNamed`: the box is not the one on show
 */
export function OvertakenNotice({ app, box, item, isNamed = false, children }) {
  const { reviewer = "", verdict = "clear" } = box.review ?? {};
  const theirs = verdict === "clear" ? "removed the answer" : `answered ${verdict}`;
  return html`<section class="overtaken" role="alert">
    <p>${isNamed && html`<${Icon} name="warn" /> ${box.class} ${box.id}: `}<b>${reviewer || "Somebody else"} ${theirs}</b> while you answered ${item.verdict}. Your answer was not saved.</p>
    <div class="overtaken__actions">
      <button class="button button--small" onClick=${() => app.closeOvertaken(box.box_id)}>Keep theirs</button>
      <button class="button button--small button--primary" onClick=${() => app.insist(item)}>Use mine: ${item.verdict}</button>
      ${children}
    </div>
  </section>`;
}
