// @ts-check
// Uploads frames, a few at a time: pause, resume, cancel, retry refused frames.

import { ApiError, NoResponse, ask, createRetries, post, whole } from "../core/api.js";
import { createValue } from "../core/observable.js";

/** @typedef {import("./folder.js").Entry} Entry */
/** @typedef {import("./folder.js").ReadFrame} ReadFrame */
/** @typedef {"sending" | "paused" | "offline" | "busy" | "signed-out" | "done" | "stopped"} Phase */
/** @typedef {{key: string, why: string, more: readonly string[]}} Refusal */
/** @typedef {{key: string, answers: number, boxes: readonly string[]}} SetAside */
/**
 * @typedef {{isNew: boolean, answers: number, boxes: readonly string[]}} Stored whether it was stored just now, and the
 *   answers that were set aside
 */

/** The files that a frame may have. */
export const FILE_KINDS = ["image", "segmentation", "depth", "instances", "lidar", "radar", "ignore_mask"];

/**
 * @typedef {object} Progress
 * @property {Phase} phase
 * @property {number} total
 * @property {number} stored
 * @property {number} same  the server had them already
 * @property {readonly Refusal[]} refused
 * @property {readonly SetAside[]} setAside  replaced frames with answers on boxes that changed or are gone
 * @property {string} trouble  why everything has stopped, or ""
 */

const WORKERS = 4;

/**
 * Whether every other frame would be refused as well. Not if a frame may not be replaced because of other people's
 * answers: that concerns this frame only.
 * @param {ApiError} error
 */
const concernsAll = ({ status, problem }) => [403, 404].includes(status) && problem.code !== "others_answers";

/**
 * @param {readonly ReadFrame[]} frames
 * @param {(frame: ReadFrame, signal: AbortSignal) => Promise<Stored>} put
 * @param {import("../core/api.js").Later} [later]
 */
export function createUploader(frames, put, later) {
  const queue = [...frames];
  const stop = new AbortController();
  /** @type {Map<string, ReadFrame>} */
  const refusedFrames = new Map();
  const state = createValue(
    /** @type {Progress} */ ({
      phase: "paused",
      total: frames.length,
      stored: 0,
      same: 0,
      refused: [],
      setAside: [],
      trouble: "",
    }),
  );
  let active = 0;
  const retries = createRetries(later);

  /** @param {Partial<Progress>} some */
  const change = (some) => state.set({ ...state.get(), ...some });

  function fill() {
    while (active < WORKERS && queue.length && state.get().phase === "sending") {
      active++;
      void sendOne(/** @type {ReadFrame} */ (queue.shift()));
    }
    if (active === 0 && queue.length === 0 && ["sending", "paused"].includes(state.get().phase))
      change({ phase: "done" });
  }

  /** @param {ReadFrame} frame */
  async function sendOne(frame) {
    await put(frame, stop.signal).then(
      (stored) => count(frame, stored),
      (error) => stop.signal.aborted || afterError(frame, error),
    );
    active--;
    fill();
  }

  /** @param {ReadFrame} frame @param {Stored} ended */
  function count({ key }, { isNew, answers, boxes }) {
    retries.reset();
    const { stored, same, setAside } = state.get();
    change(isNew ? { stored: stored + 1 } : { same: same + 1 });
    if (answers) change({ setAside: [...setAside, { key, answers, boxes }] });
  }

  /** @param {ReadFrame} frame @param {Error} error */
  function afterError(frame, error) {
    if (error instanceof NoResponse) return retryLater(frame, "offline");
    if (error instanceof ApiError) {
      if (error.isTemporary) return retryLater(frame, "busy", error.retryAfterS);
      if (error.status === 401) return putBack(frame, "signed-out");
      if (concernsAll(error)) return end(error.message);
    }
    refusedFrames.set(frame.key, frame);
    change({ refused: [...state.get().refused, refusalOf(frame, error)] });
  }

  /**
   * Queue a frame again; everything waits in this phase.
   * @param {ReadFrame} frame
   * @param {Phase} phase
   * @returns {boolean} whether the wait begins now
   */
  function putBack(frame, phase) {
    queue.unshift(frame);
    if (state.get().phase !== "sending") return false;
    change({ phase });
    return true;
  }

  /** @param {ReadFrame} frame @param {Phase} phase @param {number | null} [seconds]  as the server has asked */
  function retryLater(frame, phase, seconds) {
    if (putBack(frame, phase)) retries.wait(() => state.get().phase === phase && resume(), seconds);
  }

  function resume() {
    if (!["paused", "offline", "busy", "signed-out"].includes(state.get().phase)) return;
    change({ phase: "sending" });
    fill();
  }

  /** @param {string} trouble */
  function end(trouble) {
    queue.length = 0;
    change({ phase: "stopped", trouble });
    stop.abort();
  }

  return {
    state,
    resume,
    pause: () => change({ phase: "paused" }),
    cancel: () => end(""),

    /** Send refused frames again: the cause may have been fixed. */
    retry() {
      queue.push(...refusedFrames.values());
      refusedFrames.clear();
      change({ refused: [], phase: "sending" });
      fill();
    },
  };
}

