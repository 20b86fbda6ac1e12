// @ts-check
// What uploads ask of the server.

import { post, segment, send, urlOf } from "../api.js";
import { FILE_KINDS } from "../upload/manifest.js";

/** @typedef {import("../upload/manifest.js").ReadFrame} ReadFrame */

/** Slashes stay: they are part of a key. @param {string} key */
const keyPath = (key) => key.split("/").map(segment).join("/");

/** A file as it is now; one that has gone or changed since it was picked is refused here, not by the network. @param {import("../upload/matching.js").Entry} entry */
async function contentOf({ blob, path }) {
  try {
    return new Blob([await blob.arrayBuffer()]);
  } catch {
    throw new Error(`${path} can no longer be read: it was changed or taken away`);
  }
}

/** @param {ReadFrame} frame */
async function formOf({ annotation, files }) {
  const form = new FormData();
  form.append("annotation", new Blob([JSON.stringify(annotation)], { type: "application/json" }), "annotation.json");
  for (const kind of FILE_KINDS) {
    const entry = files[kind];
    if (entry) form.append(kind, await contentOf(entry), kind);
  }
  return form;
}

export const uploadCalls = {
  /** @param {{name: string, classes?: string[]} & Record<string, unknown>} dataset @returns {Promise<import("../types.js").Dataset>} */
  createDataset: (dataset) => post("/datasets", dataset),

  /**
   * @param {string} dataset @param {ReadFrame} frame @param {boolean} replace  other content becomes the next revision
   * @param {AbortSignal} signal @returns {Promise<boolean>} true: stored now; false: it was there already
   */
  async putFrame(dataset, frame, replace, signal) {
    const url = urlOf(`/datasets/${segment(dataset)}/frames/${keyPath(frame.key)}`, { replace: replace ? "true" : undefined });
    return (await send(url, { method: "PUT", body: await formOf(frame), signal })).status === 201;
  },
};

/** @typedef {typeof uploadCalls} UploadCalls */
