// @ts-check
// All changes of answers go through here: answer one box or many, undo, replace somebody else's answer, discard.

import { answerTo, seenRevision, withAnswer, withStored } from "../boxes/box.js";
import { ApiError, get, post } from "../core/api.js";
import { countOf } from "../core/numbers.js";
import { createValue } from "../core/observable.js";
import { createOutbox, createSender, own, sendBulk, undoBulk, unowned } from "./outbox.js";

/** @typedef {import("../boxes/box.js").Answer} Answer */
/** @typedef {import("../boxes/store.js").Boxes} Boxes */
/** @typedef {import("../boxes/box.js").Decision} Decision */
/** @typedef {import("./outbox.js").QueuedAnswer} QueuedAnswer */
/** @typedef {{text: string, boxes: readonly number[]}} Report  boxes that an act or an undo left alone */

/** Why an undo is refused for good. */
const NEVER_UNDONE = new Set(["already_undone", "others_answers"]);

/** Of more boxes than these, the lists are read again instead. */
const MOST_LOOKS = 20;

/** @type {Record<Answer, string>} */
const DONE = { keep: "kept", reject: "rejected", unsure: "flagged as unsure", clear: "without an answer again" };

/**
 * Answers, for the whole page: giving and undoing them, those not saved yet, and conflicts.
 * @param {import("../core/app.js").App} app @param {Boxes} boxes @param {Storage} storage
 * @param {{tab: string, openTabs: ReadonlySet<string>}} tabs  this one, and all that are open: another one sends its answers itself
 */
export function createAnswers(app, boxes, storage, { tab, openTabs }) {
  const { toasts } = app;
  const outbox = createOutbox(storage, tab, app.owner);
  const steps = createSteps(boxes);
  /** The boxes that were answered last are held in the store, so that an older answer of the server, still on its way, does not replace them. @type {(() => void)[]} */
  const answered = [];

  /** @param {readonly number[]} ids */
  function remember(ids) {
    answered.push(boxes.hold(ids));
    if (answered.length > DEPTH) answered.shift()?.();
  }
  /** The frame whose answers the server has stored last, so that a frame fetched before is not used; `id` is null after an act on many boxes. */
  const changedFrame = createValue(/** @type {{id: number | null}} */ ({ id: null }));
  /** Answers that were not saved because somebody else had answered first. */
  const conflicts = createValue(/** @type {ReadonlyMap<number, QueuedAnswer>} */ (new Map()));

  /** Load boxes again that others have answered. @param {readonly number[]} boxIds */
  async function lookAgain(boxIds) {
    if (boxIds.length > MOST_LOOKS) return acts.reloads.set(acts.reloads.get() + 1);
    for (const id of boxIds) {
      const box = await get("/api/v1/boxes/{box_id}", { path: { box_id: id } }).catch(() => null);
      if (box) boxes.receive([box]);
    }
  }

  const acts = createActs({ boxes, changedFrame, toasts, steps, remember, lookAgain, start: (act, key) => sender.start(act, key) });
  const sender = createSender(outbox, { answer: (boxId, body, key) => post("/api/v1/boxes/{box_id}/reviews", { path: { box_id: boxId }, body, key }), act: sendBulk }, {
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
    onDone: acts.done,
    onGivenUp: acts.givenUp,
    onSignedOut: app.endSession,
  });
  // The state changes with every change of the outbox.
  sender.state.observe(() => boxes.layOver(outbox.given()));
  sender.adopt(openTabs);

  /** Send answers that are not saved yet. */
  function resume() {
    sender.adopt(openTabs);
    void sender.resume();
  }
  app.isSignedIn.observe((isIn) => isIn && (offerUnowned(), resume()));
  addEventListener("online", resume);

  /** Offer to send answers of an earlier version of the page, which did not store who gave them. */
  function offerUnowned() {
    const count = unowned(storage).length;
    const name = app.owner();
    if (count === 0 || !name) return;
    toasts.show(`${countOf(count, "unsent answer")} in this browser ${count === 1 ? "does" : "do"} not say who gave ${count === 1 ? "it" : "them"}.`, {
      action: { text: `Send as ${name}`, run: () => (own(storage, name), app.startAnew()) },
    });
  }

  /** @param {number} boxId */
  function closeConflict(boxId) {
    if (!conflicts.get().has(boxId)) return;
    const rest = new Map(conflicts.get());
    rest.delete(boxId);
    conflicts.set(rest);
  }

  /** @param {Decision} box @param {Answer} verdict @param {string} comment */
  function give(box, verdict, comment) {
    closeConflict(box.box_id);
    remember([box.box_id]);
    sender.answer({ boxId: box.box_id, frameId: box.frame_id, verdict, comment, seenRevision: seenRevision(box) });
  }

  /** An answer on one box, shown at once and sent when that is possible. @param {number} boxId @param {Answer} verdict @param {string} [comment] */
  function answer(boxId, verdict, comment = "") {
    const box = boxes.get(boxId);
    if (!box) return;
    steps.push({ before: [answerTo(box)] });
    give(box, verdict, comment);
  }

  return {
    boxes,
    changedFrame,
    sender,
    acts,
    conflicts,
    answer,
    offerUnowned,
    resume,
    /** How many answers of each person wait in this browser. */
    kept: outbox.kept,
    /** A conflict that the person has seen. */
    closeConflict,

    /** Replace somebody else's answer with one that was not saved because of it. @param {QueuedAnswer} item */
    insist: ({ boxId, verdict, comment }) => answer(boxId, verdict, comment),

    /** Undo what this person did last. @param {(box: Decision) => void} show  the box whose answer it was; not called for an act on many boxes */
    undo(show) {
      const last = steps.last();
      if (!last) return void toasts.show("Nothing to undo.");
      if (last.batchId) return void acts.undo(last.batchId);
      const [{ boxId, verdict, comment } = { boxId: 0, verdict: /** @type {Answer} */ ("clear"), comment: "" }] = last.before;
      const box = boxes.get(boxId);
      steps.drop(last);
      if (!box) return;
      give(box, verdict, comment);
      show(boxes.get(boxId) ?? box);
      app.announcement.set(`${box.class} ${box.id}: answer undone`);
    },
  };
}

