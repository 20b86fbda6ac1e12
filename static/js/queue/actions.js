// @ts-check
// What a person can do in the queue, by the keymap's names. No DOM.

import { VERDICT_CYCLE } from "../boxfilter.js";
import { createLookActions } from "../look_actions.js";
import { answerOf } from "../reviews.js";
import { linkTo } from "../router.js";
import { spokenText } from "../wording.js";
import { again, currentOf, nextOpen, stepped } from "./line.js";

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../types.js").Answer} Answer */
/** @typedef {import("./sitting.js").Sitting} Sitting */

/**
 * @param {App} app @param {Sitting} sitting
 * @param {{stage: () => import("../stage/stage.js").Stage | null, openComment: () => void, isBlind: () => boolean,
 *   view: import("../store.js").Value<"crop" | "frame">}} page
 */
export function createQueueActions(app, sitting, page) {
  const { store, line } = sitting;
  const current = () => store.get(currentOf(line.get()) ?? 0) ?? null;

  function say() {
    const box = current();
    if (box) app.announcement.set(page.isBlind() ? `${box.class} ${box.id}` : spokenText(box));
  }

  /** @param {import("./line.js").Line} next */
  function show(next) {
    page.view.set("crop");
    sitting.show(next);
    say();
  }

  /** @param {Answer} verdict @param {string} [comment] */
  function answer(verdict, comment) {
    const box = current();
    if (!box) return;
    performance.mark("queue:answer");
    const isOwn = sitting.tally.get().verdicts.has(box.box_id);
    const words = comment ?? (page.isBlind() && !isOwn ? "" : (box.review?.comment ?? ""));
    const isSame = box.review?.verdict === verdict && (box.review.comment ?? "") === words;
    page.view.set("crop");
    if (isOwn && isSame) sitting.show(nextOpen(line.get()));
    else sitting.answer(box, verdict, words, page.isBlind() && !isOwn);
    say();
  }

  async function undo() {
    const last = app.undo.peek();
    if (!last) return app.toasts.show("Nothing to take back.");
    if (last.batchId) return void app.bulk.undo(last.batchId);
    page.view.set("crop");
    const box = await sitting.takeBack(last).catch((error) => (app.notice(error), app.toasts.show(error.message, { kind: "error" }), null));
    if (box) app.announcement.set(`${box.class} ${box.id}: taken back`);
  }

  function cycleVerdict() {
    const { query, params } = app.router.route.get();
    const at = VERDICT_CYCLE.findIndex((verdict) => verdict === (query.verdict ?? ""));
    const verdict = VERDICT_CYCLE[(at + 1) % VERDICT_CYCLE.length] ?? "";
    app.router.replace(linkTo("queue", params, { ...query, verdict }));
    app.announcement.set(`Showing ${verdict || "all"} boxes`);
  }

  /** The box, the whole frame, the box again; after a pan, first back to the box. */
  function crop() {
    if (page.stage()?.mode() === "free" && page.view.get() === "crop") page.stage()?.recrop();
    else page.view.set(page.view.get() === "crop" ? "frame" : "crop");
  }

  return {
    show,

    /** A comment on a box that has no answer flags it as unsure, and stays. @param {Answer} verdict @param {string} [comment] */
    answer(verdict, comment) {
      const box = current();
      if (comment === undefined || !box) return answer(verdict, comment);
      sitting.comment(box, answerOf(box) ?? verdict, comment);
    },

    again: () => show(again(line.get())),

    /** By the names of the keymap. */
    byName: {
      keep: () => answer("keep"),
      reject: () => answer("reject"),
      unsure: () => answer("unsure"),
      undo: () => void undo(),
      comment: () => current() && page.openComment(),
      next: () => show(stepped(line.get(), 1)),
      previous: () => show(stepped(line.get(), -1)),
      nextUndecided: () => show(nextOpen(line.get())),
      grid: () => app.router.go(linkTo("grid", { dataset: sitting.dataset }, { ...sitting.query, order: "", blind: "" })),
      ...createLookActions(app, page.stage),
      cycleVerdict,
      blind() {
        const { query, params } = app.router.route.get();
        app.router.replace(linkTo("queue", params, { ...query, blind: page.isBlind() ? "off" : "on" }));
      },
      crop,
      fit() {
        page.view.set("frame");
        page.stage()?.fit();
      },
      escape: () => page.view.set("crop"),
    },
  };
}

/** @typedef {ReturnType<typeof createQueueActions>} QueueActions */
