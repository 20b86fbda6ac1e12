// @ts-check
// Bulk answers, that is, one answer on many boxes: shown at once, reported when they are stored, undone as a whole.
// Like answers on one box, they go through the outbox, and sender.js sends them.

import { currentAnswer, seenRevision, withAnswer } from "../boxes/box.js";
import { countLookedAt } from "../boxes/crops.js";
import { countOf, countText } from "../core/numbers.js";
import { createValue } from "../core/observable.js";
import { linkTo } from "../core/router.js";
import { randomId } from "../core/tab.js";

/** @import { Answer, AnswerWithComment } from "../boxes/box.js" */
/** @import { Boxes, StoredAnswer } from "../boxes/store.js" */
/** @import { App } from "../core/app.js" */
/** @import { BoxSelection } from "../core/openapi.js" */
/** @import { Step, Steps } from "./answers.js" */
/** @import { BulkAnswer, NewBulkAnswer } from "./outbox.js" */
/** @import { Sender } from "./sender.js" */
/**
 * @typedef {{dataset: string, text: string, boxes: readonly number[]}} Report boxes that a bulk answer, or its undo,
 *   has left out
 */

/** What a bulk answer does with its boxes, before and after it is stored. @type {Record<Answer, string>} */
export const VERBS = { keep: "keep", reject: "reject", unsure: "flag as unsure", clear: "remove the answers of" };

/** @type {Record<Answer, string>} */
const DONE = { keep: "kept", reject: "rejected", unsure: "flagged as unsure", clear: "without an answer again" };

/**
 * @typedef {object} AnswersPage  what bulk answers share with answers on one box
 * @property {Boxes} boxes
 * @property {Sender} sender
 * @property {Steps} steps
 */

