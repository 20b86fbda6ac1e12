// @ts-check
// Answers on one box: giving and undoing them, those that somebody else overtook, and what the page does when the
// server has responded.
// `answer` gives one. outbox.js keeps it until it is stored, boxes/store.js shows it meanwhile, and sender.js sends it
// and calls one of the events below. Answers on many boxes are in bulk.js.

import { currentAnswer, seenRevision, withStored } from "../boxes/box.js";
import { createValue } from "../core/observable.js";
import { createBulkAnswers } from "./bulk.js";
import { createOutbox, isItemName } from "./outbox.js";
import { createSender } from "./sender.js";

/** @import { Answer, AnswerWithComment, Decision } from "../boxes/box.js" */
/** @import { Boxes } from "../boxes/store.js" */
/** @import { App } from "../core/app.js" */
/** @import { OpenTabs } from "../core/tab.js" */
/** @import { GivenAnswer, NewAnswer, SingleAnswer } from "./outbox.js" */

/** So many answers within two seconds are faster than people look. */
const STREAK = 12;
const STREAK_MS = 2000;

/**
 * Answers, for the whole page: giving and undoing them, those not saved yet, and those overtaken.
 * @param {App} app @param {Boxes} boxes @param {Storage} storage
 * @param {{tab: string, openTabs: () => Promise<OpenTabs>}} tabs  the id of this tab, and
 *   those of the tabs that are open now: each sends its own answers
 */
export function createAnswers(app, boxes, storage, { tab, openTabs }) {
  const { toasts } = app;
  const outbox = createOutbox(storage, tab, app.owner);
  const sender = createSender(outbox);
  const steps = createSteps(boxes);
  /** Answers that were not saved because somebody else had answered first, by box. */
  const overtaken = createValue(/** @type {ReadonlyMap<number, SingleAnswer>} */ (new Map()));
  /** The boxes of a streak that the person is asked about: undefined before the only time, null after it. */
  const streak = createValue(/** @type {readonly number[] | null | undefined} */ (undefined));
  /** @type {{boxId: number, at: number}[]} */
  const recent = [];

  /** @param {number} boxId */
  function noteForStreak(boxId) {
    if (recent.push({ boxId, at: performance.now() }) > STREAK) recent.shift();
    const [first] = recent;
    const isStreak = first && recent.length === STREAK && performance.now() - first.at <= STREAK_MS;
    if (isStreak && streak.get() === undefined) streak.set(recent.map(({ boxId: id }) => id));
  }

  /** The person has seen who answered first, or has answered again. @param {number} boxId */
  function closeOvertaken(boxId) {
    if (!overtaken.get().has(boxId)) return;
    const rest = new Map(overtaken.get());
    rest.delete(boxId);
    overtaken.set(rest);
  }

  /** @param {Decision} box @param {AnswerWithComment} answer @returns {NewAnswer} */
  const answerOn = (box, { verdict, comment }) => ({
    boxId: box.box_id,
    frameId: box.frame_id,
    verdict,
    comment,
    seenRevision: seenRevision(box),
  });

  /**
   * An answer on one box, shown at once and sent when that is possible.
   * @param {number} boxId @param {Answer} verdict @param {string} [comment]
   * @param {number | null} [lookedMs]  for how long the person had the box and its picture on the screen
   * @returns {boolean} false: it was not given
   */
  function answer(boxId, verdict, comment = "", lookedMs = null) {
    const box = boxes.get(boxId);
    if (!box) return false;
    const before = [currentAnswer(box)];
    boxes.keepRevisions([boxId]); // so that a late response with an older revision is dropped
    const given = sender.addAnswer({ ...answerOn(box, { verdict, comment }), lookedMs });
    if (!given) return false;
    noteForStreak(boxId);
    steps.push({ before, dataset: app.topBar.get().dataset, given });
    closeOvertaken(boxId);
    return true;
  }

  const bulkAnswers = createBulkAnswers(app, { boxes, sender, steps });

  /**
   * Undo what this person did last.
   * @param {(box: Decision, dataset: string) => void} show  the box whose answer it was, and its dataset; not called
   *   for a bulk answer
   * @param {(boxIds: readonly number[]) => void} [showMany]  the boxes of a bulk answer, as far as they are known
   */
  function undo(show, showMany = () => {}) {
    const step = steps.last();
    if (!step) return void toasts.show("Nothing to undo.");
    if (!step.given) {
      bulkAnswers.undo(step);
      return showMany(step.before.map(({ boxId }) => boxId));
    }
    const [before] = step.before;
    const box = before && boxes.get(before.boxId);
    if (!box) return steps.drop(step);
    boxes.keepRevisions([box.box_id]);
    const isUndone = sender.undoAnswer(step.given, answerOn(box, before));
    if (isUndone === null) return;
    steps.drop(step);
    closeOvertaken(box.box_id);
    if (!isUndone) return void toasts.show("Not undone: another tab has taken over the answer.", { kind: "error" });
    show(boxes.get(box.box_id) ?? box, step.dataset);
    app.announcement.set(`${box.class} ${box.id}: answer undone`);
  }

  // Boxes are shown with the answers that are not stored yet. The outbox itself cannot be observed, but whenever it
  // changes, the sender's state does.
  boxes.layOver(outbox.lastAnswers());
  sender.state.observe(() => boxes.layOver(outbox.lastAnswers()));

  sender.observe({
    onStored(stored, item) {
      const { box_id: boxId, revision } = stored;
      steps.noteStored(item, revision);
      boxes.receiveAnswers(new Map([[boxId, { revision, applyTo: (box) => withStored(box, stored) }]]));
    },

    onOvertaken(item, current) {
      steps.forget(item.boxId);
      overtaken.set(new Map(overtaken.get()).set(item.boxId, item));
      if (current) boxes.receive([current]);
      // The view of this box shows it itself, and so does the queue.
      const { name, query } = app.router.route.get();
      if (name === "queue" || query.box === String(item.boxId)) return;
      const reviewer = current?.review?.reviewer || "Somebody else";
      const who =
        reviewer === app.owner() ? "You have answered a box elsewhere" : `${reviewer} has answered a box first`;
      toasts.show(`${who}. Your answer here (${item.verdict}) was not saved.`, {
        kind: "error",
        action: { text: "Show box", href: `#/frames/${item.frameId}?box=${item.boxId}` },
      });
    },

    onRefused(item, error) {
      steps.forget(item.boxId);
      toasts.fail(error, item.undoes ? "Not undone" : "Not saved");
      void boxes.loadAgain([item.boxId]);
    },

    onWithdrawn: ({ boxId }) => void boxes.loadAgain([boxId]),

    onFull() {
      const text = "Not saved: this browser has no room for more answers. Answer again when those before are saved.";
      toasts.show(text, { kind: "error" });
    },

    onSignedOut() {
      // If somebody has signed in again meanwhile, only the old session was refused: send with the new one.
      if (app.isSignedIn.get()) void resume();
    },
  });

  /** Send answers that are not saved yet, those of closed tabs too. */
  async function resume() {
    sender.takeOver(await openTabs());
    await sender.resume();
  }
  app.isSignedIn.observe((isIn) => isIn && void resume());
  addEventListener("online", () => void resume());

  let waitingElsewhere = outbox.boxesOfOtherTabs();

  // Another tab has changed the outbox. Boxes whose answer it has stored (or removed) are loaded again, and are shown
  // with that answer until they come.
  addEventListener("storage", ({ key }) => {
    if (!isItemName(key)) return;
    const waiting = outbox.lastAnswers();
    const sent = boxes.all([...waitingElsewhere].filter((boxId) => !waiting.has(boxId)));
    const boxIds = sent.map(({ box_id }) => box_id);
    waitingElsewhere = outbox.boxesOfOtherTabs();
    boxes.showUntilLoaded(boxIds);
    void boxes.loadAgain(boxIds);
    sender.refresh();
  });

  return {
    boxes,
    sender,
    bulkAnswers,
    overtaken,
    streak,
    answer,
    undo,
    resume,
    closeOvertaken,

    /** Replace somebody else's answer with one that was not saved because of it. @param {SingleAnswer} item */
    insist: ({ boxId, verdict, comment }) => answer(boxId, verdict, comment),

    /** How many answers of each person wait in this browser. */
    kept: outbox.countByPerson,
  };
}