/** @typedef {import("../core/app.js").App & ReturnType<typeof createAnswers>} ReviewApp  what views are given in which people answer */

/**
 * Answers on many boxes ("acts"): shown at once, reported when they are stored, undone as a whole.
 * @param {{boxes: Boxes, changedFrame: import("../core/observable.js").Value<{id: number | null}>, toasts: import("../core/app.js").App["toasts"], steps: Steps,
 *   remember: (boxIds: readonly number[]) => void, lookAgain: (boxIds: readonly number[]) => Promise<void>,
 *   start: (act: import("./outbox.js").WantedAct, key: string) => void}} page
 */
function createActs({ boxes, changedFrame, toasts, steps, remember, lookAgain, start }) {
  /** The earlier answers on the boxes of each act that is not stored yet. @type {Map<string, readonly Given[]>} */
  const before = new Map();
  /** The messages that offer to undo an act, by its batch. @type {Map<number, number>} */
  const offers = new Map();
  const report = createValue(/** @type {Report | null} */ (null));
  /** Increases when an act on all boxes of a filter was stored or undone, so that lists are read again. */
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
        return box ? [withAnswer(box, verdict, comment, (revision ?? seenRevision(box)) + 1)] : [];
      }),
    );
  }

  /** @param {Step} step @returns {Promise<void>} */
  async function takeBack(step) {
    const { batchId = 0 } = step;
    try {
      undone(step, await undoBulk(batchId));
      steps.drop(step);
    } catch (error) {
      if (!(error instanceof ApiError)) return void toasts.show("Not undone: the server could not be reached.", { kind: "error" });
      if (NEVER_UNDONE.has(error.problem.code ?? "")) steps.drop(step);
      toasts.show(error.message, { kind: "error" });
    }
  }

  /** @param {Step} step @param {import("./outbox.js").UndoOut} out */
  function undone({ batchId = 0, before: given }, { undone: count, skipped }) {
    toasts.dismiss(offers.get(batchId) ?? 0);
    stored(given, skipped);
    changedFrame.set({ id: null });
    if (given.length === 0) reloads.set(reloads.get() + 1);
    toasts.show(`${countOf(count, "answer")} undone`);
    report.set(skipped.length ? { text: `${countOf(skipped.length, "answer was", "answers were")} left as ${skipped.length === 1 ? "it is" : "they are"}: somebody has answered since.`, boxes: skipped } : null);
  }

  return {
    report,
    reloads,

    /** An act was stored. @param {import("./outbox.js").DoneAct} done */
    done({ batchId, act, skipped, stale }) {
      changedFrame.set({ id: null });
      const left = new Set([...stale, ...skipped]);
      const step = { batchId, before: (before.get(act.key) ?? []).filter(({ boxId }) => !left.has(boxId)) };
      before.delete(act.key);
      steps.push(step);
      stored((act.boxIds ?? []).map((boxId, i) => ({ boxId, verdict: act.verdict, comment: "", revision: act.seen?.[i] ?? 0 })), [...left]);
      if (act.filter) reloads.set(reloads.get() + 1);
      void lookAgain(stale);
      const toast = toasts.show(`${countOf(act.count - skipped.length - stale.length, "box", "boxes")} ${DONE[act.verdict]}`, {
        action: { text: "Undo", run: () => void takeBack(step) },
      });
      offers.set(batchId, toast);
      report.set(leftOut(skipped, stale));
    },

    /** An act was discarded. @param {import("./outbox.js").Act} act */
    givenUp: (act) => void before.delete(act.key),

    /** One answer on these boxes, shown at once. @param {string} dataset @param {Answer} verdict @param {readonly number[]} boxIds @param {ReadonlyMap<number, number>} revisions  as the person saw them */
    answer(dataset, verdict, boxIds, revisions) {
      const key = crypto.randomUUID();
      before.set(key, boxes.all(boxIds).map(answerTo));
      start({ dataset, verdict, boxIds: [...boxIds], seen: boxIds.map((id) => revisions.get(id) ?? 0), count: boxIds.length }, key);
    },

    /** One answer on all that a filter selected when the list was read. @param {string} dataset @param {Answer} verdict @param {import("./outbox.js").Filter} filter @param {{total: number, snapshot: string}} list */
    answerAll: (dataset, verdict, filter, { total, snapshot }) => start({ dataset, verdict, filter, snapshot, count: total }, crypto.randomUUID()),

    /** Undo a whole act. @param {number} batchId */
    async undo(batchId) {
      const step = steps.ofBatch(batchId);
      if (step) await takeBack(step);
    },
  };
}

/** @typedef {{boxId: number, verdict: Answer, comment: string, revision?: number}} Given  an answer; `revision`: the one it was given on, if the box may have a newer one by now */
/** @typedef {{before: readonly Given[], batchId?: number}} Step  the earlier answers on some boxes; `batchId`: of an act on many boxes, which is undone as a whole */

const DEPTH = 500;

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
      if (steps.length > DEPTH) steps.shift()?.giveBack();
    },

    /** The one to undo next. @returns {Step | null} */
    last: () => steps.at(-1)?.step ?? null,

    /** @param {number} batchId */
    ofBatch: (batchId) => steps.find(({ step }) => step.batchId === batchId)?.step ?? null,

    /** @param {Step} step */
    drop: (step) => remove((one) => one === step),

    /** Somebody else has answered the box: this person can no longer undo their own earlier answer. @param {number} boxId */
    forget: (boxId) => remove(({ batchId, before }) => batchId === undefined && before.some((one) => one.boxId === boxId)),
  };
}

/** @typedef {ReturnType<typeof createSteps>} Steps */
