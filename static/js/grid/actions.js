// @ts-check
// What a person can do in the grid, by the keymap's names. No DOM.

import { VERDICT_CYCLE } from "../boxfilter.js";
import { linkTo } from "../router.js";
import { countOf } from "../wording.js";
import { selectionOf } from "./filters.js";
import { allBut, everything, nothing, toggled } from "./selection.js";

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../types.js").Answer} Answer */
/** @typedef {import("./selection.js").Selection} Selection */

/**
 * @param {App} app @param {string} dataset
 * @param {() => {place: import("./places.js").Place, query: import("../router.js").Query}} page  as it is now
 */
export function createGridActions(app, dataset, page) {
  /** Read anew each time: keys come faster than the page is drawn. */
  function now() {
    const { place, query } = page();
    return { selection: place.selection.get(), pager: place.pager, query };
  }

  /** @param {Selection} selection */
  const select = (selection) => page().place.selection.set(selection);

  /** @param {Answer} verdict */
  function answer(verdict) {
    const { selection, pager, query } = now();
    const total = pager.total();
    if (selection.all && total !== null) app.bulk.answerAll(dataset, verdict, selectionOf(query), { total, snapshot: pager.snapshot() });
    else if (selection.ids.size) app.bulk.answer(dataset, verdict, [...selection.ids], pager.revisions());
    else return app.toasts.show("Select boxes first: click, drag, or Space on one.");
    select(nothing(selection));
  }

  function undo() {
    const last = app.undo.peek();
    if (!last) return app.toasts.show("Nothing to take back.");
    if (last.batchId) return void app.bulk.undo(last.batchId);
    app.router.go(linkTo("frame", { id: last.frameId }, { box: String(last.boxId), undo: "1" }));
  }

  /** @param {number} index */
  function toggle(index) {
    const { selection, pager } = now();
    const id = pager.idAt(index);
    if (id === undefined) return;
    if (!selection.all) return select(toggled(selection, index, id));
    if (pager.isWhole()) return select(allBut(selection, pager.allIds(), index, id));
    app.toasts.show("All boxes of the filters are selected. Narrow the filters to leave some out.");
  }

  function open() {
    const { selection, pager, query } = now();
    const box = pager.at(selection.focus);
    if (box) app.router.go(linkTo("frame", { id: box.frame_id }, { ...query, box: String(box.box_id) }));
  }

  return {
    toggle,
    open,

    all() {
      const { selection, pager } = now();
      const total = pager.total();
      if (total === null) return app.toasts.show("The number of boxes is not known yet.");
      select(everything(selection));
      app.announcement.set(`All ${countOf(total, "box", "boxes")} selected`);
    },

    /** By the names of the keymap. */
    byName: {
      keep: () => answer("keep"),
      reject: () => answer("reject"),
      unsure: () => answer("unsure"),
      clear: () => answer("clear"),
      undo,
      crop: open,
      cycleVerdict() {
        const { query } = now();
        const at = VERDICT_CYCLE.findIndex((verdict) => verdict === (query.verdict ?? ""));
        const verdict = VERDICT_CYCLE[(at + 1) % VERDICT_CYCLE.length] ?? "";
        app.router.replace(linkTo("grid", { dataset }, { ...query, verdict }));
        app.announcement.set(`Showing ${verdict || "all"} boxes`);
      },
      blind: () => app.prefs.change({ blind: !app.prefs.get().blind }),
      grid: () => app.router.go(linkTo("frames", { dataset }, now().query)),
      escape: () => select(nothing(now().selection)),
    },
  };
}

/** @typedef {ReturnType<typeof createGridActions>} GridActions */
