// @ts-check
// All changes of answers go through here: answer one box or many, undo, replace somebody else's answer, discard.

import { answerTo, seenRevision, withAnswer, withStored } from "../boxes/box.js";
import { get, post } from "../core/api.js";
import { countOf } from "../core/numbers.js";
import { createValue } from "../core/observable.js";
import { countUnowned, createOutbox, createSender, discardUnowned, own, randomId, sendBulk, undoBulk } from "./outbox.js";

/** @typedef {import("../boxes/box.js").Answer} Answer */
/** @typedef {import("../boxes/store.js").Boxes} Boxes */
/** @typedef {import("../boxes/box.js").Decision} Decision */
/** @typedef {import("./outbox.js").QueuedAnswer} QueuedAnswer */
/** @typedef {{text: string, boxes: readonly number[]}} Report  boxes that a bulk answer or an undo left alone */

/** For more boxes than this, the lists are read again in place of each box. */
const MOST_LOOKS = 20;

/** @type {Record<Answer, string>} */
const DONE = { keep: "kept", reject: "rejected", unsure: "flagged as unsure", clear: "without an answer again" };

/**
 * Answers, for the whole page: giving and undoing them, those not saved yet, and conflicts.
 * @param {import("../core/app.js").App} app @param {Boxes} boxes @param {Storage} storage
 * @param {{tab: string, openTabs: () => Promise<import("./outbox.js").OpenTabs>}} tabs  the id of this tab, and those of the tabs that are open now: each sends its own answers
 */
