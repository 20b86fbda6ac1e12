// @ts-check
// One session at the queue: supply, place, counts, pace; lives on while one looks elsewhere.

import { isUndecided, withAnswer } from "../boxes/box.js";
import { listedOf, selectionOf } from "../boxes/filters.js";
import { LOCAL, REMOTE, UNDO, createStore } from "../boxes/store.js";
import { REASONS } from "../boxes/wording.js";
import { ApiError, post, segment } from "../core/api.js";
import { createValue } from "../core/observable.js";
import { EMPTY, ahead, answered, compared, inHand, joined, takenBack } from "./line.js";

/** @typedef {import("../core/types.js").Answer} Answer */
/** @typedef {import("../review/answers.js").ReviewApp} App */
/** @typedef {import("../core/types.js").Decision} Decision */
/** @typedef {import("./line.js").Line} Line */
/** @typedef {import("../core/api.js").QueueOut} QueueOut */
/** @typedef {import("../core/api.js").QueueRequest} QueueRequest */

/**
 * @typedef {object} Counts
 * @property {number | null} left  boxes that nobody has answered, as the server last said, less those answered since
 * @property {number} unsure  that somebody was unsure about; they come last
 * @property {number} elsewhere  with other people at the moment
 */

/** @typedef {{state: "loading" | "ready" | "error", error: Error | null, isEnd: boolean}} Supply */

export const ORDERS = /** @type {const} */ ([
  { value: "doubt", text: "Doubtful", title: "Toss-ups and the smallest margins first" },
  { value: "random", text: "Random", title: "A fair sample" },
  { value: "class", text: "By class", title: "One class after the other" },
  { value: "audit", text: "Audit", title: "Look again at what people have answered" },
]);

/** Boxes that have a place in the image: the others cannot be looked at. */
const LOOKABLE = Object.keys(REASONS).filter((reason) => reason !== "outside_image" && reason !== "degenerate").join(",");

const BATCH = 12;
const REFILL_BELOW = 6;
const MOST_EXCLUDED = 1000;

/** @param {import("../core/router.js").Query} query */
export const orderOf = (query) => (ORDERS.some(({ value }) => value === query.order) ? (query.order ?? "") : "doubt");

