// @ts-check
// All boxes that the page shows, each stored once: as the server last sent it, combined with answers not saved yet.

import { ApiError, createRetries, get } from "../core/api.js";
import { useValue } from "../core/hooks.js";
import { useEffect, useMemo, useState } from "../core/html.js";
import { createValue } from "../core/observable.js";
import { asShown, seenRevision, withAnswer } from "./box.js";

/** @import { Later } from "../core/api.js" */
/** @import { App } from "../core/app.js" */
/** @import { AnswerWithComment, Decision } from "./box.js" */

/**
 * If more boxes than this have changed at the server, the grid reads its lists again, and frames are not loaded for it.
 */
const MOST_LOADED = 20;

/** For how many answers the boxes are held. */
const MOST_ANSWERED = 500;

/** Of how many boxes that are not in the store the answers are kept. */
const MOST_EARLY = 10_000;

/**
 * @typedef {object} StoredAnswer  an answer that the server has stored
 * @property {number} revision  of its box, now
 * @property {(box: Decision) => Decision} applyTo  returns the box with the answer
 */

/**
 * One store for the whole page. A box stays in memory as long as its id is held, to show it, or remembered.
 * Of two versions of a box the higher revision wins; with equal revisions, the one received later.
 * @param {Later} [later]
 */
export function createBoxes(later) {
  /** Boxes as the server last sent them. @type {Map<number, Decision>} */
  const stored = new Map();
  /** Answers that the server has not stored yet. @type {ReadonlyMap<number, AnswerWithComment>} */
  let unconfirmed = new Map();
  /** Answers that another tab has sent, shown until their boxes have come. @type {Map<number, AnswerWithComment>} */
  const sentElsewhere = new Map();
  /**
   * Stored answers on boxes that were not in the store then. A list that was requested before may bring such a box
   * without its answer.
   * @type {Map<number, StoredAnswer>}
   */
  const early = new Map();
  /** All combined, made on request: the same object until something changes. @type {Map<number, Decision>} */
  const combined = new Map();
  /** How often an id is held. @type {Map<number, number>} */
  const held = new Map();
  /** How often an id is remembered. @type {Map<number, number>} */
  const remembered = new Map();
  /** The functions that release the boxes of `keepRevisions`, the oldest first. @type {(() => void)[]} */
  const releases = [];
  /** Increases when lists of boxes have to be read again. */
  const reloads = createValue(0);
  const reload = () => reloads.set(reloads.get() + 1);
  /** @type {Set<(changed: ReadonlySet<number>) => void>} */
  const observers = new Set();

  /** @param {ReadonlySet<number>} changed */
  function tell(changed) {
    for (const id of changed) combined.delete(id);
    // A copy: an observer may stop observing while it is notified.
    if (changed.size > 0) [...observers].forEach((notify) => notify(changed));
  }

  /** The box including the person's own answer. @param {number} id */
  function getBox(id) {
    const known = combined.get(id);
    if (known) return known;
    const box = stored.get(id);
    if (!box) return undefined;
    const answer = unconfirmed.get(id) ?? sentElsewhere.get(id);
    const now = answer ? Object.freeze(withAnswer(box, answer.verdict, answer.comment)) : box;
    combined.set(id, now);
    return now;
  }

  /**
   * Add boxes that the server sent. Hold their ids to keep them in the store.
   * @param {readonly Decision[]} boxes @returns {number[]} their ids
   */
  function receive(boxes) {
    /** @type {Set<number>} */
    const changed = new Set();
    for (const sent of boxes) {
      const answer = early.get(sent.box_id);
      const box = answer && seenRevision(sent) < answer.revision ? answer.applyTo(sent) : sent;
      const known = stored.get(box.box_id);
      if (known && (seenRevision(known) > seenRevision(box) || isSame(known, box))) continue;
      stored.set(box.box_id, Object.freeze(box));
      sentElsewhere.delete(box.box_id);
      if (known) changed.add(box.box_id);
    }
    tell(changed);
    return boxes.map(({ box_id }) => box_id);
  }

  /**
   * Keep boxes in the store until they are released.
   * @param {Map<number, number>} counts  `held` or `remembered` @param {readonly number[]} ids
   * @returns {() => void} release them
   */
  function keep(counts, ids) {
    const kept = [...ids]; // emptied by the first release
    for (const id of kept) counts.set(id, (counts.get(id) ?? 0) + 1);
    return () => {
      for (const id of kept.splice(0)) {
        const rest = (counts.get(id) ?? 1) - 1;
        if (rest > 0) counts.set(id, rest);
        else counts.delete(id);
      }
      // Not at once: a view may release boxes that the next view is about to hold.
      queueMicrotask(() => {
        for (const id of ids) {
          if (!held.has(id) && !remembered.has(id)) for (const map of [stored, sentElsewhere, combined]) map.delete(id);
        }
      });
    };
  }

  return {
    get: getBox,
    receive,
    reloads,

    /** A view shows these boxes: keep them until they are released. @param {readonly number[]} ids */
    hold: (ids) => keep(held, ids),

    /** Keep these boxes until they are released, whether a view shows them or not. @param {readonly number[]} ids */
    remember: (ids) => keep(remembered, ids),

    /** Lists of boxes have to be read again. */
    reload,

    /** Those of these boxes that are in the store, in this order. @param {readonly number[]} ids */
    all: (ids) => ids.flatMap((id) => getBox(id) ?? []),

    /**
     * Load boxes again that somebody else may have answered, each frame of theirs once.
     * @param {readonly number[]} changed  their ids
     */
    async loadAgain(changed) {
      let ids = changed;
      if (changed.length > MOST_LOADED) {
        reload(); // with it, the grid releases the boxes of its lists
        await null;
        ids = changed.filter((id) => held.has(id));
        tell(new Set(changed.filter((id) => !held.has(id) && sentElsewhere.delete(id))));
      }
      /** @type {Map<number, number[]>} */
      const frames = new Map();
      for (const { box_id, frame_id } of ids.flatMap((id) => stored.get(id) ?? [])) {
        frames.set(frame_id, [...(frames.get(frame_id) ?? []), box_id]);
      }
      const retries = createRetries(later);
      const toLoad = [...frames];
      for (const [frameId, boxIds] of toLoad) {
        if (!boxIds.some((id) => stored.has(id))) continue;
        try {
          const { boxes } = await get("/api/v1/frames/{frame_id}", { path: { frame_id: frameId } });
          receive(boxes.filter(({ box_id }) => stored.has(box_id)));
          retries.reset();
        } catch (error) {
          // After a 401 somebody may sign in again.
          if (!(error instanceof ApiError) || error.isTemporary || error.status === 401) {
            toLoad.push([frameId, boxIds]); // after all others
            await new Promise((done) =>
              retries.wait(() => done(null), error instanceof ApiError ? error.retryAfterS : null),
            );
            continue;
          }
        }
        tell(new Set(boxIds.filter((id) => sentElsewhere.delete(id))));
      }
    },

    /**
     * Another tab has sent the answers on these boxes: show them until `loadAgain` has loaded the boxes.
     * @param {readonly number[]} ids
     */
    showUntilLoaded(ids) {
      for (const id of ids) {
        const answer = unconfirmed.get(id);
        if (answer) sentElsewhere.set(id, answer);
      }
    },

    /** The server has stored answers on these boxes. @param {ReadonlyMap<number, StoredAnswer>} answers  by box */
    receiveAnswers(answers) {
      receive(
        [...answers].flatMap(([id, answer]) => {
          const box = stored.get(id);
          if (!box) early.set(id, answer);
          return box ? [answer.applyTo(box)] : [];
        }),
      );
      for (const id of [...early.keys()].slice(0, -MOST_EARLY)) early.delete(id);
    },

    /** Set the answers that the server has not stored yet. @param {ReadonlyMap<number, AnswerWithComment>} answers */
    layOver(answers) {
      const touched = [...new Set([...unconfirmed.keys(), ...answers.keys()])];
      const changed = touched.filter((id) => !isSameAnswer(unconfirmed.get(id), answers.get(id)));
      unconfirmed = answers;
      tell(new Set(changed));
    },

    /**
     * Remember boxes that were just answered, for the next 500 answers. An earlier response with such a box may still
     * be on its way. When it comes, `receive` drops it, as its revision is lower. Otherwise the store might have
     * forgotten the revision.
     * @param {readonly number[]} ids
     */
    keepRevisions(ids) {
      releases.push(keep(remembered, ids));
      if (releases.length > MOST_ANSWERED) releases.shift()?.();
    },

    /**
     * @param {(changed: ReadonlySet<number>) => void} notify  called with the ids of the boxes that changed
     * @returns {() => void} stop observing
     */
    observe(notify) {
      observers.add(notify);
      return () => observers.delete(notify);
    },
  };
}

