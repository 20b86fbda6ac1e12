// @ts-check
// What to do with the selected boxes: one act for all of them.

import { html } from "../html.js";
import { boundKeys } from "../keymap.js";
import { countText } from "../wording.js";
import { useValue } from "./hooks.js";
import { Icon } from "./icons.js";
import { Keys } from "./parts.js";

const ANSWERS = /** @type {const} */ ([
  { action: "keep", icon: "check", text: "Keep", key: 0 },
  { action: "reject", icon: "cross", text: "Reject", key: 0 },
  { action: "unsure", icon: "question", text: "Unsure", key: 1 },
  { action: "clear", icon: "undo", text: "Clear", key: 0 },
]);

/** @param {{app: import("../app.js").App, selected: number, isAll: boolean, actions: Record<string, () => void>, onNone: () => void}} props */
export function GridBar({ app, selected, isAll, actions, onNone }) {
  const rows = boundKeys(useValue(app.keys));
  if (selected === 0) return null;
  /** @param {string} action @param {number} at  of its keys; in the grid Space selects */
  const keysOf = (action, at) => rows.find((row) => row.action === action)?.keys.slice(at, at + 1) ?? [];
  return html`<div class="bar bar--answer bar--grid" role="toolbar" aria-label="Answer for the selected boxes">
    <span class="bar__count"><b class="num">${countText(selected)}</b> ${isAll ? "of this filter" : "selected"}</span>
    ${ANSWERS.map(
      ({ action, icon, text, key }) => html`<button class="answer answer--${action}" onClick=${actions[action]}>
        <${Icon} name=${icon} /><span>${text}</span><${Keys} app=${app} keys=${keysOf(action, key)} />
      </button>`,
    )}
    <span class="bar__rule" aria-hidden="true"></span>
    <button class="answer" aria-label="Select none" title="Select none (Esc)" onClick=${onNone}><${Icon} name="cross" /></button>
  </div>`;
}