export function createAnswers(app, boxes, storage, { tab, openTabs }) {
  const { toasts } = app;
  const outbox = createOutbox(storage, tab, app.owner);
  const steps = createSteps(boxes);
  /** The boxes that were answered last are held in the store, so that an older response, still on its way, does not replace them. @type {(() => void)[]} */
  const answered = [];

  /** @param {readonly number[]} ids */
  function remember(ids) {
    answered.push(boxes.hold(ids));
    if (answered.length > MOST_STEPS) answered.shift()?.();
  }
  /** The frame whose answers the server has stored last, so that a frame fetched before is not used; `id` is null after a bulk answer. */
  const changedFrame = createValue(/** @type {{id: number | null}} */ ({ id: null }));
  /** Answers that were not saved because somebody else had answered first. */
  const conflicts = createValue(/** @type {ReadonlyMap<number, QueuedAnswer>} */ (new Map()));

  /** Load boxes again that others have answered. @param {readonly number[]} boxIds */
  async function lookAgain(boxIds) {
    if (boxIds.length > MOST_LOOKS) return bulkAnswers.reloads.set(bulkAnswers.reloads.get() + 1);
    for (const id of boxIds) {
      const box = await get("/api/v1/boxes/{box_id}", { path: { box_id: id } }).catch(() => null);
      if (box) boxes.receive([box]);
    }
  }

  /** Put something into the outbox. @param {() => void} put @returns {boolean} false: this browser has no room for it, and the person is told */
  function hasRoomFor(put) {
    try {
      put();
      return true;
    } catch (error) {
      if (!(error instanceof DOMException && error.name === "QuotaExceededError")) throw error;
      toasts.show("Not saved: this browser has no room for more answers. Answer again when those before are saved.", { kind: "error" });
      return false;
    }
  }

  const bulkAnswers = createBulkAnswers({
    ...{ boxes, changedFrame, toasts, steps, remember, lookAgain, give },
    start: (bulk, key) => hasRoomFor(() => sender.start(bulk, key)),
    undo: (undo) => hasRoomFor(() => sender.undo(undo)),
  });
  const sender = createSender(outbox, { answer: (boxId, body, key) => post("/api/v1/boxes/{box_id}/reviews", { path: { box_id: boxId }, body, key }), answerMany: sendBulk, undo: undoBulk }, {
    onStored(stored) {
      const box = boxes.get(stored.box_id);
      changedFrame.set({ id: box?.frame_id ?? null });
      if (box) boxes.receive([withStored(box, stored)]);
    },
    onConflict(item, current) {
      steps.forget(item.boxId);
      conflicts.set(new Map(conflicts.get()).set(item.boxId, item));
      if (current) boxes.receive([current]);
      // The view of this box shows the conflict itself, and so does the queue.
      const { name, query } = app.router.route.get();
      if (name === "queue" || query.box === String(item.boxId)) return;
      toasts.show(`Somebody else has answered a box first. Your answer (${item.verdict}) was not saved.`, {
        kind: "error",
        action: { text: "Show box", href: `#/frames/${item.frameId}?box=${item.boxId}` },
      });
    },
    onRefused(item, error) {
      steps.forget(item.boxId);
      toasts.show(`Not saved: ${error.message}`, { kind: "error" });
      void lookAgain([item.boxId]);
    },
    onDone: bulkAnswers.done,
    onGivenUp: bulkAnswers.givenUp,
    onUndone: bulkAnswers.undone,
    onUndoRefused: bulkAnswers.undoRefused,
    // The session ends where it is refused. If another one has begun meanwhile, it is tried with that one.
    onSignedOut: () => void (app.isSignedIn.get() && resume()),
  });
  // The state changes with every change of the outbox.
  sender.state.observe(() => boxes.layOver(outbox.given()));

  /** Send answers that are not saved yet, those of closed tabs too. */
  async function resume() {
    sender.adopt(await openTabs());
    await sender.resume();
  }
  app.isSignedIn.observe((isIn) => isIn && void resume());
  addEventListener("online", () => void resume());

  /** How many answers in this browser do not say who gave them: an earlier version of the page has kept them. */
  const unowned = createValue(countUnowned(storage));
  const countAgain = () => unowned.set(countUnowned(storage));
  // Another tab may have sent or discarded them.
  addEventListener("storage", countAgain);

  /** @param {number} boxId */
  function closeConflict(boxId) {
    if (!conflicts.get().has(boxId)) return;
    const rest = new Map(conflicts.get());
    rest.delete(boxId);
    conflicts.set(rest);
  }

  /** @param {Decision} box @param {Answer} verdict @param {string} comment @returns {boolean} false: there is no room for it */
  function give(box, verdict, comment) {
    const answer = { boxId: box.box_id, frameId: box.frame_id, verdict, comment, seenRevision: seenRevision(box) };
    remember([box.box_id]);
    const isGiven = hasRoomFor(() => sender.answer(answer));
    if (isGiven) closeConflict(box.box_id);
    return isGiven;
  }

  /** An answer on one box, shown at once and sent when that is possible. @param {number} boxId @param {Answer} verdict @param {string} [comment] @returns {boolean} false: it was not given */
  function answer(boxId, verdict, comment = "") {
    const box = boxes.get(boxId);
    if (!box) return false;
    const step = { before: [answerTo(box)], dataset: app.head.get().dataset };
    const isGiven = give(box, verdict, comment);
    if (isGiven) steps.push(step);
    return isGiven;
  }

  return {
    boxes,
    changedFrame,
    sender,
    bulkAnswers,
    conflicts,
    answer,
    resume,

    /** Answers that do not say who gave them: the person who is signed in may take them as theirs, or discard them. */
    unowned: {
      count: unowned,
      send() {
        own(storage, app.owner());
        countAgain();
        void resume();
      },
      discard() {
        discardUnowned(storage);
        countAgain();
      },
    },

    /** How many answers of each person wait in this browser. */
    kept: outbox.kept,
    /** A conflict that the person has seen. */
    closeConflict,

    /** Replace somebody else's answer with one that was not saved because of it. @param {QueuedAnswer} item */
    insist: ({ boxId, verdict, comment }) => answer(boxId, verdict, comment),

    /** Undo what this person did last. @param {(box: Decision, dataset: string) => void} show  the box whose answer it was, and its dataset; not called for a bulk answer */
    undo(show) {
      const last = steps.last();
      if (!last) return void toasts.show("Nothing to undo.");
      if (last.bulkKey) return bulkAnswers.undo(last);
      const [{ boxId, verdict, comment } = { boxId: 0, verdict: /** @type {Answer} */ ("clear"), comment: "" }] = last.before;
      const box = boxes.get(boxId);
      if (!box) return steps.drop(last);
      if (!give(box, verdict, comment)) return;
      steps.drop(last);
      show(boxes.get(boxId) ?? box, last.dataset);
      app.announcement.set(`${box.class} ${box.id}: answer undone`);
    },
  };
}

/** @typedef {import("../core/app.js").App & ReturnType<typeof createAnswers>} ReviewApp  what views are given in which people answer */

/**
 * Bulk answers, on many boxes: shown at once, reported when they are stored, undone as a whole.
 * @param {{boxes: Boxes, changedFrame: import("../core/observable.js").Value<{id: number | null}>, toasts: import("../core/app.js").App["toasts"], steps: Steps,
 *   remember: (boxIds: readonly number[]) => void, lookAgain: (boxIds: readonly number[]) => Promise<void>, give: (box: Decision, verdict: Answer, comment: string) => boolean,
 *   start: (bulk: import("./outbox.js").WantedBulkAnswer, key: string) => boolean, undo: (undo: import("./outbox.js").WantedUndo) => boolean}} page  `give`, `start`, `undo`: false, there is no room for it
 */
