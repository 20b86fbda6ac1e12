// @ts-check
// A login link was opened while somebody else is signed in: it may come from anywhere, so it
// replaces nobody before that is said.

import { html, useEffect, useRef } from "../html.js";
import { useValue } from "./hooks.js";

/** @param {{app: import("../app.js").App}} props */
export function Newcomer({ app }) {
  const newcomer = useValue(app.newcomer);
  const person = useValue(app.person);
  const dialog = useRef(/** @type {HTMLDialogElement | null} */ (null));
  useEffect(() => void (newcomer && dialog.current?.showModal()), [newcomer]);
  if (!newcomer) return null;
  const now = person?.name ?? "";
  return html`<dialog class="dialog dialog--question" ref=${dialog} aria-labelledby="newcomer-title" onCancel=${() => app.admit(false)}>
    <div class="dialog__body">
      <header class="dialog__head"><h2 id="newcomer-title">Sign in as ${newcomer.name} instead of ${now}?</h2></header>
      <p>You opened a login link of <b>${newcomer.name}</b> (${newcomer.role}). Answers that you give from then on are stored under that name.</p>
      <p>If you did not ask for this link, stay ${now}. Answers of ${now} that are not saved yet stay in this browser until ${now} is back.</p>
      <footer class="dialog__foot">
        <button class="button" onClick=${() => app.admit(true)}>Sign in as ${newcomer.name}</button>
        <button class="button button--primary" autofocus onClick=${() => app.admit(false)}>Stay ${now}</button>
      </footer>
    </div>
  </dialog>`;
}