/** @typedef {ReturnType<typeof createUploader>} Uploader */

/** @param {ReadFrame} frame @param {Error} error @returns {Refusal} */
function refusalOf({ key }, error) {
  if (!(error instanceof ApiError)) return { key, why: error.message, more: [] };
  const faults = (error.problem.errors ?? []).map(({ pointer = "", detail = "" }) =>
    [pointer, detail].filter(Boolean).join(": "),
  );
  const others = error.problem.more_errors ?? 0;
  if (others > 0) faults.push(`and ${others} more`);
  // A single fault is what the error itself says.
  return { key, why: error.message, more: faults.length > 1 ? faults : [] };
}

/** How many frames were stored, were there already, or were refused. @param {Progress} progress */
export const doneOf = ({ stored, same, refused }) => stored + same + refused.length;

/** @param {Phase} phase */
export const isOver = (phase) => phase === "done" || phase === "stopped";

const BUSY_MS = 12;

/** Lets the browser draw, if it has been kept from it for a while. */
export function createPauses() {
  let since = performance.now();
  return async () => {
    if (performance.now() - since < BUSY_MS) return;
    await new Promise((resolve) => setTimeout(resolve));
    since = performance.now();
  };
}

/**
 * A file whose size and content can be asked for. Throws if it has been removed since it was picked.
 * @param {Entry} entry
 */
export const opened = ({ open, path }) => open().catch(() => Promise.reject(noLongerThere(path)));

/**
 * The content of a file. Throws if the file has been changed or removed since it was picked.
 * @param {Entry} entry @param {number} [most]  bytes
 */
export async function contentOf(entry, most = Infinity) {
  const blob = await opened(entry);
  const part = most === Infinity ? blob : blob.slice(0, most);
  const content = await part.arrayBuffer().catch(() => Promise.reject(noLongerThere(entry.path)));
  return new Uint8Array(content);
}

/** @param {string} path */
const noLongerThere = (path) => new Error(`${path} can no longer be read: it was changed or removed`);

/** @param {ReadFrame} frame */
async function formOf({ annotation, text, files }) {
  const form = new FormData();
  // The text has every digit of ids that are no numbers of JavaScript.
  const json = text ?? JSON.stringify(annotation);
  form.append("annotation", new Blob([json], { type: "application/json" }), "annotation.json");
  for (const kind of FILE_KINDS) {
    const entry = files[kind];
    if (entry) form.append(kind, new Blob([await contentOf(entry)]), kind);
  }
  return form;
}