function createBulkAnswers({ boxes, changedFrame, toasts, steps, remember, lookAgain, give, start, undo }) {
  /** The messages that offer to undo a bulk answer, by its key. @type {Map<string, number>} */
  const offers = new Map();
  /** The bulk answers whose undo is not stored yet, by their keys. @type {Map<string, Step>} */
  const undoing = new Map();
  const report = createValue(/** @type {Report | null} */ (null));
  /** Increases when a bulk answer on all boxes of a filter was stored or undone, so that lists are read again. */
  const reloads = createValue(0);

  /** Which boxes were left out, and why. @param {number[]} skipped @param {number[]} stale @returns {Report | null} */
  function leftOut(skipped, stale) {
    const why = [];
    if (stale.length) why.push(`${countOf(stale.length, "box was", "boxes were")} left out: somebody has answered since.`);
    if (skipped.length) why.push(`${countOf(skipped.length, "box was", "boxes were")} left out: deleted or replaced meanwhile.`);
    return why.length ? { text: why.join(" "), boxes: [...stale, ...skipped] } : null;
  }

  /** The server has stored these answers. @param {readonly Given[]} given @param {readonly number[]} but  boxes whose answer it has not stored */
  function stored(given, but) {
    const left = new Set(but);
    remember(given.map(({ boxId }) => boxId));
    boxes.receive(
      given.flatMap(({ boxId, verdict, comment, revision }) => {
        const box = left.has(boxId) ? undefined : boxes.get(boxId);
        return box ? [withAnswer(box, verdict, comment, revision + 1)] : [];
      }),
    );
    changedFrame.set({ id: null });
  }

  /** The step of this bulk answer, which can be undone from now on. @param {import("./outbox.js").WantedBulkAnswer} bulk @param {string} key @param {readonly Earlier[]} [before]  unknown of a bulk answer that was given before the page was loaded */
  function pushed({ dataset, count }, key, before = []) {
    /** @type {Step} */
    const step = { before, dataset, bulkKey: key, batch: null, count };
    steps.push(step);
    return step;
  }

  /** @param {import("./outbox.js").WantedBulkAnswer} bulk */
  function answerMany(bulk) {
    const key = randomId();
    const before = boxes.all(bulk.boxIds ?? []).map(answerTo);
    if (start(bulk, key)) pushed(bulk, key, before);
  }

  /**
   * After a bulk answer was discarded, give its boxes their earlier answers where they do not have them: undoing a later
   * answer has given them the bulk answer's, as an answer of their own.
   * @param {Step} step @param {ReadonlySet<number>} since  boxes that this person has answered since
   */
  function restore(step, since) {
    for (const { boxId, verdict, comment } of step.before) {
      const box = since.has(boxId) ? undefined : boxes.get(boxId);
      const now = box && answerTo(box);
      if (now && (now.verdict !== verdict || now.comment !== comment)) give(box, verdict, comment);
    }
  }

  /** Undo a whole bulk answer, but for boxes that this person has answered since. @param {Step} step */
  function undoStep(step) {
    const { bulkKey = "", batch = null, dataset, count = 0 } = step;
    const since = steps.since(step);
    const meant = step.before.filter(({ boxId }) => !since.has(boxId));
    const seen = meant.map(({ boxId }) => seenRevision(boxes.get(boxId) ?? {}));
    toasts.dismiss(offers.get(bulkKey) ?? 0);
    remember(meant.map(({ boxId }) => boxId));
    undoing.set(bulkKey, step);
    steps.drop(step);
    const which = step.before.length ? { boxIds: meant.map(({ boxId }) => boxId), seen } : {};
    const isGiven = undo({ act: bulkKey, batch, dataset, count, before: meant.map(({ verdict, comment }) => ({ verdict, comment })), ...which });
    if (isGiven && !undoing.has(bulkKey)) restore(step, since);
    if (isGiven) return;
    undoing.delete(bulkKey);
    steps.push(step);
  }

  return {
    report,
    reloads,

    /** A bulk answer was stored. @param {import("./outbox.js").StoredBulkAnswer} done */
    done({ batchId, bulk, skipped, stale }) {
      const { key } = bulk;
      const left = new Set([...stale, ...skipped]);
      const step = undoing.get(key) ?? steps.ofBulkAnswer(key) ?? pushed(bulk, key);
      step.batch = batchId;
      step.before = step.before.filter(({ boxId }) => !left.has(boxId));
      stored((bulk.boxIds ?? []).map((boxId, i) => ({ boxId, verdict: bulk.verdict, comment: "", revision: bulk.seen?.[i] ?? 0 })), [...left]);
      if (bulk.filter) reloads.set(reloads.get() + 1);
      void lookAgain(stale);
      const action = undoing.has(key) ? undefined : { text: "Undo", run: () => steps.ofBulkAnswer(key) && undoStep(step) };
      offers.set(key, toasts.show(`${countOf(bulk.count - skipped.length - stale.length, "box", "boxes")} ${DONE[bulk.verdict]}`, { action }));
      report.set(leftOut(skipped, stale));
    },

    /** A bulk answer was discarded. @param {import("./outbox.js").BulkAnswer} bulk */
    givenUp({ key }) {
      const step = steps.ofBulkAnswer(key);
      if (step) steps.drop(step);
      undoing.delete(key);
    },

    /** One answer on these boxes, shown at once. @param {string} dataset @param {Answer} verdict @param {readonly number[]} boxIds @param {ReadonlyMap<number, number>} revisions  as the person saw them */
    answer: (dataset, verdict, boxIds, revisions) =>
      answerMany({ dataset, verdict, boxIds: [...boxIds], seen: boxIds.map((id) => revisions.get(id) ?? 0), count: boxIds.length }),

    /** One answer on all that a filter selected when the list was read. @param {string} dataset @param {Answer} verdict @param {import("./outbox.js").Filter} filter @param {{total: number, snapshot: string}} list */
    answerAll: (dataset, verdict, filter, { total, snapshot }) => answerMany({ dataset, verdict, filter, snapshot, count: total }),

    undo: undoStep,

    /** The undo of a bulk answer was stored. @param {import("./outbox.js").Undo} item @param {import("./outbox.js").UndoOut} out */
    undone({ act: key, boxIds, seen, before }, { undone: count, skipped }) {
      undoing.delete(key);
      stored((boxIds ?? []).map((boxId, i) => ({ boxId, verdict: "clear", comment: "", ...before[i], revision: seen?.[i] ?? 0 })), skipped);
      if (!boxIds) reloads.set(reloads.get() + 1);
      toasts.show(`${countOf(count, "answer")} undone`);
      report.set(skipped.length ? { text: `${countOf(skipped.length, "answer was", "answers were")} left as ${skipped.length === 1 ? "it is" : "they are"}: somebody has answered since.`, boxes: skipped } : null);
    },

    /** The undo of a bulk answer will never be stored. @param {import("./outbox.js").Undo} item @param {Error} error */
    undoRefused({ act: key, boxIds = [] }, error) {
      undoing.delete(key);
      toasts.show(`Not undone: ${error.message}`, { kind: "error" });
      void lookAgain(boxIds);
    },
  };
}

