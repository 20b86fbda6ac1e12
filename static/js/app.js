// @ts-check
// The services that all views share, put together. No DOM beyond window's events.

import { ApiError } from "./api.js";
import { loadKeys, saveKeys } from "./keymap.js";
import { createFrames } from "./frames.js";
import { nameThisTab, createOutbox } from "./outbox.js";
import { createPrefs } from "./prefs.js";
import { withAnswer, withStored } from "./reviews.js";
import { createRouter } from "./router.js";
import { createSaver } from "./saver.js";
import { LOCAL, REMOTE, createValue } from "./store.js";
import { createToasts } from "./toasts.js";
import { createUndo } from "./undo.js";

/** @typedef {import("./types.js").Decision} Decision */
/** @typedef {import("./outbox.js").QueuedAnswer} QueuedAnswer */
/** @typedef {Record<string, () => void>} Actions */

/**
 * @param {import("./api.js").Api} api
 * @param {Storage} storage
 */
export async function createApp(api, storage) {
  const { tab, openTabs } = await nameThisTab();
  const outbox = createOutbox(storage, tab);
  outbox.adopt(openTabs);

  const router = createRouter();
  const frames = createFrames(api);
  const toasts = createToasts();
  const undo = createUndo();
  const isSignedIn = createValue(true);
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
      const box = frames.boxOnShow(stored.box_id);
      if (box && isLatest) frames.current()?.store.apply(withStored(box, stored), REMOTE);
    },
    onConflict(item, current) {
      undo.forget(item.boxId);
      conflicts.set(new Map(conflicts.get()).set(item.boxId, item));
      if (current && frames.boxOnShow(item.boxId)) frames.current()?.store.apply(current, REMOTE);
      // The box on show says it itself.
      if (router.route.get().query.box === String(item.boxId)) return;
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
  saver.state.observe(({ phase }) => phase === "signed-out" && isSignedIn.set(false));
  addEventListener("online", () => void saver.resume());

  return {
    api,
    router,
    frames,
    toasts,
    undo,
    saver,
    keys,
    conflicts,
    actions,
    announcement,
    zoom,
    isSignedIn,
    prefs: createPrefs(storage),

    /** An answer that lost against another one, given again on top of it. @param {Decision} box @param {QueuedAnswer} item */
    insist(box, item) {
      this.settle(box.box_id);
      frames.current()?.store.apply(withAnswer(box, item.verdict, item.comment), LOCAL);
    },

    /** @param {number} boxId */
    settle(boxId) {
      const rest = new Map(conflicts.get());
      rest.delete(boxId);
      conflicts.set(rest);
    },

    /** @param {string} token */
    async signIn(token) {
      await api.signIn(token);
      isSignedIn.set(true);
      void saver.resume();
    },

    async signOut() {
      await api.signOut();
      isSignedIn.set(false);
    },

    /** Signed out is a state of the page, not an error of a view. @param {unknown} error */
    notice(error) {
      if (error instanceof ApiError && error.status === 401) isSignedIn.set(false);
    },
  };
}

/** @typedef {Awaited<ReturnType<typeof createApp>>} App */
