// @ts-check
// What every view is given: calls, address, preferences, keys, messages, who is signed in. It knows
// no room: what rooms keep for the whole page, main.js adds.

import { ApiError } from "./api.js";
import { SESSION_KEY, createSession, endedText } from "./connection.js";
import { loadKeys, saveKeys } from "./keymap.js";
import { createToasts } from "./messages.js";
import { createValue } from "./observable.js";
import { createPrefs } from "./prefs.js";
import { createRouter } from "./router.js";

/** @typedef {import("./types.js").Credential} Credential */
/** @typedef {import("./types.js").NewSession} NewSession */
/** @typedef {Record<string, () => void>} Actions */

/**
 * @param {import("./api.js").Api} api
 * @param {Storage} storage
 * @param {() => void} [startAnew]  another person is signed in now: nothing of this page is theirs
 */
export function createApp(api, storage, startAnew = () => location.reload()) {
  const session = createSession(storage);
  const toasts = createToasts();
  const isSignedIn = createValue(session.current.get() !== null);
  /** Why one is not any more; empty for whoever never was. */
  const ended = createValue("");
  /** Whose answers these are. */
  const person = createValue(/** @type {import("./types.js").Person | null} */ (session.current.get()));
  session.current.observe(person.set);
  /** Whom a login link would sign in instead, until that is answered. */
  const newcomer = createValue(/** @type {NewSession | null} */ (null));
  const keys = createValue(loadKeys(storage));
  keys.observe((settings) => saveKeys(storage, settings));

  /** The session has changed. @param {boolean} isMine  false: it is another person's now */
  const settle = (isMine) => {
    if (!isMine) return startAnew();
    const isIn = session.current.get() !== null;
    if (isIn) ended.set("");
    return isSignedIn.set(isIn);
  };
  /** @param {NewSession} next */
  const enter = (next) => {
    const before = session.current.get()?.session;
    const isMine = session.keep(next);
    if (before && before !== next.session) void api.signOut(before).catch(() => {});
    settle(isMine);
  };
  addEventListener("storage", ({ key }) => (key === SESSION_KEY || key === null) && settle(session.follow()));

  return {
    api,
    router: createRouter(),
    prefs: createPrefs(storage),
    toasts,
    keys,
    /** What the top bar says; views set it by `useHead`. */
    head: createValue(/** @type {import("./hooks.js").Head} */ ({ dataset: "", crumbs: [], tools: null })),
    /** What the views on show can do; the last one that has an action does it. */
    actions: createValue(/** @type {readonly Actions[]} */ ([])),
    /** For screen readers. */
    announcement: createValue(""),
    /** Of the stage: screen px per image px. */
    zoom: createValue(1),

    isSignedIn,
    ended,
    person,
    newcomer,
    /** The name that answers are stored under; empty before anybody has signed in. */
    owner: session.owner,
    startAnew,

    /** Ask the server who this is. */
    greet: () => api.whoAmI().then(person.set, () => {}),

    /** The server does not take the session any more. */
    endSession: () => settle(session.end()),

    /** Signed out is a state of the page, not an error of a view. @param {unknown} error */
    notice(error) {
      if (!(error instanceof ApiError) || error.status !== 401) return;
      ended.set(endedText(error.problem.code));
      settle(session.end());
    },

    /** @param {Credential} credential */
    signIn: async (credential) => enter(await api.signIn(credential)),

    /** By a link: whoever is signed in is asked before another person is. @param {Credential} credential */
    async signInByLink(credential) {
      const next = await api.signIn(credential);
      const now = session.current.get();
      if (now && now.name !== next.name) newcomer.set(next);
      else enter(next);
    },

    /** Say why a link signs nobody in, wherever one looks. @param {string} text */
    refuse: (text) => (isSignedIn.get() ? void toasts.show(text, { kind: "error" }) : ended.set(text)),

    /** The answer to that. @param {boolean} isWanted */
    async admit(isWanted) {
      const next = newcomer.get();
      newcomer.set(null);
      if (!next) return;
      if (isWanted) enter(next);
      else await api.signOut(next.session).catch(() => {});
    },

    async signOut() {
      await api.signOut(session.current.get()?.session ?? "");
      settle(session.end());
    },
  };
}

/** @typedef {ReturnType<typeof createApp>} App */
