// @ts-check
// A review session in the queue: its boxes, position, counts and pace. It is kept for a while when another view is
// opened.

import { answerOf, isUnanswered, seenRevision } from "../boxes/box.js";
import { listedOf, selectionOf } from "../boxes/filters.js";
import { REASONS } from "../boxes/wording.js";
import { ApiError, get, post } from "../core/api.js";
import { createValue } from "../core/observable.js";
import {
  EMPTY,
  afterAnswer,
  afterUndo,
  answeredHere,
  compared,
  currentOf,
  extended,
  lookedAt,
  movedTo,
  nextOpen,
  upcoming,
  without,
} from "./line.js";

/** @import { Answer, Decision } from "../boxes/box.js" */
/** @import { Queue } from "../core/openapi.js" */
/** @import { Query } from "../core/router.js" */
/** @import { ReviewApp as App } from "../review/answers.js" */
/** @import { Line } from "./line.js" */

/**
 * @typedef {object} Counts
 * @property {number | null} left  boxes without an answer: the server's last count, minus those answered since
 * @property {number} unsure  boxes that somebody was unsure about; they come last
 * @property {number} elsewhere  boxes that other people are reviewing at the moment
 */

/** @typedef {{state: "loading" | "ready" | "error", error: Error | null, isEnd: boolean}} Supply */

export const ORDERS = /** @type {const} */ ([
  {
    value: "doubt",
    text: "Doubtful",
    title: "Where an answer is worth most: the filter is likely wrong, and an eye can decide",
  },
  { value: "random", text: "Random", title: "A fair sample: how good the filter is can be told from these alone" },
  { value: "class", text: "By class", title: "One class after the other" },
  { value: "audit", text: "Audit", title: "Look again at what others have answered" },
]);

/** All reasons except those of boxes outside the image or without an area, which nobody can judge by eye. */
const LOOKABLE = Object.keys(REASONS)
  .filter((reason) => reason !== "outside_image" && reason !== "degenerate")
  .join(",");

/**
 * Whether the queue has only the boxes to review, as long as no filter says otherwise. A random sample and an audit
 * have all that can be seen.
 * @param {Query} query
 */
export function hasOnlyDoubts(query) {
  const order = orderOf(query);
  return (order === "doubt" || order === "class") && !query.bin && !query.review && query.conflict !== "true";
}

/**
 * @typedef {object} Past  what a person has done in a session
 * @property {Line} line  the boxes looked at
 * @property {readonly import("./line.js").Comparison[]} comparisons
 * @property {{times: readonly number[], verdicts: ReadonlyMap<number, Answer>}} tally the times of the answers (ms),
 *   and
 *   the answers by box
 * @property {readonly {boxId: number, isComment: boolean}[]} entries  the answers and comments, in their order
 * @property {readonly number[]} lesson  the boxes whose truth is told
 */

/** @type {Past} */
const NO_PAST = Object.freeze({
  line: EMPTY,
  comparisons: [],
  tally: { times: [], verdicts: new Map() },
  entries: [],
  lesson: [],
});

const BATCH = 12;
const REFILL_BELOW = 6;
const MOST_EXCLUDED = 1000;

/** @param {Query} query */
export const orderOf = (query) => ORDERS.find(({ value }) => value === query.order)?.value ?? "doubt";

/**
 * @param {App} app @param {string} dataset @param {Query} query
 * @param {Past} [past]  of the session that this one continues
 */
