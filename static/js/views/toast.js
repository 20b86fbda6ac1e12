// @ts-check
// Messages in the corner.

import { html } from "../html.js";
import { useValue } from "./hooks.js";
import { Icon } from "./icons.js";

/** @param {{app: import("../app.js").App}} props */
export function Toasts({ app }) {
  const toasts = useValue(app.toasts.list);
  return html`<div class="toasts">
    ${toasts.map(
      ({ id, kind, text, action }) => html`<div key=${id} class="toast toast--${kind}" role=${kind === "error" ? "alert" : "status"}>
        <${Icon} name=${kind === "error" ? "warn" : "check"} />
        <span class="toast__text">${text}</span>
        ${action?.href && html`<a class="button button--small" href=${action.href} onClick=${() => app.toasts.dismiss(id)}>${action.text}</a>`}
        ${action?.run && html`<button class="button button--small" onClick=${() => (app.toasts.dismiss(id), action.run?.())}>${action.text}</button>`}
        <button class="button button--quiet button--icon" aria-label="Dismiss" onClick=${() => app.toasts.dismiss(id)}><${Icon} name="cross" /></button>
      </div>`,
    )}
  </div>`;
}
