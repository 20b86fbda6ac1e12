// @ts-check
// A person's preferences, kept in the browser; the theme follows them.

import { createValue } from "./observable.js";

/**
 * @typedef {object} Prefs
 * @property {"system" | "light" | "dark"} theme
 * @property {boolean} mask  segmentation over the image
 * @property {number} opacity  of the segmentation, 0.1 to 1
 * @property {boolean} lit  matching pixels of the selected box
 * @property {boolean} edges  3D edges
 * @property {boolean} crop  the selected box's surroundings rather than the frame
 * @property {boolean} far  far boxes are drawn as strong as others
 * @property {boolean} panels  shown beside the picture
 * @property {boolean} blind  hide verdicts and earlier answers until one has answered
 * @property {boolean} lessons  a queue begins with its lesson, where it has one
 * @property {number} cropSize  of the crops in the grid, about so many px wide
 */

const STORAGE_KEY = "unghost.prefs.v1";

/** @type {Prefs} */
const DEFAULTS = {
  theme: "system",
  mask: false,
  opacity: 0.5,
  lit: true,
  edges: true,
  crop: false,
  far: false,
  panels: true,
  blind: false,
  lessons: true,
  cropSize: 168,
};

/**
 * Keep a value in the browser, if there is room.
 * @param {Pick<Storage, "setItem">} storage @param {string} name @param {unknown} value
 */
export function keep(storage, name, value) {
  try {
    storage.setItem(name, JSON.stringify(value));
  } catch (error) {
    if (!(error instanceof DOMException && error.name === "QuotaExceededError")) throw error;
  }
}

/** @param {Pick<Storage, "getItem" | "setItem">} storage */
export function createPrefs(storage) {
  const prefs = createValue(loadPrefs(storage));
  prefs.observe((next) => keep(storage, STORAGE_KEY, next));
  return {
    ...prefs,

    /** @param {Partial<Prefs>} some */
    change: (some) => prefs.set({ ...prefs.get(), ...some }),
  };
}

/** @typedef {ReturnType<typeof createPrefs>} PrefsValue */

/** @param {Pick<Storage, "getItem">} storage @returns {Prefs} */
function loadPrefs(storage) {
  try {
    const stored = JSON.parse(storage.getItem(STORAGE_KEY) ?? "{}");
    const known = Object.entries(DEFAULTS).map(([key, value]) => [
      key,
      typeof stored[key] === typeof value ? stored[key] : value,
    ]);
    return Object.fromEntries(known);
  } catch {
    return DEFAULTS;
  }
}

/** @param {PrefsValue} prefs */
export function watchTheme(prefs) {
  const root = document.documentElement;
  const apply = () => {
    const { theme } = prefs.get();
    if (theme === "system") delete root.dataset.theme;
    else root.dataset.theme = theme;
  };
  prefs.observe(apply);
  apply();
}

/** Run when colours may have changed. @param {PrefsValue} prefs @param {() => void} run @returns {() => void} stop */
export function onThemeChange(prefs, run) {
  const system = matchMedia("(prefers-color-scheme: dark)");
  system.addEventListener("change", run);
  const stop = prefs.observe(run);
  return () => {
    system.removeEventListener("change", run);
    stop();
  };
}
