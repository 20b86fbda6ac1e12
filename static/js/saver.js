// @ts-check
// Sends answers, one at a time, in order, until the server has them. An observer of changes
// that a person makes; knows no view and no undo.

import { ApiError, NoAnswer } from "./api.js";
import { REMOTE, createValue } from "./store.js";
import { seenRevision } from "./reviews.js";

/** @typedef {import("./outbox.js").Outbox} Outbox */
/** @typedef {import("./outbox.js").QueuedAnswer} QueuedAnswer */
/** @typedef {import("./types.js").Decision} Decision */
/** @typedef {import("./types.js").StoredReview} StoredReview */
/** @typedef {"saved" | "saving" | "offline" | "signed-out" | "busy"} Phase */
/** @typedef {{phase: Phase, waiting: ReadonlySet<number>}} SaverState  `waiting`: the boxes */

/**
 * @typedef {object} SaverEvents
 * @property {(stored: StoredReview, isLatest: boolean) => void} onStored
 * @property {(item: QueuedAnswer, current: Decision | undefined) => void} onConflict  somebody else was first
 * @property {(item: QueuedAnswer, error: Error) => void} onRefused  will never be stored
 */

const FIRST_RETRY_S = 1;
const LONGEST_RETRY_S = 30;

/**
 * @param {Outbox} outbox
 * @param {(boxId: number, answer: {verdict: string, comment: string, seen_revision: number}, key: string) => Promise<StoredReview>} send
 * @param {SaverEvents} events
 * @param {(run: () => void, delayMs: number) => void} [later]
 */
export function createSaver(outbox, send, events, later = (run, delayMs) => void setTimeout(run, delayMs)) {
  /** @type {import("./store.js").Value<SaverState>} */
  const state = createValue(stateNow("saved"));
  let isSending = false;
  /** Somebody said that it may work now, while an attempt from before was still failing. */
  let isWorthTrying = false;
  let retryS = FIRST_RETRY_S;
  let retries = 0;

  /** @param {Phase} phase @returns {SaverState} */
  function stateNow(phase) {
    const waiting = new Set(outbox.items().map(({ boxId }) => boxId));
    return { phase: waiting.size ? phase : "saved", waiting };
  }

  /** @param {Phase} phase */
  const show = (phase) => state.set(stateNow(phase));

  async function drain() {
    if (isSending) return;
    isSending = true;
    try {
      for (let item = outbox.items()[0]; item; item = outbox.items()[0]) {
        show("saving");
        if (!(await deliver(item))) return;
        retryS = FIRST_RETRY_S;
      }
      show("saved");
    } finally {
      isSending = false;
    }
  }

  /** @param {QueuedAnswer} item @returns {Promise<boolean>} go on with the next? */
  async function deliver(item) {
    const { boxId, verdict, comment, seenRevision: seen_revision } = item;
    outbox.markAttempted(item);
    try {
      const stored = await send(boxId, { verdict, comment, seen_revision }, item.key);
      outbox.remove(item);
      outbox.rebase(boxId, stored.revision);
      events.onStored(stored, !stateNow("saving").waiting.has(boxId));
      return true;
    } catch (error) {
      return settle(item, error);
    }
  }

  /** @param {QueuedAnswer} item @param {unknown} error */
  function settle(item, error) {
    if (error instanceof NoAnswer) return waitAndRetry("offline", retryS);
    if (!(error instanceof ApiError)) throw error;
    if (error.status === 401) {
      show("signed-out");
      return false;
    }
    if (error.isTemporary) return waitAndRetry("busy", error.retryAfterS ?? retryS);
    outbox.remove(item);
    if (error.status === 412) events.onConflict(item, error.problem.current);
    else events.onRefused(item, error);
    return true;
  }

  /** @param {Phase} phase @param {number} seconds */
  function waitAndRetry(phase, seconds) {
    show(phase);
    const mine = ++retries;
    const wait = isWorthTrying ? 0 : seconds;
    isWorthTrying = false;
    retryS = Math.min(retryS * 2, LONGEST_RETRY_S);
    later(() => mine === retries && void drain(), wait * 1000);
    return false;
  }

  return {
    state,

    /** @param {import("./store.js").Change} change */
    notice({ origin, before, after }) {
      if (origin === REMOTE) return;
      const verdict = after.review?.verdict ?? "clear";
      const comment = after.review?.comment ?? "";
      outbox.add({ boxId: after.box_id, frameId: after.frame_id, verdict, comment, seenRevision: seenRevision(before) });
      show(state.get().phase === "saved" ? "saving" : state.get().phase);
      if (state.get().phase !== "signed-out") void drain();
    },

    /** Try now: the network is back, or somebody has signed in. */
    resume() {
      isWorthTrying = isSending;
      retryS = FIRST_RETRY_S;
      return drain();
    },

    /** What waits for a frame's boxes, so that a reloaded page still shows it. @param {number} frameId */
    waitingFor: (frameId) => outbox.items().filter((item) => item.frameId === frameId),
  };
}

/** @typedef {ReturnType<typeof createSaver>} Saver */
