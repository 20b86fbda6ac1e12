// @ts-check
// What a dataset's settings ask of the server.

import { request, segment, send, urlOf } from "../api.js";

/** @typedef {{id: number, key: string, error: {title?: string, detail?: string}, created_at: string}} ProblemItem  a frame that was refused */

export const datasetCalls = {
  /** @param {string} name @param {AbortSignal} [signal] @returns {Promise<import("../types.js").Page<ProblemItem>>} */
  problems: (name, signal) => request(urlOf(`/datasets/${segment(name)}/problems`, { limit: 200 }), { signal }),

  /** @param {string} name @param {Record<string, string>} changes @returns {Promise<boolean>} true: every frame is measured again, by a run */
  async change(name, changes) {
    const headers = { "Content-Type": "application/json" };
    const answer = await send(urlOf(`/datasets/${segment(name)}`), { method: "PATCH", headers, body: JSON.stringify(changes) });
    return answer.status === 202;
  },

  /** @param {string} name @returns {Promise<void>} */
  remove: (name) => request(urlOf(`/datasets/${segment(name)}`, { confirm: name }), { method: "DELETE" }),
};
