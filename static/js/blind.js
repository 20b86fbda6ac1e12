// @ts-check
// Blind re-check: of a box that nobody has answered, only where it is can be seen. What a view
// draws is a veiled copy, so nothing that is derived from the box can give the verdict away.

import { answerOf } from "./reviews.js";

/** @typedef {import("./types.js").Decision} Decision */

/** One copy per box: views compare boxes by identity. @type {WeakMap<Decision, Decision>} */
const copies = new WeakMap();

/** Without everything that the filter, or anybody, has said. @param {Decision} box @returns {Decision} */
export function veiled(box) {
  const known = copies.get(box);
  if (known) return known;
  const copy = Object.freeze({
    ...box,
    verdict: /** @type {const} */ ("veiled"),
    effective_verdict: /** @type {const} */ ("veiled"),
    reason: "veiled",
    explanation: "",
    evidence: null,
    match_percent: null,
    threshold: null,
    margin: null,
    toss_up: false,
    matched_pixels: null,
    box_pixels: null,
    crowding: null,
    explained_by: null,
    hidden_by: [],
    accepted_tags: [],
    review: null,
  });
  copies.set(box, copy);
  return copy;
}

/** @param {Decision} box */
const hasAnswer = (box) => answerOf(box) !== null;

/**
 * What may be shown of a box. For an audit of answered boxes, `isOpen` tells which ones this
 * person has answered by now.
 * @param {Decision} box @param {boolean} isBlind the switch in the preferences @param {(box: Decision) => boolean} [isOpen]
 * @returns {Decision}
 */
export const seen = (box, isBlind, isOpen = hasAnswer) => (isBlind && !isOpen(box) ? veiled(box) : box);

/** @param {Decision} box */
export const isVeiled = (box) => box.verdict === "veiled";