/** What views are given in which people answer. @typedef {App & ReturnType<typeof createAnswers>} ReviewApp */

/**
 * @typedef {object} Step  something that can be undone: an answer on one box, or a bulk answer
 * @property {readonly (AnswerWithComment & {boxId: number})[]} before  the earlier answers on its boxes; none for a
 *   bulk answer on boxes that the page does not know
 * @property {string} dataset
 * @property {GivenAnswer} [given]  an answer on one box
 * @property {string} [bulkKey]  the key of a bulk answer
 * @property {number | null} [batchId]  the bulk answer's id on the server, once it is stored
 * @property {number} [count]  how many boxes the bulk answer was to answer
 */

const MOST_STEPS = 500;

/** What this person can undo, the newest last. Its boxes are held in the store. @param {Boxes} boxes */
export function createSteps(boxes) {
  /** @type {{step: Step, release: () => void}[]} */
  const entries = [];

  /** @param {(step: Step) => boolean} isMeant */
  function remove(isMeant) {
    for (const entry of entries.filter(({ step }) => isMeant(step))) {
      entries.splice(entries.indexOf(entry), 1);
      entry.release();
    }
  }

  return {
    /** @param {Step} step */
    push(step) {
      entries.push({ step, release: boxes.remember(step.before.map(({ boxId }) => boxId)) });
      if (entries.length > MOST_STEPS) entries.shift()?.release();
    },

    /**
     * An answer on one box was stored; if that changed nothing, it cannot be undone.
     * @param {SingleAnswer} item @param {number} revision
     */
    noteStored({ key, seenRevision: seen }, revision) {
      if (revision === seen) remove(({ given }) => given?.key === key);
      for (const { step } of entries) if (step.given?.key === key) step.given.revision = revision;
    },

    /** The one to undo next. @returns {Step | null} */
    last: () => entries.at(-1)?.step ?? null,

    /** @param {string} key */
    ofBulkAnswer: (key) => entries.find(({ step }) => step.bulkKey === key)?.step ?? null,

    /** The boxes that steps after this one have answered. @param {Step} step */
    boxesSince(step) {
      const later = entries.slice(entries.findIndex((entry) => entry.step === step) + 1);
      return new Set(later.flatMap((entry) => entry.step.before.map(({ boxId }) => boxId)));
    },

    /** @param {Step} step */
    drop: (step) => remove((one) => one === step),

    /**
     * This person can no longer undo their answers on the box: somebody else has answered it, or the server has refused
     * an answer on it.
     * @param {number} boxId
     */
    forget: (boxId) =>
      remove(({ bulkKey, before }) => bulkKey === undefined && before.some((one) => one.boxId === boxId)),
  };
}

/** @typedef {ReturnType<typeof createSteps>} Steps */