/** @typedef {ReturnType<typeof createBoxes>} Boxes */

/** @param {Decision} one @param {Decision} other */
const isSame = (one, other) => one === other || JSON.stringify(one) === JSON.stringify(other);

/** @param {AnswerWithComment | undefined} one @param {AnswerWithComment | undefined} other */
const isSameAnswer = (one, other) => one?.verdict === other?.verdict && one?.comment === other?.comment;

/**
 * The boxes with these ids; the component is drawn again when one of them changes.
 * @param {Boxes} boxes @param {readonly number[]} ids
 */
export function useBoxes(boxes, ids) {
  const [shown, setShown] = useState(() => boxes.all(ids));
  useEffect(() => {
    const wanted = new Set(ids);
    setShown(boxes.all(ids));
    return boxes.observe((changed) => [...changed].some((id) => wanted.has(id)) && setShown(boxes.all(ids)));
  }, [boxes, ids]);
  return shown;
}

/**
 * Boxes as they may be shown: withheld in a blind review until they are answered.
 * @param {App} app @param {readonly Decision[]} boxes
 */
export function useAsShown(app, boxes) {
  const { blind } = useValue(app.prefs);
  return useMemo(() => (blind ? boxes.map((box) => asShown(box, true)) : boxes), [boxes, blind]);
}