/** @param {App} app @param {string} dataset @param {import("../core/router.js").Query} query */
export function createSitting(app, dataset, query) {
  const store = createStore([]);
  const line = createValue(EMPTY);
  const counts = createValue(/** @type {Counts} */ ({ left: null, unsure: 0, elsewhere: 0 }));
  const supply = createValue(/** @type {Supply} */ ({ state: "loading", error: null, isEnd: false }));
  const comparisons = createValue(/** @type {readonly import("./line.js").Comparison[]} */ ([]));
  /** Times of the answers, ms; what was answered. */
  const tally = createValue({ times: /** @type {number[]} */ ([]), verdicts: /** @type {ReadonlyMap<number, Answer>} */ (new Map()) });
  const order = orderOf(query);
  const listed = listedOf(query);
  let isAsking = false;
  store.observe((change) => (app.undo.notice(change), app.outbox.notice(change)));

  async function refill() {
    if (isAsking || supply.get().isEnd || ahead(line.get(), REFILL_BELOW).length >= REFILL_BELOW) return;
    await ask(BATCH);
  }

  /** @param {number} limit */
  async function ask(limit) {
    isAsking = true;
    supply.set({ ...supply.get(), state: "loading", error: null });
    const waiting = app.outbox.state.get().waiting;
    const exclude = [...new Set([...waiting, ...inHand(line.get(), MOST_EXCLUDED)])].slice(-MOST_EXCLUDED);
    try {
      const out = await (listed.length > 0
        ? listedBoxes(app.api, listed)
        : nextBoxes(dataset, { order, filters: { reason: LOOKABLE, ...selectionOf(query) }, limit, exclude }));
      store.add(out.items);
      line.set(joined(line.get(), out.items.map(({ box_id }) => box_id)));
      counts.set({ left: Math.max(0, out.remaining - unsent()), unsure: out.unsure, elsewhere: out.claimed_by_others });
      supply.set({ state: "ready", error: null, isEnd: out.items.length === 0 || listed.length > 0 });
    } catch (error) {
      app.notice(error);
      supply.set({ state: "error", error: error instanceof Error ? error : new Error(String(error)), isEnd: false });
    } finally {
      isAsking = false;
    }
  }

  /** Answers that the server did not have yet when it counted. */
  function unsent() {
    const { waiting } = app.outbox.state.get();
    return order === "audit" ? 0 : [...tally.get().verdicts.keys()].filter((id) => waiting.has(id)).length;
  }

  /** @param {number} by */
  function countDown(by) {
    const { left, ...rest } = counts.get();
    if (left !== null && order !== "audit") counts.set({ ...rest, left: Math.max(0, left + by) });
  }

  return {
    dataset,
    query,
    order,
    listed,
    store,
    line,
    counts,
    supply,
    comparisons,
    tally,
    refill,

    /** @param {Line} next */
    show(next) {
      line.set(next);
      void refill();
    },

    /** @param {Decision} box @param {Answer} verdict @param {string} comment @param {boolean} isBlindly */
    answer(box, verdict, comment, isBlindly) {
      app.settle(box.box_id);
      const comparison = isBlindly ? compared(box, verdict) : null;
      if (comparison) comparisons.set([...comparisons.get(), comparison]);
      const isFirst = !tally.get().verdicts.has(box.box_id);
      tally.set({ times: [...tally.get().times, Date.now()], verdicts: new Map([...tally.get().verdicts, [box.box_id, verdict]]) });
      if (isFirst) countDown(-1);
      store.apply(withAnswer(box, verdict, comment), LOCAL);
      this.show(answered(line.get(), box.box_id));
    },

    /** A comment alone leaves one where one is. @param {Decision} box @param {Answer} verdict @param {string} comment */
    comment: (box, verdict, comment) => store.apply(withAnswer(box, verdict, comment), LOCAL),

    /** @param {import("../review/answers.js").UndoStep} step @returns {Promise<Decision | null>} */
    async takeBack(step) {
      if (!store.get(step.boxId)) store.add([await app.api.box(step.boxId)]);
      const box = store.get(step.boxId);
      if (!box) return null;
      app.undo.take();
      comparisons.set(comparisons.get().filter(({ boxId }) => boxId !== step.boxId));
      const verdicts = new Map(tally.get().verdicts);
      if (verdicts.delete(step.boxId)) countDown(1);
      tally.set({ times: tally.get().times.slice(0, -1), verdicts });
      const after = withAnswer(box, step.verdict, step.comment);
      store.apply(after, UNDO);
      line.set(takenBack(line.get(), step.boxId));
      return after;
    },

    /** Look again what there is: others may have let go of theirs. */
    lookAgain() {
      supply.set({ ...supply.get(), isEnd: false });
      void refill();
    },

    /** Keep the claims on what is in hand. */
    renew: () => (isAsking || supply.get().isEnd ? Promise.resolve() : ask(1)),

    /** What this browser has answered and the server does not know yet. */
    showWaiting() {
      for (const id of line.get().ids) {
        const box = store.get(id);
        const item = box && app.outbox.waitingFor(box.frame_id).find(({ boxId }) => boxId === id);
        if (box && item) store.apply(withAnswer(box, item.verdict, item.comment), REMOTE);
      }
    },
  };
}

/** @typedef {ReturnType<typeof createSitting>} Sitting */

/** @type {WeakMap<App, {key: string, sitting: Sitting, seen: number}>} */
const sittings = new WeakMap();

/** After so long, claims are gone and others have answered. */
const PAUSE_MS = 5 * 60_000;

/** The sitting of these filters, gone on with if one was away for a moment. @param {App} app @param {string} dataset @param {import("../core/router.js").Query} query */
export function sittingOf(app, dataset, query) {
  const key = JSON.stringify([dataset, orderOf(query), selectionOf(query), listedOf(query)]);
  const last = sittings.get(app);
  if (last?.key === key && Date.now() - last.seen < PAUSE_MS) return last.sitting;
  const sitting = createSitting(app, dataset, query);
  sittings.set(app, { key, sitting, seen: Date.now() });
  return sitting;
}

/** @param {App} app */
export function touch(app) {
  const last = sittings.get(app);
  if (last) last.seen = Date.now();
}

/** @param {string} dataset @param {QueueRequest} wanted @returns {Promise<QueueOut>} */
export const nextBoxes = (dataset, wanted) => post(`/datasets/${segment(dataset)}/queue`, wanted);

/** Boxes by their ids, claimed for nobody; those that are gone are left out. @param {typeof import("../core/api.js").api} api @param {readonly number[]} ids */
export async function listedBoxes(api, ids) {
  const found = await Promise.all(ids.map((id) => api.box(id).catch(ignoreMissing)));
  const items = found.filter((box) => box !== null);
  return { items, remaining: items.filter(isUndecided).length, unsure: 0, claimed_by_others: 0 };
}

/** @param {unknown} error */
function ignoreMissing(error) {
  if (error instanceof ApiError && error.status === 404) return null;
  throw error;
}
