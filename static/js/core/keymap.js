// @ts-check
// The keyboard shortcuts: one table, read by the key listener, the hints on buttons, and the help dialog where keys can
// be changed.

import { useValue } from "./hooks.js";
import { html, useState } from "./html.js";
import { Icon } from "./icons.js";
import { Dialog, useDialog } from "./parts.js";
import { keep } from "./prefs.js";

/** @import { App } from "./app.js" */

/**
 * @typedef {"Answer" | "Look" | "Move" | "In the grid" | "Page"} Group
 * @typedef {{action: string, keys: readonly string[], help: string, group: Group, where?: string}} Binding `where`: the
 *   only view in which the row is active; there, its keys take precedence over those of other rows
 * @typedef {{off: boolean, keys: Record<string, readonly string[]>}} KeySettings
 * @typedef {{key: string, shiftKey: boolean, ctrlKey: boolean, metaKey: boolean, altKey: boolean}} KeyPress
 */

const IN_THE_GRID = /** @type {const} */ ({ group: "In the grid", where: "grid" });

/** @type {readonly Binding[]} */
export const KEYMAP = [
  { action: "keep", keys: ["A", "K"], help: "Keep the box", group: "Answer" },
  { action: "reject", keys: ["X", "R"], help: "Reject the box", group: "Answer" },
  { action: "unsure", keys: ["Space", "U"], help: "Unsure: flag it and leave the filter's verdict", group: "Answer" },
  { action: "undo", keys: ["Z", "Backspace", "Ctrl+Z"], help: "Undo your last answer or change", group: "Answer" },
  { action: "keepTrack", keys: ["Shift+A"], help: "The object in all frames on show: keep it", group: "Answer" },
  { action: "rejectTrack", keys: ["Shift+X"], help: "The object in all frames on show: reject it", group: "Answer" },
  { action: "alike", keys: ["S"], help: "All like this: the last answer for the boxes like it", group: "Answer" },
  { action: "comment", keys: ["E"], help: "Write a comment", group: "Answer" },
  { action: "next", keys: ["J", "ArrowRight"], help: "Next box", group: "Move" },
  { action: "previous", keys: ["ArrowLeft"], help: "Previous box", group: "Move" },
  { action: "nextUnanswered", keys: ["Shift+J"], help: "Next box without an answer", group: "Move" },
  { action: "earlier", keys: [","], help: "The same object one frame earlier", group: "Move" },
  { action: "later", keys: ["."], help: "The same object one frame later", group: "Move" },
  { action: "nextFrame", keys: ["PageDown"], help: "Next frame", group: "Move" },
  { action: "previousFrame", keys: ["PageUp"], help: "Previous frame", group: "Move" },
  { action: "grid", keys: ["G"], help: "Boxes as a grid; from the grid, frames", group: "Move" },
  { action: "select", keys: ["Space", "Enter"], help: "Select or deselect the box", ...IN_THE_GRID },
  { action: "open", keys: ["C"], help: "Open the box in its frame", ...IN_THE_GRID },
  { action: "selectAll", keys: ["Ctrl+A"], help: "Select all boxes that match the filters", ...IN_THE_GRID },
  { action: "clear", keys: ["Delete"], help: "Remove the answers", ...IN_THE_GRID },
  { action: "left", keys: ["ArrowLeft"], help: "Left; Shift with an arrow extends the selection", ...IN_THE_GRID },
  { action: "right", keys: ["ArrowRight"], help: "Right", ...IN_THE_GRID },
  { action: "up", keys: ["ArrowUp"], help: "Up", ...IN_THE_GRID },
  { action: "down", keys: ["ArrowDown"], help: "Down", ...IN_THE_GRID },
  { action: "pageUp", keys: ["PageUp"], help: "One screen up", ...IN_THE_GRID },
  { action: "pageDown", keys: ["PageDown"], help: "One screen down", ...IN_THE_GRID },
  { action: "first", keys: ["Home"], help: "First box", ...IN_THE_GRID },
  { action: "last", keys: ["End"], help: "Last box", ...IN_THE_GRID },
  { action: "mask", keys: ["M"], help: "Segmentation over the image", group: "Look" },
  { action: "opacityDown", keys: ["["], help: "Segmentation fainter", group: "Look" },
  { action: "opacityUp", keys: ["]"], help: "Segmentation stronger", group: "Look" },
  // "lit" is also the name of the preference: both are stored in browsers.
  { action: "lit", keys: ["L"], help: "Highlight the matching pixels", group: "Look" },
  { action: "bare", keys: ["H"], help: "Hold: the picture alone", group: "Look" },
  { action: "cycleVerdict", keys: ["V"], help: "Show kept, rejected or all boxes", group: "Look" },
  { action: "crop", keys: ["C"], help: "Zoom to the box, and back", group: "Look" },
  { action: "fit", keys: ["F"], help: "Fit the frame", group: "Look" },
  { action: "zoomIn", keys: ["+", "="], help: "Zoom in", group: "Look" },
  { action: "zoomOut", keys: ["-"], help: "Zoom out", group: "Look" },
  { action: "far", keys: ["O"], help: "Far boxes as strong as others", group: "Look" },
  { action: "panels", keys: ["P"], help: "Hide or show the panels", group: "Look" },
  { action: "fullScreen", keys: ["Shift+F"], help: "Full screen", group: "Look" },
  { action: "edges", keys: ["D"], help: "3D edges", group: "Look" },
  { action: "blind", keys: ["B"], help: "Blind re-check: hide what the filter says until you answer", group: "Look" },
  { action: "help", keys: ["?"], help: "This help", group: "Page" },
  { action: "escape", keys: ["Escape"], help: "Close, or deselect the box", group: "Page" },
];

