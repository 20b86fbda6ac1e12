// A page on which people answer, without a browser: what views are given, and a server that never answers.

import { createBoxes } from "../../../static/js/boxes/store.js";
import { createValue } from "../../../static/js/core/observable.js";
import { createPrefs } from "../../../static/js/core/prefs.js";
import { parseHash } from "../../../static/js/core/router.js";
import { createAnswers } from "../../../static/js/review/answers.js";
import { decision, memoryStorage } from "./builders.js";

/**
 * Frame 10 with the boxes 1 to 3; `said`: its messages, `offers`: what each offers to do. Call `storageChanged` after
 * another tab has changed what is stored under this name.
 */
export function reviewPage(storage = memoryStorage(), { tab = "t1", openTabs = async () => new Set() } = {}) {
  /** @type {((event: {key: string}) => void)[]} */
  const onStorage = [];
  globalThis.addEventListener = (/** @type {string} */ name, /** @type {any} */ listener) => void (name === "storage" && onStorage.push(listener));
  globalThis.fetch = () => new Promise(() => {});
  /** @type {string[]} */
  const said = [];
  /** @type {any[]} */
  const offers = [];
  const route = createValue(parseHash("#/frames/10"));
  const go = (/** @type {string} */ hash) => route.set(parseHash(hash));
  const show = (/** @type {string} */ text, /** @type {any} */ { action } = {}) => (said.push(text), offers.push(action));
  const core = {
    router: { route, go, replace: go },
    topBar: createValue({ dataset: "d" }),
    announcement: createValue(""),
    toasts: { show, fail: (/** @type {Error} */ { message }, what = "", /** @type {any} */ action) => show(`${what}: ${message}`, { action }), dismiss: () => {} },
    prefs: createPrefs(memoryStorage()),
    isSignedIn: createValue(true),
    owner: () => "ada",
  };
  const answers = createAnswers(/** @type {any} */ (core), createBoxes(), storage, { tab, openTabs });
  answers.boxes.hold(answers.boxes.receive([decision({ box_id: 1 }), decision({ box_id: 2, verdict: "kept" }), decision({ box_id: 3 })]));
  const storageChanged = (/** @type {string} */ key) => onStorage.forEach((notify) => notify({ key }));
  return { app: /** @type {any} */ ({ ...core, ...answers }), said, offers, storageChanged };
}

/** From now on there is no room for more. @param {Storage} storage */
export function fill(storage) {
  storage.setItem = () => {
    throw new DOMException("it is full", "QuotaExceededError");
  };
}
