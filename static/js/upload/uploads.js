// @ts-check
// The upload that is going on, if there is one: it outlives the view it was started from.

import { createValue } from "../store.js";
import { createSender, isOver } from "./sender.js";

/** @typedef {import("./manifest.js").ReadFrame} ReadFrame */
/** @typedef {import("./matching.js").Entry} Entry */
/** @typedef {{dataset: string, sender: import("./sender.js").Sender}} Job */
/** @typedef {{dataset: string, isNew: boolean, classes: string[] | null, reading: Record<string, string>, frames: readonly ReadFrame[], replace: boolean}} Order */

/**
 * @param {import("../calls/uploads.js").UploadCalls} calls
 * @param {import("../store.js").Value<boolean>} isSignedIn
 */
export function createUploads(calls, isSignedIn) {
  const job = createValue(/** @type {Job | null} */ (null));
  /** What was dropped or picked, until it is sent or put away. */
  const dropped = createValue(/** @type {Promise<Entry[]> | null} */ (null));
  /** Grows when an upload ends: what is counted then is no longer true. */
  const ended = createValue(0);

  const isRunning = () => job.get() !== null && !isOver(/** @type {Job} */ (job.get()).sender.state.get().phase);

  /** @param {import("./sender.js").Phase} phase what it waited in */
  const resumeFrom = (phase) => job.get()?.sender.state.get().phase === phase && job.get()?.sender.resume();

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

    /** Make the dataset if it is new, then begin; rejects when that is refused. @param {Order} order */
    async start({ dataset, isNew, classes, reading, frames, replace }) {
      if (isNew) await calls.createDataset({ name: dataset, ...(classes && { classes }), ...reading });
      const sender = createSender(frames, (frame, signal) => calls.putFrame(dataset, frame, replace, signal));
      sender.state.observe(({ phase }) => {
        if (isOver(phase)) ended.set(ended.get() + 1);
        if (phase === "signed-out") isSignedIn.set(false);
      });
      dropped.set(null);
      job.set({ dataset, sender });
      sender.resume();
    },

    /** Take the finished one off the screen. */
    dismiss: () => job.set(null),
  };
}

/** @typedef {ReturnType<typeof createUploads>} Uploads */
