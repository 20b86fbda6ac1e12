// @ts-check
// get, post, put, patch, remove, url, blob: every request, typed by the generated schema; ApiError and NoAnswer.

/** @typedef {import("./types.js").ConfigBody} ConfigBody */
/** @typedef {import("./types.js").ConfigVersion} ConfigVersion */
/** @typedef {import("./types.js").Dataset} Dataset */
/** @typedef {import("./types.js").Decision} Decision */
/** @typedef {import("./types.js").Export} Export */
/** @typedef {import("./types.js").Frame} Frame */
/** @typedef {import("./types.js").FrameItem} FrameItem */
/** @typedef {import("./types.js").HistoryItem} HistoryItem */
/** @typedef {import("./types.js").Preview} Preview */
/** @typedef {import("./types.js").Run} Run */
/** @typedef {import("./types.js").RunDiff} RunDiff */
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
/** @typedef {{id: number, key: string, error: {title?: string, detail?: string}, created_at: string}} ProblemItem  a frame that was refused */

export const datasetCalls = {
  /** @param {string} name @param {AbortSignal} [signal] @returns {Promise<import("./types.js").Page<ProblemItem>>} */
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

/** Half a percent each: the step of a threshold. */
export const BINS = 200;

/** @param {string} dataset @param {string} rest */
const pathOf = (dataset, rest) => `/datasets/${segment(dataset)}/${rest}`;

export const jobs = {
  /** The configuration that decides now. @param {string} dataset @param {AbortSignal} [signal] @returns {Promise<ConfigVersion>} */
  activeConfig: (dataset, signal) => request(urlOf(pathOf(dataset, "config")), { signal }),

  /** @param {string} dataset @param {Params} params @param {AbortSignal} [signal] @returns {Promise<import("./types.js").Page<ConfigVersion>>} */
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

  /** @param {string} dataset @param {Params} params @param {AbortSignal} [signal] @returns {Promise<import("./types.js").Page<Run>>} */
  runs: (dataset, params, signal) => request(urlOf(pathOf(dataset, "runs"), params), { signal }),

  /** @param {number} id @param {AbortSignal} [signal] @returns {Promise<Run>} */
  run: (id, signal) => request(urlOf(`/runs/${id}`), { signal }),

  /** @param {number} id @returns {Promise<Run>} */
  cancelRun: (id) => post(`/runs/${id}/cancel`, {}),

  /** @param {number} id @param {Params} params @param {AbortSignal} [signal] @returns {Promise<RunDiff>} */
  diff: (id, params, signal) => request(urlOf(`/runs/${id}/diff`, params), { signal }),

  /** @param {number} id */
  eventsUrl: (id) => urlOf(`/runs/${id}/events`),

  /** @param {string} dataset @param {Params} params @param {AbortSignal} [signal] @returns {Promise<import("./types.js").Page<Export>>} */
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

/** @param {string} dataset @param {{truth: string, target: string}} asked  people or instances; f1 or recall @param {AbortSignal} [signal] @returns {Promise<import("./types.js").Quality>} */
export const loadQuality = (dataset, asked, signal) =>
  request(urlOf(`/datasets/${segment(dataset)}/quality`, asked), { signal });

/** @param {string} dataset @param {string} truth  instances or people @param {AbortSignal} [signal] @returns {Promise<import("./types.js").Evaluation>} */
export const loadEvaluation = (dataset, truth, signal) =>
  request(urlOf(`/datasets/${segment(dataset)}/evaluations`, { truth }), { signal });

/** Measure every channel that the frames' files allow. @param {string} dataset @returns {Promise<import("./types.js").Run>} */
export const startEvaluation = (dataset) => post(`/datasets/${segment(dataset)}/evaluations`, {});

/** @typedef {import("./types.js").Decision & {claim: {expires_at: string}}} QueuedBox */
/** @typedef {{items: QueuedBox[], remaining: number, unsure: number, claimed_by_others: number}} QueueOut */
/** @typedef {{order: string, filters: Record<string, string | number | boolean>, limit: number, exclude: readonly number[]}} QueueRequest */
