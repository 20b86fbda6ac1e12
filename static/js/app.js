// @ts-check
// The services that all views share, put together. No DOM beyond window's events.

import { ApiError } from "./api.js";
import { createBulkActs } from "./bulk_acts.js";
import { loadKeys, saveKeys } from "./keymap.js";
import { createFrames } from "./frames.js";
import { nameThisTab, createOutbox } from "./outbox.js";
import { createOpenStores } from "./open_stores.js";
import { createPrefs } from "./prefs.js";
import { withAnswer, withStored } from "./reviews.js";
import { own, unowned } from "./owners.js";
import { createRouter } from "./router.js";
import { createSaver } from "./saver.js";
import { SESSION_KEY, createSession } from "./session.js";
import { LOCAL, createValue } from "./store.js";
import { createToasts } from "./toasts.js";
import { createUndo } from "./undo.js";
import { uploadCalls } from "./calls/uploads.js";
import { createUploads } from "./upload/uploads.js";
import { countOf, endedText } from "./wording.js";

/** @typedef {import("./types.js").Credential} Credential */
/** @typedef {import("./types.js").Decision} Decision */
/** @typedef {import("./types.js").NewSession} NewSession */
/** @typedef {import("./outbox.js").QueuedAnswer} QueuedAnswer */
/** @typedef {Record<string, () => void>} Actions */

/**
 * @param {import("./api.js").Api} api
 * @param {Storage} storage
 * @param {() => void} [startAnew]  another person is signed in now: nothing of this page is theirs
 */
export async function createApp(api, storage, startAnew = () => location.reload()) {
  const { tab, openTabs } = await nameThisTab();
  const session = createSession(storage);
  const outbox = createOutbox(storage, tab, session.owner);
  outbox.adopt(openTabs);

  const router = createRouter();
  const frames = createFrames(api);
  const stores = createOpenStores(() => frames.current()?.store);
  const toasts = createToasts();
  const undo = createUndo();
  const isSignedIn = createValue(session.current.get() !== null);
  /** Why one is not any more; empty for whoever never was. */
  const ended = createValue("");
  /** Whose answers these are. */
  const person = createValue(/** @type {import("./types.js").Person | null} */ (session.current.get()));
  session.current.observe(person.set);
  /** Whom a login link would sign in instead, until that is answered. */
  const newcomer = createValue(/** @type {NewSession | null} */ (null));
  const greet = () => api.whoAmI().then(person.set, () => {});
  const keys = createValue(loadKeys(storage));
  keys.observe((settings) => saveKeys(storage, settings));
  /** Answers that met somebody else's. */
  const conflicts = createValue(/** @type {ReadonlyMap<number, QueuedAnswer>} */ (new Map()));
  /** What the views on show can do; the last one that has an action does it. */
  const actions = createValue(/** @type {readonly Actions[]} */ ([]));
  /** For screen readers. */
  const announcement = createValue("");
  /** Of the stage: screen px per image px. */
  const zoom = createValue(1);

  const saver = createSaver(outbox, api.review, {
    onStored(stored, isLatest) {
      frames.forget(frames.current()?.frame.id);
      if (isLatest) stores.tell(stored.box_id, (box) => withStored(box, stored));
    },
    onConflict(item, current) {
      undo.forget(item.boxId);
      conflicts.set(new Map(conflicts.get()).set(item.boxId, item));
      if (current) stores.tell(item.boxId, () => current);
      // The box on show says it itself, and so does the queue.
      const { name, query } = router.route.get();
      if (name === "queue" || query.box === String(item.boxId)) return;
      toasts.show(`Somebody else has answered a box. Yours (${item.verdict}) is not stored.`, {
        kind: "error",
        action: { text: "Show box", href: `#/frames/${item.frameId}?box=${item.boxId}` },
      });
    },
    onRefused(item, error) {
      undo.forget(item.boxId);
      toasts.show(`Not stored: ${error.message}`, { kind: "error" });
      void frames.refresh(item.boxId);
    },
  });
  /** Signed out is a state of the page, not an error of a view. @param {unknown} error */
  const notice = (error) => {
    if (!(error instanceof ApiError) || error.status !== 401) return;
    ended.set(endedText(error.problem.code));
    settle(session.end());
  };
  /** The session has changed. @param {boolean} isMine  false: it is another person's now */
  const settle = (isMine) => {
    if (!isMine) return startAnew();
    const wasIn = isSignedIn.get();
    isSignedIn.set(session.current.get() !== null);
    if (wasIn || !isSignedIn.get()) return undefined;
    ended.set("");
    offerUnowned();
    void saver.resume();
    return bulk.resume();
  };
  /** @param {NewSession} next */
  const enter = (next) => {
    const before = session.current.get()?.session;
    const isMine = session.keep(next);
    if (before && before !== next.session) void api.signOut(before).catch(() => {});
    settle(isMine);
  };
  /** Answers that are kept since before they had a name on them. */
  const offerUnowned = () => {
    const count = unowned(storage).length;
    const name = session.owner();
    if (count === 0 || !name) return;
    toasts.show(`${countOf(count, "answer")} kept in this browser ${count === 1 ? "has" : "have"} no name.`, {
      action: { text: `Send as ${name}`, run: () => (own(storage, name), startAnew()) },
    });
  };
  addEventListener("storage", ({ key }) => (key === SESSION_KEY || key === null) && settle(session.follow()));
  const bulk = createBulkActs({ storage, tab, openTabs, who: session.owner, stores, frames, toasts, undo, notice });
  saver.state.observe(({ phase }) => phase === "signed-out" && settle(session.end()));
  addEventListener("online", () => (void saver.resume(), bulk.resume()));

  return {
    api,
    router,
    frames,
    stores,
    bulk,
    notice,
    toasts,
    undo,
    saver,
    keys,
    conflicts,
    actions,
    announcement,
    zoom,
    isSignedIn,
    ended,
    person,
    newcomer,
    greet,
    offerUnowned,
    /** How many answers of each person wait in this browser. */
    kept: outbox.kept,
    uploads: createUploads(uploadCalls, isSignedIn),
    prefs: createPrefs(storage),

    /** An answer that lost against another one, given again on top of it. @param {Decision} box @param {QueuedAnswer} item */
    insist(box, item) {
      this.settle(box.box_id);
      stores.answering(box.box_id)?.apply(withAnswer(box, item.verdict, item.comment), LOCAL);
    },

    /** @param {number} boxId */
    settle(boxId) {
      const rest = new Map(conflicts.get());
      rest.delete(boxId);
      conflicts.set(rest);
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

/** @typedef {Awaited<ReturnType<typeof createApp>>} App */