export const uploadCalls = {
  /** @param {import("../core/openapi.js").DatasetIn} dataset */
  createDataset: (dataset) => post("/api/v1/datasets", { body: dataset }),

  /**
   * @param {string} dataset @param {ReadFrame} frame @param {boolean} replace  other content becomes the next revision
   * @param {AbortSignal} signal @returns {Promise<Stored>}
   */
  async putFrame(dataset, frame, replace, signal) {
    const body = await formOf(frame);
    const response = await ask("put", "/api/v1/datasets/{dataset}/frames/{key}", {
      path: { dataset, key: frame.key },
      query: { replace },
      body,
      signal,
    });
    /** @type {import("../core/openapi.js").StoredFrame | null} */
    const stored = replace ? await whole(response.json(), signal) : null;
    return {
      isNew: response.status === 201,
      answers: stored?.answers_set_aside ?? 0,
      boxes: stored?.boxes_set_aside ?? [],
    };
  },
};

/** @typedef {typeof uploadCalls} UploadCalls */
/** @typedef {{dataset: string, uploader: Uploader}} Job */
/** @typedef {import("../core/openapi.js").DatasetIn} DatasetIn */
/**
 * @typedef {object} Order
 * @property {string} dataset
 * @property {boolean} isNew
 * @property {string[] | null} classes
 * @property {Partial<DatasetIn>} reading  settings of a new dataset
 * @property {NonNullable<DatasetIn["config"]>} config  keys of a new dataset's first configuration
 * @property {readonly ReadFrame[]} frames
 * @property {boolean} replace
 */

/**
 * @param {UploadCalls} calls
 * @param {import("../core/observable.js").Value<boolean>} isSignedIn
 */
export function createUploads(calls, isSignedIn) {
  const job = createValue(/** @type {Job | null} */ (null));
  /** Files that were dropped or picked, until the upload starts or the dialog is closed. */
  const dropped = createValue(/** @type {Promise<Entry[]> | null} */ (null));
  /** Increases when an upload ends, so that views load their counts again. */
  const ended = createValue(0);

  const isRunning = () => job.get() !== null && !isOver(/** @type {Job} */ (job.get()).uploader.state.get().phase);

  /**
   * Forget these files, which are uploaded or not wanted. Others that were taken since stay: the event
   * that a dialog was closed may come after the next files.
   * @param {Promise<Entry[]> | null} entries
   */
  const discard = (entries) => dropped.get() === entries && dropped.set(null);

  /** @param {Phase} phase what it waited in */
  const resumeFrom = (phase) => job.get()?.uploader.state.get().phase === phase && job.get()?.uploader.resume();

  addEventListener("online", () => resumeFrom("offline"));
  isSignedIn.observe((isIn) => isIn && resumeFrom("signed-out"));
  addEventListener("beforeunload", (event) => isRunning() && event.preventDefault());

  return {
    job,
    dropped,
    ended,
    isRunning,

    /** @param {Promise<Entry[]>} entries */
    take: (entries) => dropped.set(entries),
    discard,

    /** Make the dataset if it is new, then begin; rejects when that is refused. @param {Order} order */
    async start({ dataset, isNew, classes, reading, config, frames, replace }) {
      const entries = dropped.get();
      const first = Object.keys(config).length > 0 && { config };
      if (isNew) await calls.createDataset({ name: dataset, ...(classes && { classes }), ...reading, ...first });
      const uploader = createUploader(frames, (frame, signal) => calls.putFrame(dataset, frame, replace, signal));
      uploader.state.observe(({ phase }) => {
        if (isOver(phase)) ended.set(ended.get() + 1);
        // The session ends where it is refused. If another one has begun meanwhile, it is tried with that one.
        if (phase === "signed-out" && isSignedIn.get()) queueMicrotask(() => resumeFrom(phase));
      });
      discard(entries);
      job.set({ dataset, uploader });
      uploader.resume();
    },

    /** Close the panel of a finished upload. */
    dismiss: () => job.set(null),
  };
}

/** @typedef {ReturnType<typeof createUploads>} Uploads */
/** @typedef {import("../core/app.js").App & {uploads: Uploads}} UploadApp  what views are given that take uploads */
