// @ts-check
// What every view is given: address, preferences, keys, messages, who is signed in. It imports
// nothing from other folders; main.js adds boxes, answers and uploads.

import { get, post, remove, whenSignedOut } from "./api.js";
import { loadKeys, saveKeys } from "./keymap.js";
import { SESSION_KEY, createLogin, endedText } from "./login.js";
import { createValue } from "./observable.js";
import { createPrefs } from "./prefs.js";
import { createRouter } from "./router.js";

/** @import { TopBar } from "./hooks.js" */
/** @import { KeyPress } from "./keymap.js" */
/** @import { LogIn as Credential, NewSession, Session } from "./openapi.js" */
/** @typedef {Record<string, (press?: KeyPress) => void>} Actions */
/** @typedef {{text: string, href?: string, run?: () => void}} ToastAction  a link, or something to run */
/** @typedef {{id: number, kind: "info" | "error", text: string, action?: ToastAction}} Toast */

const SESSION = "/api/v1/session";

/**
 * @param {Storage} storage
 * @param {() => void} [startAnew]  called when another person is signed in: what this page holds is not theirs
 */
export function createApp(storage, startAnew = () => location.reload()) {
  const session = createLogin(storage);
  const toasts = createToasts();
  const isSignedIn = createValue(session.current.get() !== null);
  /** Why the session has ended; empty if nobody was signed in. */
  const ended = createValue("");
  /** Who is signed in; answers are stored under this name. */
  const person = createValue(/** @type {Session | null} */ (session.current.get()));
  session.current.observe(person.set);
  /** Another person, whom an opened login link would sign in, until somebody confirms or refuses it. */
  const newcomer = createValue(/** @type {NewSession | null} */ (null));
  const keys = createValue(loadKeys(storage));
  keys.observe((settings) => saveKeys(storage, settings));

  /** The session has changed. @param {boolean} isMine  false: it is another person's now */
  const sessionChanged = (isMine) => {
    if (!isMine) return startAnew();
    const isIn = session.current.get() !== null;
    if (isIn) ended.set("");
    return isSignedIn.set(isIn);
  };
  /** @param {NewSession} next */
  const enter = (next) => {
    const before = session.current.get()?.session;
    const isMine = session.keep(next);
    if (before && before !== next.session) void signOut(before).catch(() => {});
    sessionChanged(isMine);
  };
  /** @param {string} secret  of the session that ends */
  const signOut = (secret) => remove(SESSION, { session: secret });
  /** Sent without the current session. @param {Credential} body */
  const signIn = (body) => post(SESSION, { body, session: "" });
  // Signed out is a state of the page, not an error of a view.
  whenSignedOut(({ problem }) => {
    ended.set(endedText(problem.code));
    sessionChanged(session.end());
  });
  addEventListener("storage", ({ key }) => (key === SESSION_KEY || key === null) && sessionChanged(session.follow()));

  return {
    router: createRouter(),
    prefs: createPrefs(storage),
    toasts,
    keys,
    /** What the top bar says; views set it by `useTopBar`. */
    topBar: createValue(/** @type {TopBar} */ ({ dataset: "", crumbs: [], tools: null })),
    /** Actions of the views on the page; if several offer the same one, the last is used. */
    actions: createValue(/** @type {readonly Actions[]} */ ([])),
    /** For screen readers. */
    announcement: createValue(""),
    /** Zoom of the stage, screen px per image px. */
    zoom: createValue(1),
    /** Whether the stage shows the picture alone, because a key or a button is held. */
    isBare: createValue(false),

    isSignedIn,
    ended,
    person,
    newcomer,
    /** The name that answers are stored under; empty before anybody has signed in. */
    owner: session.owner,
    startAnew,

    /** Ask the server who this is. */
    greet: () => get(SESSION).then(person.set, () => {}),

    /** @param {Credential} credential */
    signIn: async (credential) => enter(await signIn(credential)),

    /** Sign in by a link. If another person is signed in, they are asked first. @param {Credential} credential */
    async signInByLink(credential) {
      const next = await signIn(credential);
      const now = session.current.get();
      if (now && now.name !== next.name) newcomer.set(next);
      else enter(next);
    },

    /** Show why a link does not sign anybody in: as a message, or on the sign-in form. @param {string} text */
    refuse: (text) => (isSignedIn.get() ? void toasts.show(text, { kind: "error" }) : ended.set(text)),

    /** Whether the person of the opened login link is to be signed in. @param {boolean} isWanted */
    async admit(isWanted) {
      const next = newcomer.get();
      newcomer.set(null);
      if (!next) return;
      if (isWanted) enter(next);
      else await signOut(next.session).catch(() => {});
    },

    async signOut() {
      await signOut(session.current.get()?.session ?? "");
      sessionChanged(session.end());
    },
  };
}

/** @typedef {ReturnType<typeof createApp>} App */

const SHOWN_MS = { info: 4000, error: 12000 };

/** Long enough to read what was done, and to reach the button that undoes it. */
const WITH_ACTION_MS = 9000;
const MOST = 3;

function createToasts() {
  const list = createValue(/** @type {readonly Toast[]} */ ([]));
  let lastId = 0;

  /** @param {number} id */
  const dismiss = (id) => list.set(list.get().filter((toast) => toast.id !== id));

  /** @returns {number} its id @param {string} text @param {{kind?: "info" | "error", action?: ToastAction}} [how] */
  function show(text, { kind = "info", action } = {}) {
    const id = ++lastId;
    const others = list.get().filter((toast) => toast.text !== text);
    list.set([...others, { id, kind, text, action }].slice(-MOST));
    setTimeout(() => dismiss(id), Math.max(SHOWN_MS[kind], action ? WITH_ACTION_MS : 0));
    return id;
  }

  return {
    list,
    dismiss,
    show,

    /**
     * Say why something failed.
     * @param {Error} error @param {string} [what] what failed
     * @param {ToastAction} [action]
     */
    fail: (error, what = "", action) => void show(`${what && `${what}: `}${error.message}`, { kind: "error", action }),
  };
}