/** @param {App} app @param {AnswersPage} page */
export function createBulkAnswers({ toasts, router }, { boxes, sender, steps }) {
  /** The messages that offer to undo a bulk answer, by its key. @type {Map<string, number>} */
  const offers = new Map();
  /**
   * Those bulk answers that are being undone, by their keys: until the undo is stored, or the answer discarded.
   * @type {Map<string, Step>}
   */
  const undoing = new Map();
  const report = createValue(/** @type {Report | null} */ (null));

  /** @param {NewBulkAnswer} bulk @returns {boolean} false: it was not given, as there is no room for it */
  function answer(bulk) {
    const key = randomId();
    const before = boxes.all(bulk.boxIds ?? []).map(currentAnswer);
    const isGiven = sender.addBulkAnswer(bulk, key);
    if (isGiven) pushStep(bulk, key, before);
    return isGiven;
  }

  /**
   * From now on the bulk answer can be undone.
   * @param {NewBulkAnswer} bulk @param {string} key
   * @param {Step["before"]} [before]  not known of a bulk answer that was given before the page was loaded
   */
  function pushStep({ dataset, count }, key, before = []) {
    /** @type {Step} */
    const step = { before, dataset, bulkKey: key, batchId: null, count };
    steps.push(step);
    return step;
  }

  /** Undo a whole bulk answer, but for boxes that this person has answered since. @param {Step} step */
  function undo(step) {
    const { bulkKey = "", batchId = null, dataset, count = 0 } = step;
    const answeredSince = steps.boxesSince(step);
    const earlier = step.before.filter(({ boxId }) => !answeredSince.has(boxId));
    const boxIds = earlier.map(({ boxId }) => boxId);
    const seenRevisions = boxIds.map((boxId) => seenRevision(boxes.get(boxId) ?? {}));
    const before = earlier.map(({ verdict, comment }) => ({ verdict, comment }));
    const laterIds = step.before.map(({ boxId }) => boxId).filter((boxId) => answeredSince.has(boxId));
    const areKnown = step.before.length > 0;

    toasts.dismiss(offers.get(bulkKey) ?? 0);
    boxes.keepRevisions(boxIds);
    const which = areKnown ? { boxIds, seenRevisions } : {};
    undoing.set(bulkKey, step);
    const outcome = sender.addBulkUndo({ bulkKey, batchId, dataset, count, before, laterIds, ...which });
    if (outcome === "full") undoing.delete(bulkKey);
    else steps.drop(step);
  }

  /**
   * Discard an unsent bulk answer. One that was sent before, without a response, is undone: the server may have it.
   * @param {BulkAnswer} bulk
   */
  const discard = (bulk) => undo(steps.ofBulkAnswer(bulk.key) ?? pushStep(bulk, bulk.key));

  /**
   * Give a refused bulk answer again: on those of its boxes that were not answered since, or on all that its filter
   * selects now.
   * @param {BulkAnswer} bulk
   * @param {{total: number, snapshot: string}} [list]  of the boxes of the filter, as the person sees it now
   */
  function answerAgain({ key, dataset, verdict, boxIds, seenRevisions = [], filter, snapshot, count }, list) {
    /** @param {boolean} isGiven */
    const discardIf = (isGiven) => isGiven && sender.discard(key);
    if (!boxIds) {
      const seen = list ? { snapshot: list.snapshot, count: list.total } : { snapshot, count };
      return discardIf(answer({ dataset, verdict, filter, ...seen }));
    }
    const { waiting, waitingInBulk } = sender.state.get();
    const revisions = new Map(boxIds.map((boxId, i) => [boxId, seenRevisions[i] ?? 0]));
    const unanswered = boxIds.filter((boxId) => {
      const box = boxes.get(boxId);
      const isAsSeen = !box || seenRevision(box) === revisions.get(boxId);
      return isAsSeen && !waiting.has(boxId) && !waitingInBulk.has(boxId);
    });
    if (unanswered.length === 0) toasts.show("All of these boxes were answered since.");
    discardIf(unanswered.length === 0 || answerBoxes(dataset, verdict, unanswered, revisions));
  }

  /**
   * One answer on these boxes, shown at once.
   * @param {string} dataset @param {Answer} verdict @param {readonly number[]} boxIds
   * @param {ReadonlyMap<number, number>} revisions  as the person saw them
   */
  function answerBoxes(dataset, verdict, boxIds, revisions) {
    const seenRevisions = boxIds.map((id) => revisions.get(id) ?? 0);
    return answer({
      dataset,
      verdict,
      boxIds: [...boxIds],
      seenRevisions,
      count: boxIds.length,
      lookedAt: countLookedAt(boxIds),
    });
  }

  /**
   * The server has stored these answers.
   * @param {readonly number[]} boxIds @param {(i: number) => AnswerWithComment} answerAt
   * @param {readonly number[]} [seenRevisions]  of the boxes, before these answers
   * @param {readonly number[]} [leftOut]  boxes whose answer it has not stored
   */
  function receive(boxIds, answerAt, seenRevisions = [], leftOut = []) {
    const left = new Set(leftOut);
    boxes.keepRevisions(boxIds);
    /** @type {Map<number, StoredAnswer>} */
    const stored = new Map();
    boxIds.forEach((boxId, i) => {
      const { verdict, comment } = answerAt(i);
      const revision = (seenRevisions[i] ?? 0) + 1;
      if (!left.has(boxId))
        stored.set(boxId, { revision, applyTo: (box) => withAnswer(box, verdict, comment, revision) });
    });
    boxes.receiveAnswers(stored);
  }

  sender.observe({
    onBulkStored(bulk, { id, count, skipped, stale }) {
      const { key, verdict, boxIds = [], seenRevisions } = bulk;
      const leftOut = count ? [...stale, ...skipped] : boxIds;
      const left = new Set(leftOut);
      const step = undoing.get(key) ?? steps.ofBulkAnswer(key) ?? pushStep(bulk, key);
      step.batchId = id;
      step.before = step.before.filter(({ boxId }) => !left.has(boxId));
      receive(boxIds, () => ({ verdict, comment: "" }), seenRevisions, leftOut);
      if (bulk.filter) boxes.reload();
      void boxes.loadAgain(stale);
      if (count) {
        const offer = undoing.has(key) ? undefined : { text: "Undo", run: () => steps.ofBulkAnswer(key) && undo(step) };
        const isPartly = typeof bulk.lookedAt === "number" && bulk.lookedAt < count;
        const looked = isPartly ? `, ${countText(bulk.lookedAt ?? 0)} of them looked at` : "";
        const done = `${countOf(count, "box", "boxes")} ${DONE[verdict]}${looked}`;
        offers.set(key, toasts.show(done, { action: offer }));
      } else {
        steps.drop(step);
        toasts.show("No answer has changed.");
      }
      report.set(reportOf(bulk.dataset, stale, skipped));
    },

    onBulkRefused({ dataset, count }, error) {
      if (router.route.get().name === "grid") return; // the grid shows it itself
      toasts.fail(error, `${countOf(count, "answer")} not saved`, { text: "Show", href: linkTo("grid", { dataset }) });
    },

    onBulkDiscarded({ key, verdict, count }) {
      const step = steps.ofBulkAnswer(key);
      if (step) steps.drop(step);
      const isUndone = undoing.delete(key);
      if (isUndone) toasts.show(`Discarded: ${VERBS[verdict]} ${countOf(count, "box", "boxes")}`);
    },

    onUndoStored({ bulkKey, dataset, boxIds, seenRevisions, before, laterIds = [] }, { undone, skipped }) {
      undoing.delete(bulkKey);
      // If a later answer on one of these was undone in the meantime, the server has undone the bulk answer there, too.
      void boxes.loadAgain(laterIds);
      receive(boxIds ?? [], (i) => before[i] ?? { verdict: "clear", comment: "" }, seenRevisions, skipped);
      if (!boxIds) boxes.reload();
      toasts.show(`${countOf(undone, "answer")} undone`);
      report.set(undoReportOf(dataset, skipped));
    },

    onUndoRefused({ bulkKey, boxIds = [] }, error) {
      undoing.delete(bulkKey);
      toasts.fail(error, "Not undone");
      void boxes.loadAgain(boxIds);
    },
  });

  return {
    report,
    undo,
    discard,
    answerAgain,
    answer: answerBoxes,

    /**
     * One answer on all boxes that a filter selected when the list was read.
     * @param {string} dataset @param {Answer} verdict @param {BoxSelection} filter
     * @param {{total: number, snapshot: string, knownIds?: readonly number[]}} list `knownIds`: of its boxes, those
     *   that the page has loaded
     */
    answerAll: (dataset, verdict, filter, { total, snapshot, knownIds }) =>
      answer({
        dataset,
        verdict,
        filter,
        snapshot,
        count: total,
        lookedAt: knownIds && Math.min(countLookedAt(knownIds), total),
      }),
  };
}

/**
 * The boxes that a bulk answer has left out, and why.
 * @param {string} dataset @param {number[]} stale @param {number[]} skipped @returns {Report | null}
 */
function reportOf(dataset, stale, skipped) {
  /** @param {readonly number[]} boxIds @param {string} why */
  const line = ({ length }, why) => (length ? [`${countOf(length, "box was", "boxes were")} left out: ${why}.`] : []);
  const lines = [...line(stale, "somebody has answered since"), ...line(skipped, "deleted or replaced meanwhile")];
  return lines.length ? { dataset, text: lines.join(" "), boxes: [...stale, ...skipped] } : null;
}

/**
 * The boxes that the undo of a bulk answer has left as they are.
 * @param {string} dataset @param {number[]} skipped @returns {Report | null}
 */
function undoReportOf(dataset, skipped) {
  if (skipped.length === 0) return null;
  const count = countOf(skipped.length, "answer was", "answers were");
  const asIs = skipped.length === 1 ? "it is" : "they are";
  return { dataset, text: `${count} left as ${asIs}: somebody has answered since.`, boxes: skipped };
}
