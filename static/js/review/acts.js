// @ts-check
// What a person can do with the chosen boxes by the keymap, the bar that shows it, and the notice of a conflict.

import { answerOf } from "../boxes/box.js";
import { useValue } from "../core/hooks.js";
import { html } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { Keys, boundKeys, keepFocus } from "../core/keymap.js";
import { countText } from "../core/numbers.js";

/** @typedef {import("../core/app.js").Actions} Actions */
/** @typedef {import("../core/app.js").App} App */
/** @typedef {import("../core/types.js").Decision} Decision */

/** @type {readonly {action: string, answer: string, icon: string, text: string}[]} */
const ANSWERS = [
  { action: "keep", answer: "keep", icon: "check", text: "Keep" },
  { action: "reject", answer: "reject", icon: "cross", text: "Reject" },
  { action: "unsure", answer: "unsure", icon: "question", text: "Unsure" },
];

/** @param {{app: App, box: Decision | null, isWaiting: boolean, actions: Actions}} props */
export function AnswerBar({ app, box, isWaiting, actions }) {
  const rows = boundKeys(useValue(app.keys));
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
    <button class="answer answer--undo" onClick=${actions.undo} aria-label="Undo" title="Take back your last answer"><${Icon} name="undo" /><${Keys} app=${app} keys=${keysOf("undo")} /></button>
  </div>`;
}

const ANSWERS_TO_MANY = /** @type {const} */ ([
  { action: "keep", icon: "check", text: "Keep", key: 0 },
  { action: "reject", icon: "cross", text: "Reject", key: 0 },
  { action: "unsure", icon: "question", text: "Unsure", key: 1 },
  { action: "clear", icon: "undo", text: "Clear", key: 0 },
]);

/** @param {{app: import("../core/app.js").App, selected: number, isAll: boolean, actions: Record<string, () => void>, onNone: () => void}} props */
export function GridBar({ app, selected, isAll, actions, onNone }) {
  const rows = boundKeys(useValue(app.keys));
  if (selected === 0) return null;
  /** @param {string} action @param {number} at  of its keys; in the grid Space selects */
  const keysOf = (action, at) => rows.find((row) => row.action === action)?.keys.slice(at, at + 1) ?? [];
  return html`<div class="bar bar--answer bar--grid" role="toolbar" aria-label="Answer for the selected boxes">
    <span class="bar__count"><b class="num">${countText(selected)}</b> ${isAll ? "of this filter" : "selected"}</span>
    ${ANSWERS_TO_MANY.map(
      ({ action, icon, text, key }) => html`<button class="answer answer--${action}" onClick=${actions[action]}>
        <${Icon} name=${icon} /><span>${text}</span><${Keys} app=${app} keys=${keysOf(action, key)} />
      </button>`,
    )}
    <span class="bar__rule" aria-hidden="true"></span>
    <button class="answer" aria-label="Select none" title="Select none (Esc)" onClick=${onNone}><${Icon} name="cross" /></button>
  </div>`;
}
