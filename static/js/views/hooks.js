// @ts-check
// How views read what can change.

import { useCallback, useEffect, useLayoutEffect, useMemo, useState } from "../html.js";
import { seen } from "../blind.js";

/** @template T @param {import("../store.js").Value<T>} value @returns {T} */
export function useValue(value) {
  const [seen, setSeen] = useState(() => value.get());
  useEffect(() => {
    setSeen(() => value.get());
    return value.observe((next) => setSeen(() => next));
  }, [value]);
  return seen;
}

/** @param {import("../store.js").Store} store */
export function useBoxes(store) {
  const [boxes, setBoxes] = useState(() => store.all());
  useEffect(() => {
    setBoxes(store.all());
    return store.observe(() => setBoxes(store.all()));
  }, [store]);
  return boxes;
}

/** Boxes as they may be shown: veiled where the person re-checks blindly. @param {import("../app.js").App} app @param {readonly import("../types.js").Decision[]} boxes */
export function useSeen(app, boxes) {
  const { blind } = useValue(app.prefs);
  return useMemo(() => (blind ? boxes.map((box) => seen(box, true)) : boxes), [boxes, blind]);
}

/**
 * @template T
 * @typedef {{state: "loading", value: T | null, error: null, reload: () => void}
 *   | {state: "ready", value: T, error: null, reload: () => void}
 *   | {state: "error", value: T | null, error: Error, reload: () => void}} Loaded
 */

/**
 * Load when `deps` change; what was asked for before is abandoned.
 * @template T
 * @param {import("../app.js").App} app
 * @param {(signal: AbortSignal) => Promise<T>} load
 * @param {readonly unknown[]} deps
 * @returns {Loaded<T>}
 */
export function useLoaded(app, load, deps) {
  const [attempt, setAttempt] = useState(0);
  const [found, setFound] = useState(/** @type {{value: T | null, error: Error | null, done: boolean}} */ ({ value: null, error: null, done: false }));
  useEffect(() => {
    const stop = new AbortController();
    setFound((last) => ({ ...last, error: null, done: false }));
    load(stop.signal).then(
      (value) => !stop.signal.aborted && setFound({ value, error: null, done: true }),
      (error) => {
        if (stop.signal.aborted) return;
        app.notice(error);
        setFound((last) => ({ ...last, error, done: true }));
      },
    );
    return () => stop.abort();
  }, [...deps, attempt]);
  const reload = useCallback(() => setAttempt((n) => n + 1), []);
  const { value, error, done } = found;
  if (error) return { state: "error", value, error, reload };
  return done && value !== null ? { state: "ready", value, error: null, reload } : { state: "loading", value, error: null, reload };
}

/** Offer actions to the keys while the view is on show, from the moment on at which it is: nobody waits for the paint. @param {import("../app.js").App} app @param {import("../app.js").Actions} actions */
export function useActions(app, actions) {
  useLayoutEffect(() => {
    app.actions.set([...app.actions.get(), actions]);
    return () => app.actions.set(app.actions.get().filter((offered) => offered !== actions));
  }, [app, actions]);
}

/**
 * What is being typed stays, whatever else is drawn meanwhile; who listens is told after a pause.
 * @param {string} value @param {(value: string) => void} onChange @param {number} pauseMs
 */
export function useTyped(value, onChange, pauseMs) {
  const [typed, setTyped] = useState(/** @type {string | null} */ (null));
  useEffect(() => {
    if (typed === null) return;
    const timer = setTimeout(() => {
      onChange(typed.trim());
      setTyped(null);
    }, pauseMs);
    return () => clearTimeout(timer);
  }, [typed, onChange]);
  return {
    shown: typed ?? value,
    /** @param {{currentTarget: HTMLInputElement}} event */
    onInput: ({ currentTarget }) => setTyped(currentTarget.value),
  };
}

/** @param {string} title */
export function useTitle(title) {
  useEffect(() => {
    document.title = title ? `${title} · Unghost` : "Unghost";
  }, [title]);
}
