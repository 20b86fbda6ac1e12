// @ts-check
// Boxes across frames: lists, crops, one answer on many.

import { post, request, urlOf } from "../api.js";

/** @typedef {import("../bulk.js").Act} Act */
/** @typedef {import("../grid/pager.js").BoxPage} BoxPage */

/** @param {string} dataset @param {Record<string, string | number | boolean>} filter @param {{sort?: string, limit: number, cursor?: string, count?: boolean}} page @param {AbortSignal} [signal] @returns {Promise<BoxPage>} */
export const listBoxes = (dataset, filter, { sort, limit, cursor, count }, signal) =>
  request(urlOf("/boxes", { dataset, ...texts(filter), sort, limit, cursor, count: count ? "true" : undefined }), { signal });

/** How many boxes a filter selects, and what stands for them as they are now. @param {string} dataset @param {Record<string, string | number | boolean>} filter @returns {Promise<{total: number, snapshot: string} | null>} */
export async function countBoxes(dataset, filter) {
  const { total, snapshot } = await listBoxes(dataset, filter, { limit: 1, count: true });
  return typeof total === "number" && snapshot ? { total, snapshot } : null;
}

/** @param {number} boxId @param {{pad: number, height: number}} how */
export const cropUrl = (boxId, { pad, height }) => urlOf(`/boxes/${boxId}/crop`, { pad, height });

/** One answer on many boxes, as they were seen. @param {Act} act @returns {Promise<import("../bulk.js").BulkOut>} */
export function sendBulk({ key, dataset, verdict, boxIds, seen, filter, snapshot }) {
  const which = boxIds ? { box_ids: boxIds, seen_revisions: seen } : { filter, snapshot };
  return post("/reviews/bulk", { dataset, verdict, ...which }, key);
}

/** The same key for the same batch: a repeated request undoes once. @param {number} batchId @returns {Promise<import("../bulk.js").UndoOut>} */
export const undoBulk = (batchId) => post(`/review-batches/${batchId}/undo`, {}, `undo-batch-${batchId}`);

/** @param {Record<string, string | number | boolean>} filter */
const texts = (filter) => Object.fromEntries(Object.entries(filter).map(([key, value]) => [key, String(value)]));
