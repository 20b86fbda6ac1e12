// @ts-check
// Every URL and every fetch. What is not 2xx becomes an ApiError; no answer at all a NoAnswer.
// Calls that one view alone makes are in calls/, built from what is exported here.

/** @typedef {import("./types.js").Dataset} Dataset */
/** @typedef {import("./types.js").Decision} Decision */
/** @typedef {import("./types.js").Frame} Frame */
/** @typedef {import("./types.js").FrameItem} FrameItem */
/** @typedef {import("./types.js").HistoryItem} HistoryItem */
/** @typedef {import("./types.js").StoredReview} StoredReview */
/** @typedef {Record<string, string | number | undefined>} Params */
/** @typedef {{title?: string, detail?: string, code?: string, request_id?: string, current?: Decision, errors?: {pointer?: string, code?: string, detail?: string}[], more_errors?: number}} Problem */

const BASE = "/api/v1";

/** What this page shows to be let in. */
let session = "";

/** @param {string} secret  empty: nothing */
export const showSession = (secret) => void (session = secret);

/** The server answered, and said no. */
export class ApiError extends Error {
  /** @param {number} status @param {Problem} problem @param {number | null} retryAfterS */
  constructor(status, problem, retryAfterS) {
    super(problem.detail || problem.title || `the server answered ${status}`);
    this.name = "ApiError";
    this.status = status;
    this.problem = problem;
    this.retryAfterS = retryAfterS;
  }

  /** May the same request succeed later? */
  get isTemporary() {
    return this.status === 429 || this.status >= 500;
  }
}

/** The server could not be reached. */
export class NoAnswer extends Error {
  /** @param {unknown} cause */
  constructor(cause) {
    super("The server does not answer.", { cause });
    this.name = "NoAnswer";
  }
}

/** @param {string} path @param {Params} [params] */
export function urlOf(path, params = {}) {
  const search = new URLSearchParams();
  for (const [key, value] of Object.entries(params)) {
    if (value !== undefined && value !== "") search.set(key, String(value));
  }
  return `${BASE}${path}${search.size ? `?${search}` : ""}`;
}

/** @param {string} url @param {RequestInit} [init] @returns {Promise<Response>} only what succeeded */
export async function send(url, init = {}) {
  const headers = new Headers(init.headers);
  if (session && !headers.has("Authorization")) headers.set("Authorization", `Bearer ${session}`);
  const response = await fetch(url, { credentials: "omit", ...init, headers }).catch((cause) => {
    if (init.signal?.aborted) throw cause;
    throw new NoAnswer(cause);
  });
  if (!response.ok) throw new ApiError(response.status, problemOf(await response.text()), retryAfterOf(response));
  return response;
}

/**
 * @param {string} url @param {RequestInit} [init]
 * @returns {Promise<any>} the JSON of the answer; undefined when it has none
 */
export async function request(url, init = {}) {
  const text = await (await send(url, init)).text();
  return text ? JSON.parse(text) : undefined;
}

/** @param {string} text @returns {Problem} */
function problemOf(text) {
  try {
    return JSON.parse(text);
  } catch {
    return {};
  }
}

/** @param {Response} response */
function retryAfterOf(response) {
  const seconds = Number(response.headers.get("Retry-After") ?? NaN);
  return Number.isFinite(seconds) ? seconds : null;
}

/** @param {string} path @param {unknown} body @param {string} [idempotencyKey] */
export function post(path, body, idempotencyKey) {
  /** @type {Record<string, string>} */
  const headers = { "Content-Type": "application/json" };
  if (idempotencyKey) headers["Idempotency-Key"] = idempotencyKey;
  return request(urlOf(path), { method: "POST", headers, body: JSON.stringify(body) });
}

/** @param {string} name */
export const segment = (name) => encodeURIComponent(name);

export const api = {
  /** @param {import("./types.js").Credential} credential @returns {Promise<import("./types.js").NewSession>} */
  signIn: (credential) => post("/session", credential),

  /** @returns {Promise<import("./types.js").Person>} */
  whoAmI: () => request(urlOf("/session")),

  /** @param {string} secret  of the session that ends @returns {Promise<void>} */
  signOut: (secret) => request(urlOf("/session"), { method: "DELETE", headers: { Authorization: `Bearer ${secret}` } }),

  /** @param {Params} [params] @param {AbortSignal} [signal] @returns {Promise<import("./types.js").Page<Dataset>>} */
  datasets: (params, signal) => request(urlOf("/datasets", params), { signal }),

  /** @param {string} name @param {AbortSignal} [signal] @returns {Promise<Dataset>} */
  dataset: (name, signal) => request(urlOf(`/datasets/${segment(name)}`), { signal }),

  /** @param {string} name @param {Params} params @param {AbortSignal} [signal] @returns {Promise<import("./types.js").Page<FrameItem>>} */
  frames: (name, params, signal) => request(urlOf(`/datasets/${segment(name)}/frames`, params), { signal }),

  /** @param {number | string} id @param {AbortSignal} [signal] @returns {Promise<Frame>} */
  frame: (id, signal) => request(urlOf(`/frames/${segment(String(id))}`), { signal }),

  /** @param {number} boxId @param {AbortSignal} [signal] @returns {Promise<Decision>} */
  box: (boxId, signal) => request(urlOf(`/boxes/${boxId}`), { signal }),

  /** @param {number} boxId @param {AbortSignal} [signal] @returns {Promise<{items: HistoryItem[]}>} */
  history: (boxId, signal) => request(urlOf(`/boxes/${boxId}/history`), { signal }),

  /**
   * @param {number} boxId @param {{verdict: string, comment: string, seen_revision: number}} answer
   * @param {string} idempotencyKey @returns {Promise<StoredReview>}
   */
  review: (boxId, answer, idempotencyKey) => post(`/boxes/${boxId}/reviews`, answer, idempotencyKey),

  /** @param {number} id */
  thumbnailUrl: (id) => urlOf(`/frames/${id}/thumbnail`),

  /** @param {Frame} frame @param {"image" | "segmentation"} kind */
  fileUrl: (frame, kind) => frame.files?.[kind]?.url ?? urlOf(`/frames/${frame.id}/${kind}`),

  /** The segmentation painted in its palette, whatever its file's encoding. @param {number} id */
  paintedUrl: (id) => `${BASE}/frames/${id}/overlay?layer=segmentation&boxes=`,

  /** @param {string} url @param {AbortSignal} [signal] @returns {Promise<Blob>} */
  blob: async (url, signal) => (await send(url, { signal })).blob(),
};

/** @typedef {typeof api} Api */
