// @ts-check
// The boxes of the queue in order, with the current position: pure functions; and how a blind answer compares with
// earlier ones.

import { answerOf } from "../boxes/box.js";

/** @import { Answer, Decision } from "../boxes/box.js" */
/** @import { Query } from "../core/router.js" */

/**
 * @typedef {object} Line
 * @property {readonly number[]} ids  of the boxes, in the order of the queue
 * @property {number} at  index of the current box; `ids.length` past the last
 * @property {ReadonlySet<number>} answered  in this session
 */

/** @type {Line} */
export const EMPTY = Object.freeze({ ids: [], at: 0, answered: new Set() });

/** @param {Line} line @returns {number | null} */
export const currentOf = ({ ids, at }) => ids[at] ?? null;

/** The next ones to be looked at, the current one not included. @param {Line} line @param {number} count */
export const upcoming = ({ ids, at, answered }, count) =>
  ids
    .slice(at + 1)
    .filter((id) => !answered.has(id))
    .slice(0, count);

/** Boxes that were skipped without an answer. @param {Line} line */
export const skippedBoxes = ({ ids, at, answered }) => ids.slice(0, at).filter((id) => !answered.has(id));

/**
 * The line without the boxes that are still to be looked at, the current one included.
 * @param {Line} line @returns {Line}
 */
export function lookedAt(line) {
  const ids = line.ids.filter((id, index) => index < line.at || line.answered.has(id));
  return { ...line, ids, at: ids.length };
}

/**
 * Append boxes that the server sent; boxes already in the line keep their place.
 * @param {Line} line @param {readonly number[]} more @returns {Line}
 */
export function extended(line, more) {
  const known = new Set(line.ids);
  return { ...line, ids: [...line.ids, ...more.filter((id) => !known.has(id))] };
}

/**
 * After an answer on the current box, the next box without an answer is current.
 * @param {Line} line @param {number} id @returns {Line}
 */
export function afterAnswer(line, id) {
  const done = { ...line, answered: new Set([...line.answered, id]) };
  return currentOf(line) === id ? nextOpen(done) : done;
}

/** The box was answered, and stays current. @param {Line} line @param {number} id @returns {Line} */
export const answeredHere = (line, id) => ({ ...line, answered: new Set([...line.answered, id]) });

/** Without boxes that nobody has answered. @param {Line} line @param {readonly number[]} ids @returns {Line} */
export function without(line, ids) {
  const isGone = (/** @type {number} */ id) => ids.includes(id) && !line.answered.has(id);
  const before = line.ids.slice(0, line.at).filter((id) => !isGone(id));
  return { ...line, ids: line.ids.filter((id) => !isGone(id)), at: before.length };
}

/** The answer was undone: the box is current again. @param {Line} line @param {number} id @returns {Line} */
export function afterUndo(line, id) {
  const rest = new Set(line.answered);
  rest.delete(id);
  const at = line.ids.indexOf(id);
  if (at >= 0) return { ...line, at, answered: rest };
  return { ids: [...line.ids.slice(0, line.at), id, ...line.ids.slice(line.at)], at: line.at, answered: rest };
}

/** One step, answered or not. @param {Line} line @param {1 | -1} step @returns {Line} */
export const stepped = (line, step) => ({ ...line, at: Math.min(Math.max(line.at + step, 0), line.ids.length) });

/** @param {Line} line @returns {Line} */
export function nextOpen(line) {
  const next = line.ids.findIndex((id, index) => index > line.at && !line.answered.has(id));
  return { ...line, at: next < 0 ? line.ids.length : next };
}

/** @param {Line} line @param {number} id @returns {Line} */
export function movedTo(line, id) {
  const at = line.ids.indexOf(id);
  return at < 0 ? line : { ...line, at };
}

/**
 * Put the skipped boxes after the answered ones, and make the first of them current.
 * @param {Line} line @returns {Line}
 */
export function backToSkipped(line) {
  const open = skippedBoxes(line);
  const answered = line.ids.slice(0, line.at).filter((id) => line.answered.has(id));
  return { ...line, ids: [...answered, ...open, ...line.ids.slice(line.at)], at: answered.length };
}

const PACE_OVER = 20;

/**
 * Answers per minute over the last of them; null before there is a pace.
 * @param {readonly number[]} times ms, of the answers
 * @returns {number | null}
 */
export function paceOf(times) {
  const last = times.slice(-PACE_OVER);
  const span = (last.at(-1) ?? 0) - (last[0] ?? 0);
  return last.length < 4 || span <= 0 ? null : ((last.length - 1) * 60_000) / span;
}

/** @typedef {{boxId: number, words: string, agrees: boolean}} Comparison */

/**
 * Whether the review is blind: as the address says; otherwise an audit is blind, and other orders follow the
 * preference.
 * @param {Query} query @param {{blind?: boolean}} prefs
 */
export function isBlind(query, prefs) {
  if (query.blind) return query.blind === "on";
  return query.order === "audit" || prefs.blind === true;
}

/**
 * The queue in another order. An audit begins blind, also if the order before was not.
 * @param {Query} query @param {string} order @returns {Query}
 */
export function inOrder({ blind = "", ...query }, order) {
  return { ...query, order, blind: order === "audit" && blind === "off" ? "" : blind };
}

/**
 * Compare a blind answer with the earlier answer, or else with the filter's verdict.
 * @param {Decision} before @param {Answer} answer @returns {Comparison | null} null: nothing to compare with
 */
export function compared(before, answer) {
  if (answer !== "keep" && answer !== "reject") return null;
  const earlier = answerOf(before);
  const name = `${before.class} ${before.id}`;
  if (earlier === "keep" || earlier === "reject") {
    const agrees = earlier === answer;
    const who = before.review?.reviewer || "The earlier answer";
    return {
      boxId: before.box_id,
      agrees,
      words: agrees
        ? `${name}: you and ${who} agree, ${answer}`
        : `${name}: ${who} said ${earlier}, you said ${answer}`,
    };
  }
  if (before.verdict === "unmeasured") return null;
  const agrees = (before.verdict === "kept") === (answer === "keep");
  return {
    boxId: before.box_id,
    agrees,
    words: `${name}: the filter ${agrees ? "agrees" : "says"} ${before.verdict}${agrees ? "" : `, you said ${answer}`}`,
  };
}
