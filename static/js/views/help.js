// @ts-check
// The help: the keymap's own table, where keys can be given anew or switched off.

import { html, useEffect, useRef, useState } from "../html.js";
import { DEFAULT_SETTINGS, boundKeys, nameOf, rebind, shownKey } from "../keymap.js";
import { useValue } from "./hooks.js";
import { Icon } from "./icons.js";
import { Keys } from "./parts.js";

/** @typedef {import("../app.js").App} App */

const GROUPS = /** @type {const} */ (["Answer", "Move", "Look", "Page"]);

/** @param {{app: App, onClose: () => void}} props */
export function HelpDialog({ app, onClose }) {
  const dialog = useRef(/** @type {HTMLDialogElement | null} */ (null));
  const settings = useValue(app.keys);
  const [changing, setChanging] = useState("");
  const [taken, setTaken] = useState("");
  useEffect(() => dialog.current?.showModal(), []);

  /** @param {KeyboardEvent} event */
  const onKeyDown = (event) => {
    if (!changing) return event.key === "?" ? dialog.current?.close() : undefined;
    if (["Shift", "Control", "Alt", "Meta", "Tab"].includes(event.key)) return undefined;
    event.preventDefault();
    if (event.key !== "Escape") {
      const loser = boundKeys(settings).find(({ action, keys }) => action !== changing && keys.includes(nameOf(event)));
      setTaken(loser ? `${shownKey(nameOf(event))} no longer stands for: ${loser.help}` : "");
      app.keys.set(rebind(settings, changing, nameOf(event)));
    }
    return setChanging("");
  };

  const rows = boundKeys(settings);
  return html`<dialog class="dialog" ref=${dialog} aria-labelledby="help-title" onClose=${onClose} onKeyDown=${onKeyDown}
    onClick=${(/** @type {MouseEvent} */ event) => event.target === dialog.current && dialog.current?.close()}>
    <div class="dialog__body">
      <header class="dialog__head">
        <h2 id="help-title">Keys</h2>
        <button class="button button--quiet button--icon" aria-label="Close" onClick=${() => dialog.current?.close()}><${Icon} name="cross" /></button>
      </header>
      <div class="help">
        ${GROUPS.map(
          (group) => html`<section class="help__group">
            <h3>${group}</h3>
            <dl>
              ${rows.filter((row) => row.group === group).map((row) => html`<${Row} key=${row.action} app=${app} row=${row} changing=${changing} onChange=${setChanging} />`)}
            </dl>
          </section>`,
        )}
      </div>
      <p class="help__taken" role="status">${taken}</p>
      <footer class="dialog__foot">
        <label class="switch">
          <input type="checkbox" checked=${!settings.off} onChange=${() => app.keys.set({ ...settings, off: !settings.off })} />
          <span>Single-key shortcuts</span>
        </label>
        <button class="button" onClick=${() => (setTaken(""), app.keys.set(DEFAULT_SETTINGS))}>Back to the defaults</button>
      </footer>
    </div>
  </dialog>`;
}

/** @param {{app: App, row: import("../keymap.js").Binding, changing: string, onChange: (action: string) => void}} props */
function Row({ app, row, changing, onChange }) {
  const isChanging = changing === row.action;
  return html`<div class="help__row">
    <dt>${row.help}</dt>
    <dd>
      <span class="sr-only">${row.keys.join(" or ") || "no key"}</span>
      <${Keys} app=${app} keys=${row.keys} />
      <button class="button button--quiet button--small ${isChanging ? "is-changing" : ""}" aria-label=${`Change the key: ${row.help}`} onClick=${() => onChange(isChanging ? "" : row.action)}>
        ${isChanging ? "Press a key…" : "Change"}
      </button>
    </dd>
  </div>`;
}