/** @typedef {ReturnType<typeof answerTo>} Earlier  an answer on a box */
/** @typedef {Earlier & {revision: number}} Given  `revision`: of the box, on which the answer was given */
/**
 * @typedef {object} Step
 * @property {readonly Earlier[]} before  the earlier answers on its boxes; none for a bulk answer on boxes that the page does not know
 * @property {string} dataset
 * @property {string} [bulkKey]  the key of a bulk answer, which is undone as a whole
 * @property {number | null} [batch]  the bulk answer's id on the server, once it is stored
 * @property {number} [count]  how many boxes the bulk answer was to answer
 */

const MOST_STEPS = 500;

/** What this person can undo, the newest last. Its boxes are held in the store. @param {Boxes} boxes */
export function createSteps(boxes) {
  /** @type {{step: Step, giveBack: () => void}[]} */
  const steps = [];

  /** @param {(step: Step) => boolean} isMeant */
  function remove(isMeant) {
    for (let i = steps.length - 1; i >= 0; i--) {
      const one = steps[i];
      if (!one || !isMeant(one.step)) continue;
      steps.splice(i, 1);
      one.giveBack();
    }
  }

  return {
    /** @param {Step} step */
    push(step) {
      steps.push({ step, giveBack: boxes.hold(step.before.map(({ boxId }) => boxId)) });
      if (steps.length > MOST_STEPS) steps.shift()?.giveBack();
    },

    /** The one to undo next. @returns {Step | null} */
    last: () => steps.at(-1)?.step ?? null,

    /** @param {string} key */
    ofBulkAnswer: (key) => steps.find(({ step }) => step.bulkKey === key)?.step ?? null,

    /** The boxes that later steps have answered. @param {Step} step */
    since: (step) => new Set(steps.slice(steps.findIndex((one) => one.step === step) + 1).flatMap((one) => one.step.before.map(({ boxId }) => boxId))),

    /** @param {Step} step */
    drop: (step) => remove((one) => one === step),

    /** Somebody else has answered the box: this person can no longer undo their own earlier answer. @param {number} boxId */
    forget: (boxId) => remove(({ bulkKey, before }) => bulkKey === undefined && before.some((one) => one.boxId === boxId)),
  };
}

/** @typedef {ReturnType<typeof createSteps>} Steps */
