// @ts-check
// One table of keys: the listener, hints on buttons, the help in which they are re-bound.

import { useValue } from "./hooks.js";
import { html, useEffect, useRef, useState } from "./html.js";
import { Icon } from "./icons.js";

/** @typedef {import("./app.js").App} App */

/**
 * @typedef {"Answer" | "Move" | "Look" | "Page"} Group
 * @typedef {{action: string, keys: readonly string[], help: string, group: Group}} Binding
 * @typedef {{off: boolean, keys: Record<string, readonly string[]>}} KeySettings
 * @typedef {{key: string, shiftKey: boolean, ctrlKey: boolean, metaKey: boolean, altKey: boolean}} KeyPress
 */

/** @type {readonly Binding[]} */
export const KEYMAP = [
  { action: "keep", keys: ["A", "K"], help: "Keep the box", group: "Answer" },
  { action: "reject", keys: ["X", "R"], help: "Reject the box", group: "Answer" },
  { action: "unsure", keys: ["Space", "U"], help: "Unsure: flag it and leave the filter's verdict", group: "Answer" },
  { action: "clear", keys: ["Delete"], help: "In the grid: take the answers back", group: "Answer" },
  { action: "undo", keys: ["Z", "Backspace"], help: "Take back your last answer", group: "Answer" },
  { action: "comment", keys: ["E"], help: "Write a comment", group: "Answer" },
  { action: "next", keys: ["J", "ArrowRight"], help: "Next box", group: "Move" },
  { action: "previous", keys: ["ArrowLeft"], help: "Previous box", group: "Move" },
  { action: "nextUndecided", keys: ["Shift+J"], help: "Next box that nobody has answered", group: "Move" },
  { action: "nextFrame", keys: ["PageDown"], help: "Next frame", group: "Move" },
  { action: "previousFrame", keys: ["PageUp"], help: "Previous frame", group: "Move" },
  { action: "grid", keys: ["G"], help: "Boxes as a grid; from there, frames", group: "Move" },
  { action: "mask", keys: ["M"], help: "Segmentation over the image", group: "Look" },
  { action: "opacityDown", keys: ["["], help: "Segmentation fainter", group: "Look" },
  { action: "opacityUp", keys: ["]"], help: "Segmentation stronger", group: "Look" },
  { action: "lit", keys: ["L"], help: "Light up the matching pixels", group: "Look" },
  { action: "cycleVerdict", keys: ["V"], help: "Show kept, rejected or all boxes", group: "Look" },
  { action: "crop", keys: ["C"], help: "Zoom to the box, and back", group: "Look" },
  { action: "fit", keys: ["F"], help: "Fit the frame", group: "Look" },
  { action: "zoomIn", keys: ["+", "="], help: "Zoom in", group: "Look" },
  { action: "zoomOut", keys: ["-"], help: "Zoom out", group: "Look" },
  { action: "edges", keys: ["D"], help: "3D edges", group: "Look" },
  { action: "blind", keys: ["B"], help: "Blind re-check: hide what the filter says until you answer", group: "Look" },
  { action: "help", keys: ["?"], help: "This help", group: "Page" },
  { action: "escape", keys: ["Escape"], help: "Close, or let go of the box", group: "Page" },
];

/** @type {KeySettings} */
export const DEFAULT_SETTINGS = { off: false, keys: {} };

/** How a key press is written in the table. @param {KeyPress} press */
export function nameOf(press) {
  const key = press.key === " " ? "Space" : press.key;
  if (/^\p{L}$/u.test(key)) return `${press.shiftKey ? "Shift+" : ""}${key.toUpperCase()}`;
  return key;
}

/** The table with a person's own keys in it. @param {KeySettings} settings @returns {Binding[]} */
export function boundKeys(settings) {
  return KEYMAP.map((row) => ({ ...row, keys: settings.keys[row.action] ?? row.keys }));
}

/**
 * The action of a key press, or null. Browser shortcuts (Ctrl, Alt, Cmd) are never taken.
 * @param {KeyPress} press @param {KeySettings} settings
 */
export function actionOf(press, settings) {
  if (press.ctrlKey || press.metaKey || press.altKey) return null;
  const name = nameOf(press);
  if (settings.off && isCharacter(name)) return null;
  return boundKeys(settings).find(({ keys }) => keys.includes(name))?.action ?? null;
}

/** Character keys can be switched off (WCAG 2.1.4); arrows and Escape stay. @param {string} name */
const isCharacter = (name) => name === "Space" || [...name.replace(/^Shift\+/, "")].length === 1;

/**
 * Give an action one key; whoever had it loses it.
 * @param {KeySettings} settings @param {string} action @param {string} name @returns {KeySettings}
 */
export function rebind(settings, action, name) {
  /** @type {Record<string, readonly string[]>} */
  const keys = { ...settings.keys };
  for (const row of boundKeys(settings)) {
    if (row.keys.includes(name)) keys[row.action] = row.keys.filter((key) => key !== name);
  }
  keys[action] = [name];
  return { ...settings, keys };
}

/** @type {Record<string, string>} */
const SHOWN = { ArrowRight: "→", ArrowLeft: "←", ArrowUp: "↑", ArrowDown: "↓", Escape: "Esc", PageDown: "PgDn", PageUp: "PgUp", Backspace: "⌫", Delete: "Del" };

/** @param {string} name */
export const shownKey = (name) => SHOWN[name] ?? name.replace("Shift+", "⇧");

/** @param {Pick<Storage, "getItem">} storage @returns {KeySettings} */
export function loadKeys(storage) {
  try {
    const { off, keys } = JSON.parse(storage.getItem(STORAGE_KEY) ?? "");
    return { off: off === true, keys: typeof keys === "object" && keys ? keys : {} };
  } catch {
    return DEFAULT_SETTINGS;
  }
}

/** @param {Pick<Storage, "setItem">} storage @param {KeySettings} settings */
export const saveKeys = (storage, settings) => storage.setItem(STORAGE_KEY, JSON.stringify(settings));

const STORAGE_KEY = "unghost.keys.v1";

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

/** @param {{app: App, row: Binding, changing: string, onChange: (action: string) => void}} props */
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

/** The keys of an action, as they are bound now. @param {{app: import("./app.js").App, keys: readonly string[]}} props */
export function Keys({ app, keys }) {
  const { off } = useValue(app.keys);
  return html`<span class="keys" aria-hidden="true">
    ${keys.map((key) => html`<kbd class=${off && [...key].length === 1 ? "is-off" : ""}>${shownKey(key)}</kbd>`)}
  </span>`;
}

/** A click with the mouse must not take the keys away from the stage. @param {Event} event */
export const keepFocus = (event) => event.preventDefault();

/** @param {{app: App, action: string, icon: string, isOn?: boolean, run: (() => void) | undefined}} props */
export function Toggle({ app, action, icon, isOn, run }) {
  const row = boundKeys(useValue(app.keys)).find((binding) => binding.action === action);
  const title = `${row?.help ?? action}${row?.keys[0] ? ` (${row.keys[0]})` : ""}`;
  return html`<button class="button button--quiet button--icon" aria-pressed=${isOn} aria-label=${row?.help ?? action} title=${title} onMouseDown=${keepFocus} onClick=${run}>
    <${Icon} name=${icon} />
  </button>`;
}
