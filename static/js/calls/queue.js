// @ts-check
// The server's queue: the next boxes, claimed for this reviewer for a few minutes.

import { post, segment } from "../api.js";

/** @typedef {import("../types.js").Decision & {claim: {expires_at: string}}} QueuedBox */
/** @typedef {{items: QueuedBox[], remaining: number, unsure: number, claimed_by_others: number}} QueueOut */
/** @typedef {{order: string, filters: Record<string, string | number | boolean>, limit: number, exclude: readonly number[]}} QueueRequest */

/** @param {string} dataset @param {QueueRequest} wanted @returns {Promise<QueueOut>} */
export const nextBoxes = (dataset, wanted) => post(`/datasets/${segment(dataset)}/queue`, wanted);