/** @type {KeySettings} */
export const DEFAULT_SETTINGS = { off: false, keys: {} };

/** The name of a pressed key in the table, for example "Shift+J". @param {KeyPress} press */
export function nameOf(press) {
  const key = press.key === " " ? "Space" : press.key;
  if (press.ctrlKey || press.metaKey) return `Ctrl+${key.toUpperCase()}`;
  if (/^\p{L}$/u.test(key)) return `${press.shiftKey ? "Shift+" : ""}${key.toUpperCase()}`;
  return key;
}

/**
 * The table with the keys that the person has changed. A default key that the person has given to another action stays
 * with that action: the default may be of a later version than the choice. A default of one view, such as Space in the
 * grid, takes precedence over what the person has chosen for all views, but a letter does not.
 * @param {KeySettings} settings @returns {Binding[]}
 */
function boundKeys(settings) {
  /** @param {string | undefined} where */
  const chosen = (where) => KEYMAP.flatMap((row) => (row.where === where ? (settings.keys[row.action] ?? []) : []));
  return KEYMAP.map((row) => {
    const taken = new Set([...chosen(row.where), ...chosen(undefined).filter((name) => /^\p{L}$/u.test(name))]);
    return { ...row, keys: settings.keys[row.action] ?? row.keys.filter((key) => !taken.has(key)) };
  });
}

/**
 * What the person is told about the actions that lose a key because it is given to another one.
 * @param {KeySettings} before @param {KeySettings} after @param {string} name  of the key
 */
export function lossText(before, after, name) {
  const now = new Map(boundKeys(after).map((row) => [row.action, row.keys]));
  const losers = boundKeys(before).filter(
    ({ action, keys }) => keys.includes(name) && !now.get(action)?.includes(name),
  );
  return losers
    .map(
      ({ action, help }) =>
        `${shownKey(name)} is no longer a key for: ${help}${now.get(action)?.length ? "" : ", which has no key now"}`,
    )
    .join(". ");
}

/**
 * The rows that are active in a view. A key that a row of this view uses is removed from the general rows.
 * @param {KeySettings} settings @param {string} view @returns {Binding[]}
 */
export function keysIn(settings, view) {
  const rows = boundKeys(settings).filter(({ where }) => where === undefined || where === view);
  const taken = new Set(rows.flatMap(({ where, keys }) => (where ? keys : [])));
  return rows.map((row) => (row.where ? row : { ...row, keys: row.keys.filter((key) => !taken.has(key)) }));
}

/**
 * The key of an action in a view, as it is shown; empty if no key works there.
 * @param {string} action @param {KeySettings} settings @param {string} [view]
 */
export function keyText(action, settings, view = "") {
  const row = keysIn(settings, view).find((each) => each.action === action);
  const key = row?.keys.find((name) => !isOff(name, row, settings));
  return key === undefined ? "" : shownKey(key);
}

/** What a button does, with the key for it. @param {string} text @param {string} key  empty: there is none */
export const withKey = (text, key) => (key ? `${text} (${key})` : text);

/** `keyText` in the current view. @param {App} app @param {string} action */
export const useKeyText = (app, action) => keyText(action, useValue(app.keys), useValue(app.router.route).name);

/** The rows that are active in the current view. @param {App} app */
export const useKeys = (app) => keysIn(useValue(app.keys), useValue(app.router.route).name);

/**
 * The action of a key press in a view, or null. Key presses with Alt are left to the browser, and those with Ctrl or
 * Cmd too, unless they are in the table.
 * @param {KeyPress} press @param {KeySettings} settings @param {string} [view]
 */
export function actionOf(press, settings, view = "") {
  if (press.altKey) return null;
  const name = nameOf(press);
  const row = keysIn(settings, view).find(({ keys }) => keys.includes(name));
  return row && !isOff(name, row, settings) ? row.action : null;
}

