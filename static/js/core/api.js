// @ts-check
// Every call of the API goes through here. Paths, parameters, bodies and responses are type-checked against
// openapi.d.ts.

import { createValue } from "./observable.js";

/** @import { Decision, paths as Paths } from "./openapi.js" */
/** @typedef {"get" | "post" | "put" | "patch" | "delete"} Method */
/**
 * @typedef {Partial<Omit<import("./openapi.js").Problem, "current">> & {current?: Decision |
 *   null}} Problem of a 412, `current` is the box as it is now
 */

/**
 * The paths that have an operation of this method.
 * @template {Method} M
 * @typedef {{[P in keyof Paths]: Paths[P] extends Record<M, {responses: unknown}> ? P : never}[keyof Paths]} PathOf
 */

/**
 * @template {Method} M @template {PathOf<M>} P
 * @typedef {Extract<Paths[P][M], {parameters: unknown, responses: unknown}>} Operation
 */

/**
 * JSON where the operation takes JSON; else a form, or a file whose type is the body's.
 * @template O
 * @typedef {O extends {requestBody: {content: {"application/json": infer B}}} ? {body: B}
 *   : O extends {requestBody: {content: {"multipart/form-data": unknown}}} ? {body: FormData}
 *   : O extends {requestBody: unknown} ? {body: Blob} : {body?: undefined}} Body
 */

/**
 * What a call is given: parameters and body by the description. `key` makes a repeated POST the same one
 * (Idempotency-Key); `session` is sent in place of the page's own; `signal` abandons the call.
 * @template {Method} M @template {PathOf<M>} P
 * @typedef {Pick<Operation<M, P>["parameters"], "path" | "query"> & Body<Operation<M, P>> & {key?: string, session?:
 *   string, signal?: AbortSignal}} Given
 */

/**
 * The JSON of the response to a call; nothing where there is none.
 * @template {Method} M @template {PathOf<M>} P
 * @typedef {{[S in 200 | 201 | 202]: Operation<M, P>["responses"] extends Record<S, {content: {"application/json":
 *   infer A}}> ? A : never}[200 | 201 | 202]} ApiResponse
 */

/**
 * The last argument of a call, which can be left out where nothing has to be given.
 * @template G
 * @typedef {{} extends G ? [given?: G] : [given: G]} Rest
 */

/** The session's secret, sent with every request. */
let session = "";
/** @type {(error: ApiError) => void} */
let onSignedOut = () => {};

/** A word of the session that pictures have in their addresses; it is no secret. */
let pictures = "";

/**
 * Set the secret of the session that requests are sent with.
 * @param {string} secret empty: none
 * @param {string} [word] of its pictures
 */
export const setSession = (secret, word = "") => void ([session, pictures] = [secret, word]);

/** Set who is told when the server no longer accepts the session. @param {(error: ApiError) => void} tell */
export const whenSignedOut = (tell) => void (onSignedOut = tell);

/** Whether the server has responded to the last request. */
export const isReached = createValue(true);

/** The server responded, and refused. */
export class ApiError extends Error {
  /** @param {number} status @param {Problem} problem @param {number | null} retryAfterS */
  constructor(status, problem, retryAfterS) {
    super(problem.detail || problem.title || `the server responded with ${status}`);
    this.name = "ApiError";
    this.status = status;
    this.problem = problem;
    this.retryAfterS = retryAfterS;
  }

  /** May the same request succeed later? */
  get isTemporary() {
    // 408: the server did not get the request in time.
    return this.status === 408 || this.status === 429 || this.status >= 500;
  }
}

/** The server could not be reached, or its response broke off or cannot be read. */
export class NoResponse extends Error {
  /** @param {unknown} cause */
  constructor(cause) {
    super("The server does not answer.", { cause });
    this.name = "NoResponse";
  }
}

/** May the same request succeed later, without a person's doing? @param {unknown} error */
export const mayPass = (error) => error instanceof NoResponse || (error instanceof ApiError && error.isTemporary);

const FIRST_RETRY_S = 1;
const LONGEST_RETRY_S = 30;

/** @typedef {(run: () => void, delayMs: number) => void} Later */

/**
 * When to try again what the server could not take: after a second, then after twice as long each time, up to half a
 * minute.
 * @param {Later} [later]
 */
export function createRetries(later = (run, delayMs) => void setTimeout(run, delayMs)) {
  let nextS = FIRST_RETRY_S;
  let waits = 0;
  let isNextSkipped = false;
  return {
    /**
     * @param {() => void} run not called if another wait has begun since
     * @param {number | null} [seconds] to wait instead, as the server has asked
     */
    wait(run, seconds) {
      const mine = ++waits;
      later(() => mine === waits && run(), isNextSkipped ? 0 : (seconds ?? nextS) * 1000);
      nextS = Math.min(nextS * 2, LONGEST_RETRY_S);
      isNextSkipped = false;
    },

    /**
     * The next wait is the shortest again, and not skipped: the server has taken something, or somebody asks to try
     *   now.
     */
    reset() {
      nextS = FIRST_RETRY_S;
      isNextSkipped = false;
    },

    /**
     * The next wait is none: somebody asks to try now, while a request is under way. If that fails, it is sent again at
     *   once.
     */
    skipNext: () => void (isNextSkipped = true),
  };
}

/**
 * Fetch from this server. If the server responds with 401 to the page's own session, the callback of `whenSignedOut` is
 * called.
 * @param {string} address @param {RequestInit} [init] @param {string} [shown]  the session, empty for none
 * @returns {Promise<Response>} a successful response; anything else is thrown as ApiError or NoResponse
 */