function createQueueSession(app, dataset, query, past = NO_PAST) {
  const { boxes } = app;
  /** The functions that release the boxes of this session in the store. @type {(() => void)[]} */
  const releases = [boxes.hold(past.line.ids)];
  const line = createValue(past.line);
  const counts = createValue(/** @type {Counts} */ ({ left: null, unsure: 0, elsewhere: 0 }));
  const supply = createValue(/** @type {Supply} */ ({ state: "loading", error: null, isEnd: false }));
  const comparisons = createValue(past.comparisons);
  const tally = createValue(past.tally);
  const order = orderOf(query);
  const listed = listedOf(query);
  const entries = [...past.entries];
  const lesson = createValue(past.lesson);
  let isAsking = false;

  async function refill() {
    if (isAsking || supply.get().isEnd || upcoming(line.get(), REFILL_BELOW).length >= REFILL_BELOW) return;
    await ask(BATCH);
  }

  /**
   * The boxes that the server is asked not to send: those of the line. There is room for `MOST_EXCLUDED`, so first go
   * those that would not be sent anyway, because their answer is stored.
   * @param {ReadonlySet<number>} waiting  boxes with an answer that is not stored yet
   */
  function toExclude(waiting) {
    const { verdicts } = tally.get();
    const { review, conflict } = selectionOf(query);
    const keepsAnswered = order !== "audit" && (review !== undefined || conflict !== undefined);
    const isGone = (/** @type {number} */ id) =>
      !keepsAnswered && !waiting.has(id) && ["keep", "reject"].includes(verdicts.get(id) ?? "");
    const { ids } = line.get();
    return [...new Set([...ids.filter(isGone), ...ids.filter((id) => !isGone(id)), ...waiting])].slice(-MOST_EXCLUDED);
  }

  /** @param {number} limit */
  async function ask(limit) {
    isAsking = true;
    supply.set({ ...supply.get(), state: "loading", error: null });
    const { waiting: single, waitingInBulk } = app.sender.state.get();
    const waiting = new Set([...single, ...[...tally.get().verdicts.keys()].filter((id) => waitingInBulk.has(id))]);
    const before = new Set([...tally.get().verdicts.keys()].filter((id) => !waiting.has(id)));
    const exclude = toExclude(waiting);
    const filters = {
      ...(hasOnlyDoubts(query) ? { bin: /** @type {const} */ ("ask") } : { reason: LOOKABLE }),
      ...selectionOf(query),
    };
    const fromQueue = () =>
      post("/api/v1/datasets/{dataset}/queue", { path: { dataset }, body: { order, filters, limit, exclude } });
    const coming = listed.length > 0 ? listedBoxes(listed) : fromQueue();
    await Promise.all([coming, lessonOf()]).then(
      ([out, taught]) => receive(out, before, taught),
      (error) => supply.set({ state: "error", error, isEnd: false }),
    );
    isAsking = false;
  }

  /**
   * The boxes of the lesson, when the queue begins; none if this person has had it.
   * @returns {Promise<readonly Decision[]>}
   */
  async function lessonOf() {
    const isStart = line.get().ids.length === 0 && lesson.get().length === 0;
    if (!isStart || order !== "doubt" || listed.length > 0 || !hasOnlyDoubts(query) || !app.prefs.get().lessons)
      return [];
    return get("/api/v1/datasets/{dataset}/coached", { path: { dataset } }).then(
      ({ items }) => items,
      () => [],
    );
  }

  /**
   * @param {Pick<Queue, "remaining" | "unsure" | "claimed_by_others"> & {items: readonly Decision[]}} out
   * @param {ReadonlySet<number>} before  boxes whose answers were stored before this was requested
   * @param {readonly Decision[]} taught  the boxes of the lesson
   */
  function receive({ items, remaining, unsure, claimed_by_others: elsewhere }, before, taught) {
    const known = line.get().ids.length;
    if (taught.length > 0) {
      lesson.set(take(taught));
      line.set(
        extended(
          line.get(),
          taught.filter((box) => !isTold(box)).map(({ box_id }) => box_id),
        ),
      );
    }
    line.set(extended(line.get(), take(items)));
    // The server's counts may have boxes that were answered after the request, or not. What the page has counted itself
    // is kept if it lies within these limits.
    const later = [...tally.get().verdicts].filter(([id]) => !before.has(id));
    const flagged = later.filter(([, verdict]) => verdict === "unsure").length;
    const mine = counts.get();
    counts.set({
      left: within(mine.left ?? 0, remaining - later.length, remaining),
      unsure: within(mine.unsure, unsure - (later.length - flagged), unsure + flagged),
      elsewhere,
    });
    const hasNew = line.get().ids.length > known;
    supply.set({ state: "ready", error: null, isEnd: !hasNew || listed.length > 0 });
  }

  /**
   * Keep these boxes in the store as long as the session lasts.
   * @param {readonly Decision[]} items @returns {number[]} their ids
   */
  function take(items) {
    const ids = boxes.receive(items);
    releases.push(boxes.hold(ids));
    return ids;
  }

  /** The answer that counts: in an audit, the person's own of this session. @param {Decision} box */
  const counted = (box) => (order === "audit" ? (tally.get().verdicts.get(box.box_id) ?? null) : answerOf(box));

  /**
   * Count a box that had one answer and has another now; null: none.
   * @param {Answer | null} from @param {Answer | null} to
   */
  function recount(from, to) {
    const { left, unsure, ...rest } = counts.get();
    if (left === null) return;
    /** @param {Answer | null} answer */
    const moved = (answer) => Number(to === answer) - Number(from === answer);
    const flagged = order === "audit" ? 0 : moved("unsure");
    counts.set({ ...rest, left: Math.max(0, left + moved(null)), unsure: Math.max(0, unsure + flagged) });
  }

  /** Whether this person has answered a box of the lesson. @param {Decision} box */
  const isTold = (box) =>
    tally.get().verdicts.has(box.box_id) || (answerOf(box) !== null && box.review?.reviewer === app.owner());

  /** Whether the counts of this queue are of boxes like this one. @param {Decision} box */
  const isCounted = (box) => !hasOnlyDoubts(query) || box.bin === "ask";

  return {
    dataset,
    query,
    order,
    listed,
    line,
    counts,
    supply,
    comparisons,
    tally,
    lesson,
    isTold,
    refill,

    /** @param {Line} next */
    show(next) {
      line.set(next);
      void refill();
    },

    /** Show a box, which need not be of the queue, before the others. @param {number} id */
    async showBox(id) {
      if (!line.get().ids.includes(id)) take([await boxOf(id)]);
      const { ids, at } = line.get();
      line.set(movedTo(ids.includes(id) ? line.get() : { ...line.get(), ids: ids.toSpliced(at, 0, id) }, id));
    },

    /**
     * Answer the current box, and go on to the next; a box of the lesson stays on show.
     * @param {Decision} box @param {Answer} verdict @param {string} comment
     * @param {{lookedMs: number | null, isBlindly: boolean}} look `isBlindly`: the person did not see the filter's
     *   verdict
     * @returns {boolean} false: there is no room for it
     */
    answer(box, verdict, comment, { lookedMs, isBlindly }) {
      const comparison = isBlindly ? compared(box, verdict) : null;
      const before = counted(box);
      if (!app.answer(box.box_id, verdict, comment, lookedMs)) return false;
      entries.push({ boxId: box.box_id, isComment: false });
      if (comparison) comparisons.set([...comparisons.get(), comparison]);
      const { times, verdicts } = tally.get();
      tally.set({ times: [...times, Date.now()], verdicts: new Map([...verdicts, [box.box_id, verdict]]) });
      if (isCounted(box)) recount(before, verdict);
      const isTaught = lesson.get().includes(box.box_id);
      this.show(isTaught ? answeredHere(line.get(), box.box_id) : afterAnswer(line.get(), box.box_id));
      return true;
    },

    /** Go on without the lesson, also the next time. */
    skipLesson() {
      app.prefs.change({ lessons: false });
      this.show(without(line.get(), lesson.get()));
      lesson.set([]);
    },

    /**
     * The answer that was given last in this session, of those in force.
     * @returns {{boxId: number, verdict: Answer} | null}
     */
    lastAnswer() {
      const [boxId, verdict] = [...tally.get().verdicts].at(-1) ?? [];
      return boxId && verdict ? { boxId, verdict } : null;
    },

    /**
     * Give many boxes the same answer, which one undo takes back.
     * @param {readonly Decision[]} chosen @param {Answer} verdict
     * @returns {boolean} false: there is no room for it
     */
    answerMany(chosen, verdict) {
      const ids = take(chosen);
      const before = boxes.all(ids);
      const revisions = new Map(before.map((box) => [box.box_id, seenRevision(box)]));
      if (!app.bulkAnswers.answer(dataset, verdict, ids, revisions)) return false;
      const { times, verdicts } = tally.get();
      for (const box of before) if (isCounted(box)) recount(counted(box), verdict);
      tally.set({ times, verdicts: new Map([...verdicts, ...ids.map((id) => /** @type {const} */ ([id, verdict]))]) });
      const done = { ...line.get(), answered: new Set([...line.get().answered, ...ids]) };
      this.show(ids.includes(currentOf(done) ?? 0) ? nextOpen(done) : done);
      return true;
    },

    /** The answer on many boxes was undone. @param {readonly number[]} ids */
    manyUndone(ids) {
      const verdicts = new Map(tally.get().verdicts);
      for (const id of ids) {
        const given = verdicts.get(id);
        const box = boxes.get(id);
        if (given && verdicts.delete(id) && box && isCounted(box)) recount(given, counted(box));
      }
      tally.set({ ...tally.get(), verdicts });
      const gone = new Set(ids);
      const back = line.get().ids.find((id) => gone.has(id));
      const next = { ...line.get(), answered: new Set([...line.get().answered].filter((id) => !gone.has(id))) };
      line.set(back === undefined ? next : movedTo(next, back));
    },

    /**
     * Save a comment without going on to the next box.
     * @param {Decision} box @param {Answer} verdict @param {string} comment
     * @returns {boolean} false: there is no room for it
     */
    comment(box, verdict, comment) {
      const isGiven = app.answer(box.box_id, verdict, comment);
      if (isGiven) entries.push({ boxId: box.box_id, isComment: true });
      return isGiven;
    },

    /** The last answer on a box was undone: the box is current again. @param {Decision} box */
    answerUndone(box) {
      const { box_id: id } = box;
      const at = entries.findLastIndex(({ boxId }) => boxId === id);
      const [undone] = at < 0 ? [] : entries.splice(at, 1);
      const before = entries.some(({ boxId }) => boxId === id) ? answerOf(box) : null;
      releases.push(boxes.hold([id]));
      comparisons.set(comparisons.get().filter(({ boxId }) => boxId !== id));
      const verdicts = new Map(tally.get().verdicts);
      const given = verdicts.get(id);
      verdicts.delete(id);
      if (given && before) verdicts.set(id, before);
      tally.set({ times: tally.get().times.slice(0, undone?.isComment ? undefined : -1), verdicts });
      if (given && isCounted(box)) recount(given, counted(box));
      line.set(afterUndo(line.get(), id));
    },

    /** Ask for boxes again: others may have released theirs. */
    lookAgain() {
      supply.set({ ...supply.get(), isEnd: false });
      void refill();
    },

    /** Renew the claims on the boxes of this session. */
    async renew() {
      const { ids, answered: done } = line.get();
      if (!isAsking && listed.length === 0 && ids.some((id) => !done.has(id))) await ask(1);
    },

    /** What the person has done: with it, another session can continue this one. @returns {Past} */
    past: () => ({
      line: lookedAt(line.get()),
      comparisons: comparisons.get(),
      tally: tally.get(),
      entries,
      lesson: lesson.get(),
    }),

    /** Release the boxes of this session. */
    end: () => releases.splice(0).forEach((release) => release()),
  };
}

