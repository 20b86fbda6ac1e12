// @ts-check
// The undo stack: an observer of LOCAL changes, deaf while it undoes.

import { LOCAL } from "./store.js";

/** @typedef {import("./store.js").Change} Change */
/** @typedef {import("./types.js").Answer} Answer */

/**
 * @typedef {object} UndoStep
 * @property {number} boxId
 * @property {number} frameId
 * @property {Answer} verdict  the answer to post again; clear when there was none
 * @property {string} comment
 * @property {number} [batchId]  of a bulk act, which is taken back as one
 */

const DEPTH = 500;

export function createUndo() {
  /** @type {UndoStep[]} */
  const steps = [];

  /** @param {UndoStep} step */
  function push(step) {
    steps.push(step);
    if (steps.length > DEPTH) steps.shift();
  }

  return {
    /** @param {Change} change */
    notice({ origin, before }) {
      if (origin !== LOCAL) return;
      push({
        boxId: before.box_id,
        frameId: before.frame_id,
        verdict: before.review?.verdict ?? "clear",
        comment: before.review?.comment ?? "",
      });
    },

    /** One answer on many boxes is one step. @param {number} batchId */
    noticeBatch: (batchId) => push({ boxId: 0, frameId: 0, verdict: "clear", comment: "", batchId }),

    /** @param {number} batchId */
    forgetBatch(batchId) {
      const at = steps.findIndex((step) => step.batchId === batchId);
      if (at >= 0) steps.splice(at, 1);
    },

    /** The step to take back next, without taking it. */
    peek: () => steps.at(-1) ?? null,

    take: () => steps.pop() ?? null,

    /** Someone else's answer stands now: what this person did to the box is no longer theirs to undo. @param {number} boxId */
    forget(boxId) {
      for (let i = steps.length - 1; i >= 0; i--) if (steps[i]?.boxId === boxId) steps.splice(i, 1);
    },

    size: () => steps.length,
  };
}

/** @typedef {ReturnType<typeof createUndo>} Undo */
