// @ts-check
// The boxes that are on show, each once: as the server last said, with a person's unconfirmed answers laid over.

import * as api from "../core/api.js";
import { useValue } from "../core/hooks.js";
import { useEffect, useLayoutEffect, useMemo, useState } from "../core/html.js";
import { fetchAhead, fileUrl } from "../core/pictures.js";
import { seen, seenRevision, withAnswer } from "./box.js";

/** @typedef {import("./box.js").Decision} Decision */
/** @typedef {import("../core/openapi.js").Frame} Frame */
/** @typedef {{verdict: import("./box.js").Answer, comment: string}} GivenAnswer */

/**
 * One store for the whole page. Lists hold ids; a box stays as long as somebody holds its id.
 * The box with the higher revision wins; of two with the same one, that which came later.
 */
export function createBoxes() {
  /** As the server last said. @type {Map<number, Decision>} */
  const stored = new Map();
  /** What a person has answered and the server has not confirmed. @type {ReadonlyMap<number, GivenAnswer>} */
  let unconfirmed = new Map();
  /** Both together, made when it is asked for: the same object until something changes. @type {Map<number, Decision>} */
  const shown = new Map();
  /** How many hold an id. @type {Map<number, number>} */
  const holders = new Map();
  /** @type {Set<(changed: ReadonlySet<number>) => void>} */
  const observers = new Set();

  /** @param {ReadonlySet<number>} changed */
  function tell(changed) {
    for (const id of changed) shown.delete(id);
    // A copy: who listens may stop listening while being told.
    if (changed.size > 0) [...observers].forEach((notify) => notify(changed));
  }

  /** How a box is now, the person's own answer included. @param {number} id */
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

  /** Let go of boxes that nobody holds. @param {readonly number[]} ids */
  function sweep(ids) {
    for (const id of ids) {
      if (holders.has(id)) continue;
      stored.delete(id);
      shown.delete(id);
    }
  }

  return {
    get,

    /** Those of these boxes that are here, in this order. @param {readonly number[]} ids */
    all: (ids) => ids.flatMap((id) => get(id) ?? []),

    /** What the server says of boxes; who wants to keep them holds their ids. @param {readonly Decision[]} boxes @returns {number[]} their ids */
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

    /** All answers that the server has not confirmed by now; those of before are lifted off. @param {ReadonlyMap<number, GivenAnswer>} answers */
    layOver(answers) {
      const touched = [...new Set([...unconfirmed.keys(), ...answers.keys()])];
      const changed = touched.filter((id) => !isSameAnswer(unconfirmed.get(id), answers.get(id)));
      unconfirmed = answers;
      tell(new Set(changed));
    },

    /** Keep boxes until they are given back. @param {readonly number[]} ids @returns {() => void} give them back */
    hold(ids) {
      const held = [...ids];
      for (const id of held) holders.set(id, (holders.get(id) ?? 0) + 1);
      return () => {
        for (const id of held.splice(0)) {
          const rest = (holders.get(id) ?? 1) - 1;
          if (rest > 0) holders.set(id, rest);
          else holders.delete(id);
        }
        // Not at once: a view may give back boxes that the next one is about to hold.
        queueMicrotask(() => sweep([...ids]));
      };
    },

    /** @param {(changed: ReadonlySet<number>) => void} notify told which boxes are others now @returns {() => void} stop observing */
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

/** A frame fetched ahead is only used while it is fresh: others may be answering. */
const FRESH_MS = 20_000;

/** @param {number} id @param {AbortSignal} [signal] */
const frameOf = (id, signal) => api.get("/api/v1/frames/{frame_id}", { path: { frame_id: id }, signal });

/** Frames that are likely next, fetched ahead. */
export function createFrames() {
  /** @type {Map<number, {frame: Promise<Frame>, at: number}>} */
  const ahead = new Map();
  return {
    /** @param {number} id @param {AbortSignal} signal @returns {Promise<Frame>} */
    load(id, signal) {
      const known = ahead.get(id);
      ahead.delete(id);
      return known && Date.now() - known.at < FRESH_MS ? known.frame : frameOf(id, signal);
    },

    /** @param {number | null} id */
    fetchAhead(id) {
      if (id === null || ahead.has(id)) return;
      ahead.clear();
      const frame = frameOf(id);
      ahead.set(id, { frame, at: Date.now() });
      frame.then(
        (found) => found.has_image && fetchAhead(fileUrl(found, "image")),
        () => ahead.delete(id),
      );
    },

    /** What was fetched ahead is no longer true. @param {number | undefined} id */
    forget(id) {
      if (id !== undefined) ahead.delete(id);
    },

    forgetAll: () => ahead.clear(),
  };
}

/** @typedef {ReturnType<typeof createFrames>} Frames */

/** Boxes on show, drawn again when one of them is another. @param {Boxes} boxes @param {readonly number[]} ids */
export function useBoxes(boxes, ids) {
  const [shown, setShown] = useState(() => boxes.all(ids));
  useEffect(() => {
    const wanted = new Set(ids);
    setShown(boxes.all(ids));
    return boxes.observe((changed) => [...changed].some((id) => wanted.has(id)) && setShown(boxes.all(ids)));
  }, [boxes, ids]);
  return shown;
}

/** Boxes that came for a view, held while it shows them. @param {Boxes} boxes @param {readonly Decision[]} came @returns {readonly number[]} their ids */
export function useHeld(boxes, came) {
  const ids = useMemo(() => boxes.receive(came), [boxes, came]);
  useLayoutEffect(() => boxes.hold(ids), [boxes, ids]);
  return ids;
}

/** Boxes as they may be shown: veiled where the person re-checks blindly. @param {import("../core/app.js").App} app @param {readonly import("./box.js").Decision[]} boxes */
export function useSeen(app, boxes) {
  const { blind } = useValue(app.prefs);
  return useMemo(() => (blind ? boxes.map((box) => seen(box, true)) : boxes), [boxes, blind]);
}
