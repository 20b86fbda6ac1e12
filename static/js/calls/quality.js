// @ts-check
// The filter against people, and its channels against each other.

import { post, request, segment, urlOf } from "../api.js";

/** @param {string} dataset @param {{truth: string, target: string}} asked  people or instances; f1 or recall @param {AbortSignal} [signal] @returns {Promise<import("../types_quality.js").Quality>} */
export const loadQuality = (dataset, asked, signal) =>
  request(urlOf(`/datasets/${segment(dataset)}/quality`, asked), { signal });

/** @param {string} dataset @param {string} truth  instances or people @param {AbortSignal} [signal] @returns {Promise<import("../types_quality.js").Evaluation>} */
export const loadEvaluation = (dataset, truth, signal) =>
  request(urlOf(`/datasets/${segment(dataset)}/evaluations`, { truth }), { signal });

/** Measure every channel that the frames' files allow. @param {string} dataset @returns {Promise<import("../types_jobs.js").Run>} */
export const startEvaluation = (dataset) => post(`/datasets/${segment(dataset)}/evaluations`, {});
