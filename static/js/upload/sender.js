// @ts-check
// Sends frames a few at a time: can be paused, cancelled and resumed, waits while the server
// is away, and lists what was refused in the server's words. Knows no view and no fetch.

import { ApiError, NoAnswer } from "../api.js";
import { createValue } from "../store.js";

/** @typedef {import("./manifest.js").ReadFrame} ReadFrame */
/** @typedef {"sending" | "paused" | "offline" | "busy" | "signed-out" | "done" | "stopped"} Phase */
/** @typedef {{key: string, why: string, more: readonly string[]}} Refusal */

/**
 * @typedef {object} Progress
 * @property {Phase} phase
 * @property {number} total
 * @property {number} stored
 * @property {number} same  the server had them already
 * @property {readonly Refusal[]} refused
 * @property {string} trouble  why everything has stopped, or ""
 */

const WORKERS = 4;
const FIRST_RETRY_S = 1;
const LONGEST_RETRY_S = 30;
/** One frame's refusal says that every other would be refused as well. */
const HOPELESS = [403, 404];

/**
 * @param {readonly ReadFrame[]} frames
 * @param {(frame: ReadFrame, signal: AbortSignal) => Promise<boolean>} put  true when it was stored just now
 * @param {(run: () => void, delayMs: number) => void} [later]
 */
export function createSender(frames, put, later = (run, delayMs) => void setTimeout(run, delayMs)) {
  const queue = [...frames];
  const stop = new AbortController();
  /** @type {Map<string, ReadFrame>} */
  const refusedFrames = new Map();
  const state = createValue(/** @type {Progress} */ ({ phase: "paused", total: frames.length, stored: 0, same: 0, refused: [], trouble: "" }));
  let active = 0;
  let retryS = FIRST_RETRY_S;
  let waits = 0;

  /** @param {Partial<Progress>} some */
  const change = (some) => state.set({ ...state.get(), ...some });

  function fill() {
    while (active < WORKERS && queue.length && state.get().phase === "sending") {
      active++;
      void sendOne(/** @type {ReadFrame} */ (queue.shift()));
    }
    if (active === 0 && queue.length === 0 && state.get().phase === "sending") change({ phase: "done" });
  }

  /** @param {ReadFrame} frame */
  async function sendOne(frame) {
    try {
      const isNew = await put(frame, stop.signal);
      retryS = FIRST_RETRY_S;
      const { stored, same } = state.get();
      change(isNew ? { stored: stored + 1 } : { same: same + 1 });
    } catch (error) {
      if (!stop.signal.aborted) settle(frame, error);
    } finally {
      active--;
      fill();
    }
  }

  /** @param {ReadFrame} frame @param {unknown} error */
  function settle(frame, error) {
    if (error instanceof NoAnswer) return again(frame, "offline", retryS);
    if (error instanceof ApiError) {
      if (error.isTemporary) return again(frame, "busy", error.retryAfterS ?? retryS);
      if (error.status === 401) return again(frame, "signed-out", null);
      if (HOPELESS.includes(error.status)) return end(error.message);
    }
    refusedFrames.set(frame.key, frame);
    change({ refused: [...state.get().refused, refusalOf(frame, error)] });
  }

  /** To be sent once more: after a while, or when somebody says so. @param {ReadFrame} frame @param {Phase} phase @param {number | null} seconds */
  function again(frame, phase, seconds) {
    queue.unshift(frame);
    if (state.get().phase !== "sending") return;
    change({ phase });
    if (seconds === null) return;
    const mine = ++waits;
    retryS = Math.min(retryS * 2, LONGEST_RETRY_S);
    later(() => mine === waits && state.get().phase === phase && resume(), seconds * 1000);
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

    /** What was refused, once more: somebody may have mended its cause. */
    retry() {
      queue.push(...refusedFrames.values());
      refusedFrames.clear();
      change({ refused: [], phase: "sending" });
      fill();
    },
  };
}

/** @typedef {ReturnType<typeof createSender>} Sender */

/** @param {ReadFrame} frame @param {unknown} error @returns {Refusal} */
function refusalOf({ key }, error) {
  if (!(error instanceof ApiError)) return { key, why: error instanceof Error ? error.message : String(error), more: [] };
  const faults = (error.problem.errors ?? []).map(({ pointer = "", detail = "" }) => [pointer, detail].filter(Boolean).join(": "));
  const others = error.problem.more_errors ?? 0;
  if (others > 0) faults.push(`and ${others} more`);
  // A single fault is what the error itself says.
  return { key, why: error.message, more: faults.length > 1 ? faults : [] };
}

/** Frames that are done with, one way or the other. @param {Progress} progress */
export const doneOf = ({ stored, same, refused }) => stored + same + refused.length;

/** @param {Phase} phase */
export const isOver = (phase) => phase === "done" || phase === "stopped";
