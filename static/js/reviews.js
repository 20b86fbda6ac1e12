// @ts-check
// What an answer does to a decision. Pure: the server does the same and has the last word.

/** @typedef {import("./types.js").Decision} Decision */
/** @typedef {import("./types.js").Answer} Answer */
/** @typedef {import("./types.js").Verdict} Verdict */

/** @param {Decision} box @returns {Exclude<Answer, "clear"> | null} the person's answer in force */
export function answerOf(box) {
  const verdict = box.review?.verdict;
  return verdict && verdict !== "clear" ? verdict : null;
}

/** @param {Decision} box */
export const isUndecided = (box) => answerOf(box) === null;

/** The revision that an answer given now has seen. @param {Partial<Pick<Decision, "revision" | "review">>} box */
export const seenRevision = (box) => Math.max(box.revision ?? 0, box.review?.revision ?? 0);

/** @param {Decision} box @param {Answer} answer @returns {Verdict} */
function effectiveAfter(box, answer) {
  if (answer === "keep") return "kept";
  if (answer === "reject") return "rejected";
  return box.verdict;
}

/**
 * The box as it will be once the answer is stored; its revision stays the server's.
 * @param {Decision} box @param {Answer} answer @param {string} [comment]
 * @returns {Decision}
 */
export function withAnswer(box, answer, comment = "") {
  const revision = seenRevision(box);
  const review = answer === "clear" ? null : { verdict: answer, reviewer: "", revision, comment };
  return { ...box, revision, review, effective_verdict: effectiveAfter(box, answer) };
}

/**
 * The box as the server has stored it.
 * @param {Decision} box @param {import("./types.js").StoredReview} stored
 * @returns {Decision}
 */
export function withStored(box, stored) {
  const { revision, verdict, reviewer, comment, effective_verdict } = stored;
  const review = verdict === "clear" ? null : { verdict, reviewer, revision, comment: comment ?? "" };
  return { ...box, revision, review, effective_verdict };
}
