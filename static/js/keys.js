// @ts-check
// The one listener for keys: key press -> action of the keymap -> whoever offers that action.

import { actionOf } from "./keymap.js";

/** @param {import("./app.js").App} app */
export function watchKeys(app) {
  addEventListener("keydown", (event) => {
    if (event.defaultPrevented || event.isComposing || isTyping(event)) return;
    const action = actionOf(event, app.keys.get());
    if (action && perform(app, action)) event.preventDefault();
  });
}

/** @param {import("./app.js").App} app @param {string} action @returns {boolean} did anybody do it? */
export function perform(app, action) {
  const run = app.actions.get().findLast((offered) => offered[action])?.[action];
  run?.();
  return run !== undefined;
}

/** Keys belong to the field or the dialog that has the focus. @param {KeyboardEvent} event */
export function isTyping({ target, key }) {
  if (!(target instanceof HTMLElement)) return false;
  if (target.closest("dialog[open]")) return true;
  if (target.matches("textarea, select, input:not([type=checkbox]):not([type=range])")) return key !== "Escape";
  if (target.matches("input[type=range]")) return key.startsWith("Arrow") || key.startsWith("Page");
  return key === " " && target.matches("button, a, summary, input, [role=option], [role=menuitemradio]");
}
