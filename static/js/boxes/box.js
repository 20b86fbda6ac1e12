// @ts-check
// How an answer changes a box, and what a blind review shows of a box before it is answered.

/** @import { Decision as StoredDecision, Review } from "../core/openapi.js" */
/** @typedef {import("../core/openapi.js").Review["verdict"]} Answer  a person's answer; clear removes it */
/** @typedef {{verdict: Answer, comment: string}} AnswerWithComment */
/**
 * @typedef {StoredDecision["verdict"] | "withheld"} Verdict the filter's verdict; withheld: hidden until the person has
 *   answered, on this page only
 */
/**
 * A box as the page may show it.
 * @typedef {Omit<StoredDecision, "verdict" | "effective_verdict" | "reason">
 *   & {verdict: Verdict, effective_verdict: Verdict, reason: StoredDecision["reason"] | "withheld"}} Decision
 */
/** @typedef {NonNullable<Decision["xyxy"]>} Xyxy  image px, half-open: x_min y_min x_max y_max */

/** @param {Decision} box @returns {Exclude<Answer, "clear"> | null} the person's answer in force */
export function answerOf(box) {
  const verdict = box.review?.verdict;
  return verdict && verdict !== "clear" ? verdict : null;
}

/**
 * The answer in force, in the form in which one is given; clear if there is none.
 * @param {Decision} box @returns {AnswerWithComment & {boxId: number}}
 */
export const currentAnswer = ({ box_id, review }) => ({
  boxId: box_id,
  verdict: review?.verdict ?? "clear",
  comment: review?.comment ?? "",
});

/** @param {Decision} box */
export const isUnanswered = (box) => answerOf(box) === null;

/**
 * The newest revision of the box that this page has seen; it is sent with an answer.
 * @param {Partial<Pick<Decision, "revision" | "review">>} box
 */
export const seenRevision = (box) => Math.max(box.revision ?? 0, box.review?.revision ?? 0);

/**
 * The box with an answer. As long as that is not stored, its revision stays the server's.
 * @param {Decision} box @param {Answer} answer @param {string} [comment] @param {number} [revision]
 * @returns {Decision}
 */
export function withAnswer(box, answer, comment = "", revision = seenRevision(box)) {
  const review = answer === "clear" ? null : { verdict: answer, reviewer: "", revision, comment, created_at: "" };
  const effective_verdict = answer === "keep" ? "kept" : answer === "reject" ? "rejected" : box.verdict;
  return { ...box, revision, review, effective_verdict };
}

/** The box as the server has stored it. @param {Decision} box @param {Review} stored @returns {Decision} */
export function withStored(box, stored) {
  const { revision, verdict, reviewer, comment, effective_verdict, created_at } = stored;
  const review = verdict === "clear" ? null : { verdict, reviewer, revision, comment: comment ?? "", created_at };
  return { ...box, revision, review, effective_verdict };
}

/** One copy per box: views compare boxes by identity. @type {WeakMap<Decision, Decision>} */
const copies = new WeakMap();

/** The box without verdict, numbers and answers, for a blind review. @param {Decision} box @returns {Decision} */
export function withheld(box) {
  const known = copies.get(box);
  if (known) return known;
  const copy = Object.freeze({
    ...box,
    verdict: /** @type {const} */ ("withheld"),
    effective_verdict: /** @type {const} */ ("withheld"),
    reason: /** @type {const} */ ("withheld"),
    explanation: "",
    evidence: null,
    match_percent: null,
    threshold: null,
    margin: null,
    toss_up: false,
    question: null,
    doubt: 0,
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

/**
 * The box as it may be shown: withheld in a blind review until it is answered. For an audit of answered boxes, `isOpen`
 * tells which ones this person has answered by now.
 * @param {Decision} box @param {boolean} isBlind  the switch in the preferences
 * @param {(box: Decision) => boolean} [isOpen] @returns {Decision}
 */
export const asShown = (box, isBlind, isOpen = (one) => !isUnanswered(one)) =>
  isBlind && !isOpen(box) ? withheld(box) : box;

/** @param {Decision} box */
export const isWithheld = (box) => box.verdict === "withheld";