/**
 * Whether a key is switched off. Space as a key of one view selects in its list, as in any list box: it stays.
 * @param {string} name @param {Pick<Binding, "where">} row @param {KeySettings} settings
 */
const isOff = (name, { where }, settings) => settings.off && isCharacter(name) && !(where && name === "Space");

/** Character keys can be switched off (WCAG 2.1.4); arrows and Escape stay. @param {string} name */
const isCharacter = (name) => name === "Space" || [...name.replace(/^Shift\+/, "")].length === 1;

/**
 * Give an action one key. Another action with that key loses it.
 * @param {KeySettings} settings @param {string} action @param {string} name @returns {KeySettings}
 */
export function rebind(settings, action, name) {
  /** @type {Record<string, readonly string[]>} */
  const keys = { ...settings.keys };
  const { where } = KEYMAP.find((row) => row.action === action) ?? {};
  for (const row of boundKeys(settings)) {
    if (row.where === where && row.keys.includes(name)) keys[row.action] = row.keys.filter((key) => key !== name);
  }
  keys[action] = [name];
  return { ...settings, keys };
}

/** @type {Record<string, string>} */
const SHOWN = {
  ArrowRight: "→",
  ArrowLeft: "←",
  ArrowUp: "↑",
  ArrowDown: "↓",
  Escape: "Esc",
  PageDown: "PgDn",
  PageUp: "PgUp",
  Backspace: "⌫",
  Delete: "Del",
};

/** @param {string} name */
const shownKey = (name) => SHOWN[name] ?? name.replace("Shift+", "⇧");

/** @param {Pick<Storage, "getItem">} storage @returns {KeySettings} */
export function loadKeys(storage) {
  try {
    const { off, keys } = JSON.parse(storage.getItem(STORAGE_KEY) ?? "");
    return { off: off === true, keys: keys ?? {} };
  } catch {
    return DEFAULT_SETTINGS;
  }
}

/** @param {Pick<Storage, "setItem">} storage @param {KeySettings} settings */
export const saveKeys = (storage, settings) => keep(storage, STORAGE_KEY, settings);

const STORAGE_KEY = "unghost.keys.v1";

/** Actions that repeat while their key is held down. Answers do not: nobody would see the boxes. */
const HELD = new Set([
  ...["earlier", "later", "next", "previous", "nextUnanswered", "nextFrame", "previousFrame"],
  ...["left", "right", "up", "down", "pageUp", "pageDown"],
  ...["zoomIn", "zoomOut", "opacityUp", "opacityDown"],
]);

/** Whether the browser would click a focused button again, because Enter is held down. @param {KeyboardEvent} event */
const clicksAgain = ({ repeat, key, target }) =>
  repeat && key === "Enter" && target instanceof Element && target.closest("button") !== null;

/** @param {App} app */
export function watchKeys(app) {
  /** Whether the focused control was clicked: then Space and the arrows are for the stage, as before the click. */
  let isClicked = false;
  addEventListener("pointerdown", () => (isClicked = true), { capture: true });
  addEventListener("keydown", (event) => {
    if (event.key === "Tab") isClicked = false;
    if (event.defaultPrevented || event.isComposing) return;
    if (clicksAgain(event)) return event.preventDefault();
    if (isTyping(event, isClicked)) return;
    const action = actionOf(event, app.keys.get(), app.router.route.get().name);
    if (!action) return;
    const isHeld = event.repeat && !HELD.has(action);
    if (isHeld || perform(app, action, event)) event.preventDefault();
  });
}

/**
 * @param {App} app @param {string} action @param {KeyPress} [press] the key press that asked for it
 * @returns {boolean} whether a view on the page offers this action
 */
export function perform(app, action, press) {
  const run = app.actions.get().findLast((offered) => offered[action])?.[action];
  run?.(press);
  return run !== undefined;
}

/** What a select does by itself; letters, which would jump in it, are shortcuts. */
const OF_SELECT = /^(Arrow|Page|Home|End|Enter| )/;

/**
 * Whether a key press belongs to the focused field or dialog, so that it is no shortcut.
 * @param {KeyboardEvent} event @param {boolean} isClicked  the focused control was clicked, not reached by keys
 */
function isTyping({ target, key }, isClicked) {
  if (!(target instanceof HTMLElement)) return false;
  if (target.closest("dialog[open]")) return true;
  if (target.matches("textarea, input:not([type=checkbox]):not([type=range])")) return key !== "Escape";
  if (target.matches("input[type=range]")) return key.startsWith("Arrow") || key.startsWith("Page");
  if (target.matches("select")) return OF_SELECT.test(key) && !isClicked;
  if (key === "Enter") return target.closest("button, a, summary") !== null;
  if (target.matches("[role=option], [role=menuitemradio]")) return key === " ";
  return key === " " && !isClicked && target.matches("button, a, summary, input");
}

