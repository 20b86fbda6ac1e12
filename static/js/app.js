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
import { createRouter } from "./router.js";
import { createSaver } from "./saver.js";
import { LOCAL, createValue } from "./store.js";
import { createToasts } from "./toasts.js";
import { createUndo } from "./undo.js";
import { uploadCalls } from "./calls/uploads.js";
import { createUploads } from "./upload/uploads.js";
import { endedText } from "./wording.js";

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
  const stores = createOpenStores(() => frames.current()?.store);
  const toasts = createToasts();
  const undo = createUndo();
  const isSignedIn = createValue(true);
  /** Why one is not any more; empty for whoever never was. */
  const ended = createValue("");
  /** Whose answers these are. */
  const person = createValue(/** @type {import("./types.js").Person | null} */ (null));
  const greet = () => api.whoAmI().then(person.set, () => person.set(null));
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
    isSignedIn.set(false);
  };
  const bulk = createBulkActs({ storage, tab, openTabs, stores, frames, toasts, undo, notice });
  saver.state.observe(({ phase }) => phase === "signed-out" && isSignedIn.set(false));
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
    greet,
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

    /** @param {string} token */
    async signIn(token) {
      await api.signIn(token);
      ended.set("");
      isSignedIn.set(true);
      void greet();
      void saver.resume();
      bulk.resume();
    },

    async signOut() {
      await api.signOut();
      isSignedIn.set(false);
    },
  };
}

/** @typedef {Awaited<ReturnType<typeof createApp>>} App */
