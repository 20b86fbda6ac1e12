// @ts-check
// All boxes that the page shows, each stored once: as the server last sent it, combined with answers not saved yet.

import { useValue } from "../core/hooks.js";
import { useEffect, useLayoutEffect, useMemo, useState } from "../core/html.js";
import { seen, seenRevision, withAnswer } from "./box.js";

/** @typedef {import("./box.js").Decision} Decision */
/** @typedef {{verdict: import("./box.js").Answer, comment: string}} GivenAnswer */

/**
 * One store for the whole page. Lists hold ids; a box stays in memory as long as some list holds its id.
 * Of two versions of a box the higher revision wins; with equal revisions, the one received later.
 */
export function createBoxes() {
  /** Boxes as the server last sent them. @type {Map<number, Decision>} */
  const stored = new Map();
  /** Answers that the server has not stored yet. @type {ReadonlyMap<number, GivenAnswer>} */
  let unconfirmed = new Map();
  /** Both combined, made on request: the same object until something changes. @type {Map<number, Decision>} */
  const shown = new Map();
  /** How many lists hold an id. @type {Map<number, number>} */
  const holders = new Map();
  /** @type {Set<(changed: ReadonlySet<number>) => void>} */
  const observers = new Set();

  /** @param {ReadonlySet<number>} changed */
  function tell(changed) {
    for (const id of changed) shown.delete(id);
    // A copy: an observer may stop observing while it is notified.
    if (changed.size > 0) [...observers].forEach((notify) => notify(changed));
  }

  /** The box including the person's own answer. @param {number} id */
  function get(id) {
    const known = shown.get(id);
    if (known) return known;
    const box = stored.get(id);
    if (!box) return undefined;
    const answer = unconfirmed.get(id);
    const now = answer ? Object.freeze(withAnswer(box, answer.verdict, answer.comment)) : box;
    shown.set(id, now);
    return now;
  }

  /** Drop boxes that no list holds. @param {readonly number[]} ids */
  function sweep(ids) {
    for (const id of ids) {
      if (holders.has(id)) continue;
      stored.delete(id);
      shown.delete(id);
    }
  }

  return {
    get,

    /** Those of these boxes that are in the store, in this order. @param {readonly number[]} ids */
    all: (ids) => ids.flatMap((id) => get(id) ?? []),

    /** Add boxes that the server sent. Hold their ids to keep them in the store. @param {readonly Decision[]} boxes @returns {number[]} their ids */
    receive(boxes) {
      /** @type {Set<number>} */
      const changed = new Set();
      for (const box of boxes) {
        const known = stored.get(box.box_id);
        if (known && (seenRevision(known) > seenRevision(box) || isSame(known, box))) continue;
        stored.set(box.box_id, Object.freeze(box));
        if (known) changed.add(box.box_id);
      }
      tell(changed);
      return boxes.map(({ box_id }) => box_id);
    },

    /** Replace the set of answers that the server has not stored yet. @param {ReadonlyMap<number, GivenAnswer>} answers */
    layOver(answers) {
      const touched = [...new Set([...unconfirmed.keys(), ...answers.keys()])];
      const changed = touched.filter((id) => !isSameAnswer(unconfirmed.get(id), answers.get(id)));
      unconfirmed = answers;
      tell(new Set(changed));
    },

    /** Keep boxes in the store until they are released. @param {readonly number[]} ids @returns {() => void} release them */
    hold(ids) {
      const held = [...ids];
      for (const id of held) holders.set(id, (holders.get(id) ?? 0) + 1);
      return () => {
        for (const id of held.splice(0)) {
          const rest = (holders.get(id) ?? 1) - 1;
          if (rest > 0) holders.set(id, rest);
          else holders.delete(id);
        }
        // Not at once: a view may release boxes that the next view is about to hold.
        queueMicrotask(() => sweep([...ids]));
      };
    },

    /** @param {(changed: ReadonlySet<number>) => void} notify  called with the ids of the boxes that changed @returns {() => void} stop observing */
    observe(notify) {
      observers.add(notify);
      return () => observers.delete(notify);
    },
  };
}

/** @typedef {ReturnType<typeof createBoxes>} Boxes */

/** @param {Decision} one @param {Decision} other */
const isSame = (one, other) => one === other || JSON.stringify(one) === JSON.stringify(other);

/** @param {GivenAnswer | undefined} one @param {GivenAnswer | undefined} other */
const isSameAnswer = (one, other) => one?.verdict === other?.verdict && one?.comment === other?.comment;

/** The boxes with these ids; the component is drawn again when one of them changes. @param {Boxes} boxes @param {readonly number[]} ids */
export function useBoxes(boxes, ids) {
  const [shown, setShown] = useState(() => boxes.all(ids));
  useEffect(() => {
    const wanted = new Set(ids);
    setShown(boxes.all(ids));
    return boxes.observe((changed) => [...changed].some((id) => wanted.has(id)) && setShown(boxes.all(ids)));
  }, [boxes, ids]);
  return shown;
}

/** Put boxes into the store and hold them while the view is on the page. @param {Boxes} boxes @param {readonly Decision[]} came @returns {readonly number[]} their ids */
export function useHeld(boxes, came) {
  const ids = useMemo(() => boxes.receive(came), [boxes, came]);
  useLayoutEffect(() => boxes.hold(ids), [boxes, ids]);
  return ids;
}

/** Boxes as they may be shown: veiled in a blind review until they are answered. @param {import("../core/app.js").App} app @param {readonly import("./box.js").Decision[]} boxes */
export function useSeen(app, boxes) {
  const { blind } = useValue(app.prefs);
  return useMemo(() => (blind ? boxes.map((box) => seen(box, true)) : boxes), [boxes, blind]);
}
