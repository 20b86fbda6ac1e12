// @ts-check
// Looking again without being told: what others and the filter said stays hidden until one has
// answered. Pure.

import { answerOf } from "../reviews.js";

/** @typedef {import("../types.js").Decision} Decision */
/** @typedef {import("../types.js").Answer} Answer */
/** @typedef {import("../router.js").Query} Query */
/** @typedef {{boxId: number, words: string, agrees: boolean}} Comparison */

/** An audit is blind unless one wants to see; elsewhere as one prefers. @param {Query} query @param {{blind?: boolean}} prefs */
export function isBlind(query, prefs) {
  if (query.blind) return query.blind === "on";
  return query.order === "audit" || prefs.blind === true;
}

/** What was hidden, beside what was answered. @param {Decision} before @param {Answer} answer @returns {Comparison | null} null: nothing to compare with */
export function compared(before, answer) {
  if (answer !== "keep" && answer !== "reject") return null;
  const earlier = answerOf(before);
  const name = `${before.class} ${before.id}`;
  if (earlier === "keep" || earlier === "reject") {
    const agrees = earlier === answer;
    const who = before.review?.reviewer || "The earlier answer";
    return { boxId: before.box_id, agrees, words: agrees ? `${name}: you and ${who} agree, ${answer}` : `${name}: ${who} said ${earlier}, you said ${answer}` };
  }
  if (before.verdict === "unmeasured") return null;
  const agrees = (before.verdict === "kept") === (answer === "keep");
  return { boxId: before.box_id, agrees, words: `${name}: the filter ${agrees ? "agrees" : "says"} ${before.verdict}${agrees ? "" : `, you said ${answer}`}` };
}