export async function send(address, init = {}, shown = session) {
  const headers = new Headers(init.headers);
  if (shown) headers.set("Authorization", `Bearer ${shown}`);
  const response = await whole(fetch(address, { credentials: "omit", ...init, headers }), init.signal);
  isReached.set(true);
  if (response.ok) return response;
  const seconds = Number(response.headers.get("Retry-After") ?? NaN);
  const error = new ApiError(
    response.status,
    problemOf(await whole(response.text(), init.signal)),
    Number.isFinite(seconds) ? seconds : null,
  );
  if (response.status === 401 && shown && shown === session) onSignedOut(error);
  throw error;
}

/**
 * A response or its body. If it does not come, breaks off, or cannot be read, there is no response: the same request
 * may succeed later. (A request that was abandoned is left as it is.)
 * @template T @param {Promise<T>} part @param {AbortSignal | null} [signal] @returns {Promise<T>}
 */
export const whole = (part, signal) =>
  part.catch((cause) => {
    if (signal?.aborted) throw cause;
    isReached.set(false);
    throw new NoResponse(cause);
  });

/** @param {string} text @returns {Problem} */
function problemOf(text) {
  try {
    return JSON.parse(text);
  } catch {
    return {};
  }
}

/** @typedef {string | number | boolean | null | undefined} Parameter  one that is empty or not set is not sent */

/** @param {string} path @param {{path?: Record<string, string | number>, query?: Record<string, Parameter>}} [given] */
function addressOf(path, { path: named = {}, query = {} } = {}) {
  const filled = path.replace(/\{(\w+)\}/g, (_, name) => {
    const text = encodeURIComponent(named[name] ?? "");
    // A frame's key may be a path itself.
    return name === "key" ? text.replaceAll("%2F", "/") : text;
  });
  // The browser would resolve these parts: the request would go to another address.
  if (/\/\.\.?(\/|$)/.test(filled)) throw new ApiError(404, { detail: `There is nothing at ${filled}.` }, null);
  const set = Object.entries(query).flatMap(([key, value]) =>
    value === undefined || value === null || value === "" ? [] : [[key, String(value)]],
  );
  return filled + (set.length > 0 ? `?${new URLSearchParams(set)}` : "");
}

/**
 * The address of a file, such as a picture, which is read otherwise.
 * @template {PathOf<"get">} P
 * @param {P} path @param {Rest<Pick<Operation<"get", P>["parameters"], "path" | "query">>} given
 */
export const url = (path, ...[given]) => addressOf(path, given);

/**
 * The address of a drawn picture. A browser keeps it for the whole session: a box or a frame never gets another
 * picture, but another server, or a new one at this address, may have other frames under the same numbers.
 * @template {"/api/v1/boxes/{box_id}/crop" | "/api/v1/frames/{frame_id}/thumbnail"} P
 * @param {P} path @param {Pick<Operation<"get", P>["parameters"], "path" | "query">} given
 * @param {string} [version] what else it depends on
 */
export const pictureUrl = (path, given, version = "") =>
  addressOf(path, { ...given, query: { ...given.query, v: pictures && pictures + version } });

/** @param {string} address @param {AbortSignal} [signal] @returns {Promise<Blob>} */
export const blob = async (address, signal) => whole((await send(address, { signal })).blob(), signal);

/** The JSON at an address that is no path of the API. @param {string} address @returns {Promise<any>} */
export const json = async (address) => whole((await send(address)).json());

/**
 * @typedef {{path?: Record<string, string | number>, query?: Record<string, Parameter>, body?: unknown, key?: string,
 *   session?: string, signal?: AbortSignal}} AnyGiven
 */

/** @param {string} method @param {string} path @param {AnyGiven} [given] */
function respond(method, path, { body, key, signal, session: shown, ...where } = {}) {
  const headers = new Headers();
  const isJson = body !== undefined && !(body instanceof FormData) && !(body instanceof Blob);
  if (isJson) headers.set("Content-Type", "application/json");
  if (key) headers.set("Idempotency-Key", key);
  // What is deleted stays so when the page is left: a session that ends before the page is loaded again.
  const keepalive = method === "DELETE";
  return send(
    addressOf(path, where),
    { method, headers, signal, keepalive, body: isJson ? JSON.stringify(body) : body },
    shown,
  );
}

/** @param {string} method @param {string} path @param {AnyGiven} [given] */
async function call(method, path, given) {
  const response = await respond(method, path, given);
  return whole(
    response.text().then((text) => (text ? JSON.parse(text) : undefined)),
    given?.signal,
  );
}

/**
 * The response itself, for those who need its status, or read it while it comes.
 * @template {Method} M @template {PathOf<M>} P
 * @param {M} method @param {P} path @param {Rest<Given<M, P>>} given @returns {Promise<Response>}
 */
export const ask = (method, path, ...[given]) => respond(method.toUpperCase(), path, given);

/**
 * @template {Method} M
 * @typedef {<P extends PathOf<M>>(path: P, ...given: Rest<Given<M, P>>) => Promise<ApiResponse<M, P>>} Call
 */

/** @type {Call<"get">} */
export const get = (path, ...[given]) => call("GET", path, given);

/** @type {Call<"post">} */
export const post = (path, ...[given]) => call("POST", path, given);

/** @type {Call<"put">} */
export const put = (path, ...[given]) => call("PUT", path, given);

/** @type {Call<"patch">} */
export const patch = (path, ...[given]) => call("PATCH", path, given);

/** @type {<P extends PathOf<"delete">>(path: P, ...given: Rest<Given<"delete", P>>) => Promise<void>} */
export const remove = (path, ...[given]) => call("DELETE", path, given);