/** In two columns of about the same length. */
const GROUPS = /** @type {const} */ (["Answer", "Look", "Page", "Move", "In the grid"]);

/** @param {{app: App, onClose: () => void}} props */
export function HelpDialog({ app, onClose }) {
  const dialog = useDialog();
  const settings = useValue(app.keys);
  const [changing, setChanging] = useState("");
  const [taken, setTaken] = useState("");
  const here = app.router.route.get().name;

  /** @param {KeyboardEvent} event */
  const onKeyDown = (event) => {
    if (!changing) return actionOf(event, settings, here) === "help" ? dialog.close() : undefined;
    if (
      ["Shift", "Control", "Alt", "Meta", "Tab"].includes(event.key) ||
      event.ctrlKey ||
      event.metaKey ||
      event.altKey
    )
      return undefined;
    event.preventDefault();
    if (event.key !== "Escape") {
      const changed = rebind(settings, changing, nameOf(event));
      setTaken(lossText(settings, changed, nameOf(event)));
      app.keys.set(changed);
    }
    return setChanging("");
  };

  /** @param {Binding} row */
  const isHere = ({ action, where }) =>
    where ? where === here : action === "help" || app.actions.get().some((offered) => offered[action]);
  const held = new Map(keysIn(settings, here).map((row) => [row.action, row]));
  const rows = boundKeys(settings).map((row) =>
    isHere(row) ? { row: held.get(row.action) ?? row, isOff: false } : { row, isOff: true },
  );
  return html`<${Dialog} dialog=${dialog} id="help-title" title="Keys" isLight=${true} onClose=${onClose}
    onKeyDown=${onKeyDown}>
    <div class="help">
      ${GROUPS.map(
        (group) => html`<section class="help__group">
          <h3>${group}</h3>
          <dl>
            ${rows
              .filter(({ row }) => row.group === group)
              .map(
                ({ row, isOff }) => html`<${Row} key=${row.action}
                  app=${app} row=${row} isOff=${isOff} changing=${changing} onChange=${setChanging} />`,
              )}
          </dl>
        </section>`,
      )}
    </div>
    <p class="help__taken" role="status">${taken}</p>
    <footer class="dialog__foot">
      <label class="switch">
        <input type="checkbox" checked=${!settings.off}
          onChange=${() => app.keys.set({ ...settings, off: !settings.off })} />
        <span>Single-key shortcuts</span>
      </label>
      <button class="button" onClick=${() => (setTaken(""), app.keys.set(DEFAULT_SETTINGS))}>Restore defaults</button>
    </footer>
  <//>`;
}

/**
 * @param {{app: App, row: Binding, isOff: boolean, changing: string, onChange: (action: string) => void}} props
 *   `isOff`: not active in the current view
 */
function Row({ app, row, isOff, changing, onChange }) {
  const isChanging = changing === row.action;
  return html`<div class="help__row ${isOff ? "is-off" : ""}">
    <dt>${row.help}${isOff && html`<span class="sr-only"> (not in this view)</span>`}</dt>
    <dd>
      <span class="sr-only">${row.keys.join(" or ") || "no key"}</span>
      <${Keys} app=${app} keys=${row.keys} where=${row.where} />
      <button class="button button--quiet button--small ${isChanging ? "is-changing" : ""}"
        aria-label=${`Change the key: ${row.help}`} onClick=${() => onChange(isChanging ? "" : row.action)}>
        ${isChanging ? "Press a key…" : "Change"}
      </button>
    </dd>
  </div>`;
}

/**
 * The keys of an action, drawn as key caps; those that are switched off are struck through.
 * @param {{app: App, keys: readonly string[], where?: string}} props  `where`: as in `Binding`
 */
export function Keys({ app, keys, where }) {
  const settings = useValue(app.keys);
  return html`<span class="keys" aria-hidden="true">
    ${keys.map((key) => html`<kbd class=${isOff(key, { where }, settings) ? "is-off" : ""}>${shownKey(key)}</kbd>`)}
  </span>`;
}

/** Keep the focus where it is when a button is clicked, so that keys still reach the stage. @param {Event} event */
export const keepFocus = (event) => event.preventDefault();

/**
 * @param {{app: App, action: string, icon: string, isOn?: boolean, isHeld?: boolean, run: (() => void) | undefined}}
 *   props `isHeld`: it acts as long as it is pressed
 */
export function Toggle({ app, action, icon, isOn, isHeld = false, run }) {
  const key = useKeyText(app, action);
  const help = KEYMAP.find((row) => row.action === action)?.help ?? action;
  return html`<button class="button button--quiet button--icon" aria-pressed=${isOn} aria-label=${help}
    title=${withKey(help, key)} onMouseDown=${keepFocus} onPointerDown=${isHeld ? run : undefined}
    onClick=${isHeld ? undefined : run}>
    <${Icon} name=${icon} />
  </button>`;
}
