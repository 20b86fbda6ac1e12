// @ts-check
// Crops, several in one request: of small pictures a line carries many more in the time of one response. No DOM.

import { ApiError } from "../core/api.js";

/** The address of a crop that can be asked for together with others: its box, `pad`, `height` and perhaps version. */
const PLAIN = /\/boxes\/(\d+)\/crop\?pad=([\d.]+)&height=(\d+)(?:&v=([^&]*))?$/;

const MOST_IN_A_BUNDLE = 12;

/** A browser has six connections to a server; some are left for what a person does meanwhile. */
const PARALLEL = 4;

/**
 * @typedef {object} Ask
 * @property {string} address
 * @property {boolean} isAlone  it cannot be asked for with others, or was missing in their bundle
 * @property {AbortSignal} signal
 * @property {(file: Blob) => void} resolve
 * @property {(error: unknown) => void} reject
 */

/**
 * Fetches crops, those that are asked for in the same moment in few requests. What is no longer wanted when its turn
 * comes is not asked for.
 * @param {(address: string, signal: AbortSignal) => Promise<Blob>} fetchFile
 * @param {{parallel?: number}} [how]
 */
export function createBundles(fetchFile, { parallel = PARALLEL } = {}) {
  /** @type {Ask[]} */
  let asks = [];
  let underWay = 0;

  function send() {
    asks = asks.filter(({ signal }) => !signal.aborted);
    while (underWay < parallel && asks.length > 0) {
      const isAlone = asks[0]?.isAlone;
      const end = asks.findIndex((ask) => ask.isAlone);
      const bundle = asks.splice(0, isAlone ? 1 : Math.min(end < 0 ? asks.length : end, MOST_IN_A_BUNDLE));
      underWay++;
      void (bundle.length === 1 ? one(/** @type {Ask} */ (bundle[0])) : together(bundle)).finally(() => {
        underWay--;
        send();
      });
    }
  }

  /** @param {Ask} ask */
  const one = ({ address, signal, resolve, reject }) => fetchFile(address, signal).then(resolve, reject);

  /** @param {readonly Ask[]} bundle */
  async function together(bundle) {
    const stop = new AbortController();
    let left = bundle.length;
    for (const { signal } of bundle) signal.addEventListener("abort", () => --left === 0 && stop.abort());
    const parts = bundle.map(({ address }) => /** @type {RegExpExecArray} */ (PLAIN.exec(address)));
    const names = parts.map(([, boxId, pad, height]) => `${boxId}-${pad}-${height}`);
    const query = new URLSearchParams({ crops: names.join() });
    const versions = parts.flatMap(([, , , , version]) => version ?? []);
    if (versions.length > 0) query.set("v", digestOf(versions));
    try {
      const file = await fetchFile(`/api/v1/boxes/crops?${query}`, stop.signal);
      const contents = unpacked(await file.arrayBuffer());
      for (const [at, ask] of bundle.entries()) {
        const content = contents.get(`${names[at]}.webp`);
        if (content?.length) ask.resolve(new Blob([content], { type: "image/webp" }));
        else if (content) ask.reject(new ApiError(404, { detail: "There is no picture of this box." }, null));
        // Its own response says why.
        else asks.push({ ...ask, isAlone: true });
      }
    } catch (error) {
      for (const { reject } of bundle) reject(error);
    }
  }

  /** @param {string} address @param {AbortSignal} signal @returns {Promise<Blob>} */
  return (address, signal) =>
    new Promise((resolve, reject) => {
      signal.addEventListener("abort", () => reject(signal.reason));
      const isFirst = asks.push({ address, isAlone: !PLAIN.test(address), signal, resolve, reject }) === 1;
      // Others are asked for in the same moment.
      if (isFirst) setTimeout(send);
    });
}

/** A short word for some texts. @param {readonly string[]} texts */
function digestOf(texts) {
  let digest = 0n;
  for (const letter of texts.join())
    digest = (digest * 1099511628211n + BigInt(letter.charCodeAt(0))) & (2n ** 64n - 1n);
  return digest.toString(36);
}

const BLOCK = 512;

/** The files of a tar, by name. @param {ArrayBuffer} tar */
function unpacked(tar) {
  /** @type {Map<string, Uint8Array<ArrayBuffer>>} */
  const files = new Map();
  const text = (/** @type {number} */ at, /** @type {number} */ length) =>
    new TextDecoder().decode(new Uint8Array(tar, at, length)).replace(/\0.*$/s, "");
  for (let at = 0; at + BLOCK <= tar.byteLength && text(at, 100); ) {
    const size = Number.parseInt(text(at + 124, 12), 8);
    files.set(text(at, 100), new Uint8Array(tar, at + BLOCK, size));
    at += BLOCK * (1 + Math.ceil(size / BLOCK));
  }
  return files;
}
