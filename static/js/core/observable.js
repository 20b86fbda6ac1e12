// @ts-check
// A value that can be observed.

/**
 * One observable value.
 * @template T
 * @param {T} initial
 */
export function createValue(initial) {
  let value = initial;
  /** @type {Set<(value: T) => void>} */
  const observers = new Set();
  return {
    get: () => value,

    /** @param {T} next */
    set(next) {
      if (Object.is(next, value)) return;
      value = next;
      for (const notify of [...observers]) notify(next);
    },

    /** @param {(value: T) => void} notify @returns {() => void} stop observing */
    observe(notify) {
      observers.add(notify);
      return () => observers.delete(notify);
    },
  };
}

/**
 * @template T
 * @typedef {{get: () => T, set: (next: T) => void, observe: (notify: (value: T) => void) => () => void}} Value
 */
