// @ts-check
// What a person can do on a frame, by the keymap's names. Changes go to the store and the
// address; saving, undo and drawing follow from there. No DOM.

import { seen } from "./blind.js";
import { VERDICT_CYCLE, neighbour, nextUndecided, shownBoxes } from "./boxfilter.js";
import { isUndecided, withAnswer } from "./reviews.js";
import { linkTo } from "./router.js";
import { LOCAL, UNDO } from "./store.js";
import { createLookActions } from "./look_actions.js";
import { spokenText } from "./wording.js";

/** @typedef {import("./app.js").App} App */
/** @typedef {import("./types.js").Answer} Answer */
/** @typedef {import("./types.js").Decision} Decision */
/** @typedef {import("./types.js").Frame} Frame */
/** @typedef {import("./store.js").Store} Store */

/**
 * @param {App} app @param {Frame} frame @param {Store} store
 * @param {{stage: () => import("./stage/stage.js").Stage | null, openComment: () => void}} page
 */
export function createFrameActions(app, frame, store, page) {
  const query = () => app.router.route.get().query;
  const selectedId = () => Number(query().box) || null;
  const selected = () => store.get(selectedId() ?? 0) ?? null;

  /** @param {number | null} boxId */
  function select(boxId) {
    const box = boxId === null ? undefined : store.get(boxId);
    app.router.replace(linkTo("frame", { id: frame.id }, { ...query(), box: box ? String(boxId) : "" }));
    app.announcement.set(box ? spokenText(seen(box, app.prefs.get().blind)) : "");
  }

  /** @param {Answer} verdict @param {string} [comment] */
  function answer(verdict, comment) {
    const box = selected();
    if (!box) return app.toasts.show("Select a box first.");
    const words = comment ?? box.review?.comment ?? "";
    if (box.review?.verdict === verdict && (box.review.comment ?? "") === words) return;
    app.settle(box.box_id);
    store.apply(withAnswer(box, verdict, words), LOCAL);
    app.announcement.set(`${box.class} ${box.id}: ${verdict}`);
  }

  /** @param {number | null} id @param {string} box  which one there: first, last, undecided */
  function goToFrame(id, box) {
    if (id === null) return app.toasts.show("There is no further frame.");
    app.router.go(linkTo("frame", { id }, { ...query(), box }));
  }

  /** @param {1 | -1} step */
  function step(step) {
    const box = neighbour(store.all(), query(), selectedId(), step);
    if (box) select(box.box_id);
    else goToFrame(step > 0 ? frame.next_id : frame.previous_id, step > 0 ? "first" : "last");
  }

  function undo() {
    const last = app.undo.peek();
    if (!last) return app.toasts.show("Nothing to take back.");
    if (last.batchId) return void app.bulk.undo(last.batchId);
    const box = store.get(last.boxId);
    if (!box) return app.router.go(linkTo("frame", { id: last.frameId }, { box: String(last.boxId), undo: "1" }));
    app.undo.take();
    store.apply(withAnswer(box, last.verdict, last.comment), UNDO);
    select(box.box_id);
    app.announcement.set(`${box.class} ${box.id}: taken back`);
  }

  function cycleVerdict() {
    const at = VERDICT_CYCLE.findIndex((verdict) => verdict === (query().verdict ?? ""));
    const verdict = VERDICT_CYCLE[(at + 1) % VERDICT_CYCLE.length] ?? "";
    app.router.replace(linkTo("frame", { id: frame.id }, { ...query(), verdict }));
    app.announcement.set(`Showing ${verdict || "all"} boxes`);
  }

  /** Crop stays on from box to box, and from frame to frame, until it is switched off. */
  function crop() {
    const isCrop = app.prefs.get().crop;
    const hasMoved = page.stage()?.mode() === "free";
    if (isCrop && hasMoved && selected()?.xyxy) page.stage()?.recrop();
    else app.prefs.change({ crop: !isCrop });
  }

  function fit() {
    app.prefs.change({ crop: false });
    page.stage()?.fit();
  }

  return {
    select,
    answer,

    /** What the address asks for instead of a box's number. @param {string} which @returns {number | null} */
    resolve(which) {
      const shown = shownBoxes(store.all(), query());
      if (which === "first") return shown[0]?.box_id ?? null;
      if (which === "last") return shown.at(-1)?.box_id ?? null;
      return (shown.find(isUndecided) ?? shown[0])?.box_id ?? null;
    },

    /** By the names of the keymap. */
    byName: {
      keep: () => answer("keep"),
      reject: () => answer("reject"),
      unsure: () => answer("unsure"),
      undo,
      comment: () => (selected() ? page.openComment() : app.toasts.show("Select a box first.")),
      next: () => step(1),
      previous: () => step(-1),
      nextUndecided() {
        const box = nextUndecided(store.all(), query(), selectedId());
        if (box) select(box.box_id);
        else goToFrame(frame.next_id, "undecided");
      },
      nextFrame: () => goToFrame(frame.next_id, ""),
      previousFrame: () => goToFrame(frame.previous_id, ""),
      grid: () => app.router.go(linkTo("grid", { dataset: frame.dataset }, { ...query(), box: "" })),
      ...createLookActions(app, page.stage),
      blind: () => app.prefs.change({ blind: !app.prefs.get().blind }),
      cycleVerdict,
      crop,
      fit,
      escape: () => select(null),
    },
  };
}

/** @typedef {ReturnType<typeof createFrameActions>} FrameActions */
