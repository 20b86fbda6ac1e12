// @ts-check
// Values that can be observed, and values that are loaded when they are first asked for.

/** One observable value. @template T @param {T} initial */
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

/**
 * Something that is loaded when it is first asked for.
 * @template T
 * @typedef {{value: T | undefined, get: (signal?: AbortSignal) => Promise<T>}} Lazy `value` is undefined until it is
 *   there
 */

/**
 * One request serves all who ask. It is aborted when everybody who asked has gone; after that,
 * or when it has failed, the next who asks starts another one.
 * @template T @param {(signal: AbortSignal) => Promise<T>} request @returns {Lazy<T>}
 */
export function createLazy(request) {
  /** @type {{coming: Promise<T>, stop: AbortController, askers: number} | null} */
  let running = null;

  function start() {
    const stop = new AbortController();
    const started = { coming: request(stop.signal), stop, askers: 0 };
    started.coming.then(
      (value) => void (lazy.value = value),
      () => end(started),
    );
    return started;
  }

  /** @param {typeof running} one */
  function end(one) {
    if (running === one) running = null;
  }

  const lazy = {
    value: /** @type {T | undefined} */ (undefined),

    /** @param {AbortSignal} [signal]  without one, the request is never aborted */
    get(signal) {
      const asked = (running ??= start());
      asked.askers += 1;
      signal?.addEventListener("abort", () => {
        asked.askers -= 1;
        if (asked.askers > 0 || lazy.value !== undefined) return;
        end(asked);
        asked.stop.abort();
      });
      return asked.coming;
    },
  };
  return lazy;
}
