// @ts-check
// Every store whose boxes may be on show, so that what is learnt of a box reaches all of them.

import { REMOTE } from "./store.js";

/** @typedef {import("./types.js").Decision} Decision */
/** @typedef {{get: (boxId: number) => Decision | undefined, apply: (box: Decision, origin: import("./store.js").Origin) => void}} AnyStore */

/** @param {() => AnyStore | undefined} frameStore the open frame's */
export function createOpenStores(frameStore) {
  /** Stores, and whether a person answers there. @type {Map<AnyStore, boolean>} */
  const lent = new Map();
  const all = () => [...lent.keys(), frameStore()].filter((store) => store !== undefined);
  return {
    /** @param {AnyStore} store @param {{takesAnswers?: boolean}} [how] @returns {() => void} take it back */
    lend(store, { takesAnswers = false } = {}) {
      lent.set(store, takesAnswers);
      return () => lent.delete(store);
    },

    /** How a box is, wherever it is on show. @param {number} boxId */
    find: (boxId) => all().find((store) => store.get(boxId))?.get(boxId),

    /** The store that a person's answer on this box goes to. @param {number} boxId */
    answering: (boxId) => all().find((store) => lent.get(store) !== false && store.get(boxId)),

    /** What the server says of a box. @param {number} boxId @param {(box: Decision) => Decision} change */
    tell(boxId, change) {
      for (const store of all()) {
        const box = store.get(boxId);
        if (box) store.apply(change(box), REMOTE);
      }
    },
  };
}

/** @typedef {ReturnType<typeof createOpenStores>} OpenStores */
