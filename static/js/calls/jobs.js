// @ts-check
// Configurations, previews, runs and exports of a dataset.

import { post, request, segment, urlOf } from "../api.js";

/** @typedef {import("../types_jobs.js").ConfigVersion} ConfigVersion */
/** @typedef {import("../types_jobs.js").ConfigBody} ConfigBody */
/** @typedef {import("../types_jobs.js").Preview} Preview */
/** @typedef {import("../types_jobs.js").Run} Run */
/** @typedef {import("../types_jobs.js").RunDiff} RunDiff */
/** @typedef {import("../types_jobs.js").Export} Export */
/** @typedef {import("../api.js").Params} Params */

/** Half a percent each: the step of a threshold. */
export const BINS = 200;

/** @param {string} dataset @param {string} rest */
const pathOf = (dataset, rest) => `/datasets/${segment(dataset)}/${rest}`;

export const jobs = {
  /** The configuration that decides now. @param {string} dataset @param {AbortSignal} [signal] @returns {Promise<ConfigVersion>} */
  activeConfig: (dataset, signal) => request(urlOf(pathOf(dataset, "config")), { signal }),

  /** @param {string} dataset @param {Params} params @param {AbortSignal} [signal] @returns {Promise<import("../types.js").Page<ConfigVersion>>} */
  configs: (dataset, params, signal) => request(urlOf(pathOf(dataset, "configs"), params), { signal }),

  /** @param {string} digest @param {AbortSignal} [signal] @returns {Promise<ConfigVersion>} */
  config: (digest, signal) => request(urlOf(`/configs/${segment(digest)}`), { signal }),

  /** @param {string} dataset @param {ConfigBody} config @returns {Promise<ConfigVersion>} */
  saveConfig: (dataset, config) => post(pathOf(dataset, "configs"), config),

  /** Make a version the active one, through a run. @param {string} dataset @param {string} digest @returns {Promise<Run>} */
  activate(dataset, digest) {
    const headers = { "Content-Type": "application/json" };
    return request(urlOf(pathOf(dataset, "config")), { method: "PUT", headers, body: JSON.stringify({ digest }) });
  },

  /** @param {string} dataset @param {{config: ConfigBody, limit: number}} wanted @param {AbortSignal} signal @returns {Promise<Preview>} */
  preview: (dataset, { config, limit }, signal) =>
    request(urlOf(pathOf(dataset, "preview")), {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ config, limit, bins: BINS }),
      signal,
    }),

  /** @param {string} dataset @param {Params} params @param {AbortSignal} [signal] @returns {Promise<import("../types.js").Page<Run>>} */
  runs: (dataset, params, signal) => request(urlOf(pathOf(dataset, "runs"), params), { signal }),

  /** @param {number} id @param {AbortSignal} [signal] @returns {Promise<Run>} */
  run: (id, signal) => request(urlOf(`/runs/${id}`), { signal }),

  /** @param {number} id @returns {Promise<Run>} */
  cancelRun: (id) => post(`/runs/${id}/cancel`, {}),

  /** @param {number} id @param {Params} params @param {AbortSignal} [signal] @returns {Promise<RunDiff>} */
  diff: (id, params, signal) => request(urlOf(`/runs/${id}/diff`, params), { signal }),

  /** @param {number} id */
  eventsUrl: (id) => urlOf(`/runs/${id}/events`),

  /** @param {string} dataset @param {Params} params @param {AbortSignal} [signal] @returns {Promise<import("../types.js").Page<Export>>} */
  exports: (dataset, params, signal) => request(urlOf(pathOf(dataset, "exports"), params), { signal }),

  /** @param {string} dataset @param {{format: string, options: Record<string, unknown>}} wanted @returns {Promise<Export>} */
  createExport: (dataset, wanted) => post(pathOf(dataset, "exports"), wanted),

  /** @param {number} id @param {AbortSignal} [signal] @returns {Promise<Export>} */
  export: (id, signal) => request(urlOf(`/exports/${id}`), { signal }),

  /** @param {number} id @returns {Promise<Export>} */
  cancelExport: (id) => post(`/exports/${id}/cancel`, {}),

  /** The API in its own words. @param {AbortSignal} [signal] @returns {Promise<Record<string, unknown>>} */
  description: (signal) => request("/openapi.json", { signal }),

  /** An address of its file for the browser to download, which works for minutes. @param {number} id @returns {Promise<{url: string, expires_at: string}>} */
  downloadLink: (id) => post(`/exports/${id}/download-links`, {}),

  /** A box with some of what is around it. @param {number} boxId @param {number} height px */
  cropUrl: (boxId, height) => urlOf(`/boxes/${boxId}/crop`, { height, pad: 0.6 }),
};
