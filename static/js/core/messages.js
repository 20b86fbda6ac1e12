// @ts-check
// What the page says: short messages, the line for screen readers, and the one way to report a failed act.

import { createValue } from "./observable.js";

/** @typedef {{text: string, href?: string, run?: () => void}} ToastAction  a way to go, or something to do */
/** @typedef {{id: number, kind: "info" | "error", text: string, action?: ToastAction}} Toast */

const SHOWN_MS = { info: 4000, error: 12000 };

/** Long enough to read what was done, and to reach the button that undoes it. */
const WITH_ACTION_MS = 9000;
const MOST = 3;

export function createToasts() {
  const list = createValue(/** @type {readonly Toast[]} */ ([]));
  let lastId = 0;

  /** @param {number} id */
  const dismiss = (id) => list.set(list.get().filter((toast) => toast.id !== id));

  return {
    list,
    dismiss,

    /** @returns {number} its id @param {string} text @param {{kind?: "info" | "error", action?: ToastAction}} [how] */
    show(text, { kind = "info", action } = {}) {
      const id = ++lastId;
      const others = list.get().filter((toast) => toast.text !== text);
      list.set([...others, { id, kind, text, action }].slice(-MOST));
      setTimeout(() => dismiss(id), Math.max(SHOWN_MS[kind], action ? WITH_ACTION_MS : 0));
      return id;
    },
  };
}

/** @typedef {ReturnType<typeof createToasts>} Toasts */
