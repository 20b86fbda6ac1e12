// @ts-check
// The keys: one table that the listener, the buttons' hints and the help dialog all read.

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
