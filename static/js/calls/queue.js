// @ts-check
// The server's queue: the next boxes, claimed for this reviewer for a few minutes.

import { ApiError, post, segment } from "../api.js";
import { isUndecided } from "../reviews.js";

/** @typedef {import("../types.js").Decision & {claim: {expires_at: string}}} QueuedBox */
/** @typedef {{items: QueuedBox[], remaining: number, unsure: number, claimed_by_others: number}} QueueOut */
/** @typedef {{order: string, filters: Record<string, string | number | boolean>, limit: number, exclude: readonly number[]}} QueueRequest */

/** @param {string} dataset @param {QueueRequest} wanted @returns {Promise<QueueOut>} */
export const nextBoxes = (dataset, wanted) => post(`/datasets/${segment(dataset)}/queue`, wanted);

/** Boxes by their ids, claimed for nobody; those that are gone are left out. @param {typeof import("../api.js").api} api @param {readonly number[]} ids */
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
