// @ts-check
// Short messages that come and go. State only; views/toast.js draws it.

import { createValue } from "./store.js";

/** @typedef {{text: string, href: string}} ToastAction */
/** @typedef {{id: number, kind: "info" | "error", text: string, action?: ToastAction}} Toast */

const SHOWN_MS = { info: 4000, error: 12000 };
const MOST = 3;

export function createToasts() {
  const list = createValue(/** @type {readonly Toast[]} */ ([]));
  let lastId = 0;

  /** @param {number} id */
  const dismiss = (id) => list.set(list.get().filter((toast) => toast.id !== id));

  return {
    list,
    dismiss,

    /** @param {string} text @param {{kind?: "info" | "error", action?: ToastAction}} [how] */
    show(text, { kind = "info", action } = {}) {
      const id = ++lastId;
      const others = list.get().filter((toast) => toast.text !== text);
      list.set([...others, { id, kind, text, action }].slice(-MOST));
      setTimeout(() => dismiss(id), SHOWN_MS[kind]);
    },
  };
}