/** @typedef {ReturnType<typeof createQueueSession>} Session */

/**
 * `shownAt`: when it was last shown (ms); Infinity while it is. `run`: the active run of the dataset; undefined until
 * it is known.
 * @type {WeakMap<App, {key: string, session: Session, shownAt: number, run: number | null | undefined}>}
 */
const sessions = new WeakMap();

/** After such a pause the claims have expired, and others may have answered: a new session begins. */
const PAUSE_MS = 5 * 60_000;

/**
 * The session of these filters. The last one is continued after a short pause. If another run has become active since,
 * only what the person has done is continued, and boxes are loaded anew.
 * @param {App} app @param {string} dataset @param {Query} query
 * @param {number | null} [run]  the active run; undefined while it is not known
 * @returns {{session: Session, isChecked: boolean}} `isChecked`: no other run is active than in its boxes, as far as it
 *   was known
 */
export function sessionOf(app, dataset, query, run) {
  const key = JSON.stringify([dataset, orderOf(query), selectionOf(query), listedOf(query)]);
  const last = sessions.get(app);
  const isSame = last?.key === key && Date.now() - last.shownAt < PAUSE_MS;
  if (isSame && (run === undefined || last.run === undefined || last.run === run)) {
    const isChecked = run !== undefined || last.run === undefined;
    last.run ??= run;
    return { session: last.session, isChecked };
  }
  const past = isSame ? last.session.past() : NO_PAST;
  const session = createQueueSession(app, dataset, query, past);
  last?.session.end();
  void app.boxes.loadAgain([...past.line.ids].reverse());
  sessions.set(app, { key, session, run, shownAt: Date.now() });
  return { session, isChecked: true };
}

/**
 * Keep the session for as long as it is shown, and for a while from when it is left.
 * @param {App} app @param {"shown" | "left"} now
 */
export function keepSession(app, now) {
  const last = sessions.get(app);
  if (last) last.shownAt = now === "shown" ? Infinity : Date.now();
}

/**
 * The number, or the limit that is nearest to it; none is below 0.
 * @param {number} number @param {number} least @param {number} most
 */
const within = (number, least, most) => Math.min(Math.max(number, least, 0), Math.max(most, 0));

/** @param {number} id */
const boxOf = (id) => get("/api/v1/boxes/{box_id}", { path: { box_id: id } });

/**
 * Boxes by their ids, without claiming them; those that no longer exist are left out.
 * @param {readonly number[]} ids
 */
async function listedBoxes(ids) {
  const found = await Promise.all(ids.map((id) => boxOf(id).catch(ignoreMissing)));
  const items = found.filter((box) => box !== null);
  return { items, remaining: items.filter(isUnanswered).length, unsure: 0, claimed_by_others: 0 };
}

/** @param {unknown} error */
function ignoreMissing(error) {
  if (error instanceof ApiError && error.status === 404) return null;
  throw error;
}
