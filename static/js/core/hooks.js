// @ts-check
// Hooks that views share: useValue, useLazy, useLoaded, useDataset, useDatasets, useNewest, usePages, useTask,
// useActions, useTyped, useClosing, useTopBar, useRetryOnline, useRetries.

import { ApiError, createRetries, get, mayPass } from "./api.js";
import { useCallback, useEffect, useLayoutEffect, useMemo, useRef, useState } from "./html.js";
import { linkTo } from "./router.js";

/** @import { Actions, App } from "./app.js" */
/** @import { Lazy, Value } from "./observable.js" */

/** @template T @param {Value<T>} value @returns {T} */
export function useValue(value) {
  const [seen, setSeen] = useState(() => value.get());
  useEffect(() => {
    setSeen(() => value.get());
    return value.observe((next) => setSeen(() => next));
  }, [value]);
  return seen;
}

/**
 * Ask for something while the component is on the page. `value` is undefined until it is there.
 * @template T @param {Lazy<T> | null} lazy  null: it is not wanted
 */
export function useLazy(lazy) {
  const [settled, setSettled] = useState(
    /** @type {{lazy: Lazy<T> | null, error: Error | null}} */ ({ lazy: null, error: null }),
  );
  const [attempt, setAttempt] = useState(0);
  const value = lazy?.value;
  useEffect(() => {
    if (!lazy || value !== undefined) return;
    const stop = new AbortController();
    /** @param {Error | null} error */
    const settle = (error) => !stop.signal.aborted && setSettled({ lazy, error });
    lazy.get(stop.signal).then(() => settle(null), settle);
    return () => stop.abort();
  }, [lazy, attempt]);
  const error = value === undefined && settled.lazy === lazy ? settled.error : null;
  const retry = () => {
    setSettled({ lazy: null, error: null });
    setAttempt((n) => n + 1);
  };
  return { value, error, retry };
}

/**
 * @template T
 * @typedef {{state: "loading", value: T | null, error: null, reload: () => void} | {state: "ready", value: T, error:
 *   null, reload: () => void} | {state: "error", value: T | null, error: Error, reload: () => void}} Loaded
 */

/**
 * Load when `deps` change; an earlier request that is still running is aborted.
 * @template T
 * @param {(signal: AbortSignal) => Promise<T>} load @param {readonly unknown[]} deps @returns {Loaded<T>}
 */
export function useLoaded(load, deps) {
  const [attempt, setAttempt] = useState(0);
  const [found, setFound] = useState(
    /** @type {{value: T | null, error: Error | null, done: boolean}} */ ({ value: null, error: null, done: false }),
  );
  useEffect(() => {
    const stop = new AbortController();
    setFound((last) => ({ ...last, error: null, done: false }));
    load(stop.signal).then(
      (value) => !stop.signal.aborted && setFound({ value, error: null, done: true }),
      (error) => !stop.signal.aborted && setFound((last) => ({ ...last, error, done: true })),
    );
    return () => stop.abort();
  }, [...deps, attempt]);
  const reload = useCallback(() => setAttempt((n) => n + 1), []);
  const { value, error, done } = found;
  if (error) return { state: "error", value, error, reload };
  return done && value !== null
    ? { state: "ready", value, error: null, reload }
    : { state: "loading", value, error: null, reload };
}

/** The dataset of a view. @param {string} name @param {unknown} [state] when it changes, the dataset is loaded again */
export const useDataset = (name, state) =>
  useLoaded((signal) => get("/api/v1/datasets/{dataset}", { path: { dataset: name }, signal }), [name, state]);

/** Most items of a list that the API returns at once. */
const MOST_AT_ONCE = 1000;

/** @template T @typedef {{items: T[], next_cursor: string | null}} ListPage  a page of a list, as the API returns it */

/**
 * All items of a list.
 * @template T
 * @param {(query: {limit: number, cursor?: string}) => Promise<ListPage<T>>} load @returns {Promise<ListPage<T>>}
 */
async function allOf(load) {
  const page = await load({ limit: MOST_AT_ONCE });
  while (page.next_cursor !== null) {
    const next = await load({ limit: MOST_AT_ONCE, cursor: page.next_cursor });
    page.items.push(...next.items);
    page.next_cursor = next.next_cursor;
  }
  return page;
}

/** All datasets. @param {unknown} [state]  when it changes, they are loaded again */
export const useDatasets = (state) =>
  useLoaded((signal) => allOf((query) => get("/api/v1/datasets", { query, signal })), [state]);

/**
 * The newest items of a list. `showOlder` loads the older ones, too; it is null if all items are shown.
 * @template T
 * @param {number} size  how many items are the newest
 * @param {(query: {limit: number, cursor?: string}, signal: AbortSignal) => Promise<ListPage<T>>} load
 * @param {readonly unknown[]} deps  when they change, the list is loaded again
 */
export function useNewest(size, load, deps) {
  const [isAll, setAll] = useState(false);
  const loaded = useLoaded(
    (signal) => (isAll ? allOf((query) => load(query, signal)) : load({ limit: size }, signal)),
    [...deps, isAll],
  );
  return { ...loaded, showOlder: !isAll && loaded.value?.next_cursor ? () => setAll(true) : null };
}

/**
 * Something that a person asks for, with its state: whether it is running (`isBusy`), and why it failed (`error`).
 * @template {unknown[]} A @param {(...given: A) => Promise<unknown>} act
 * @param {(error: Error) => void} [tell]  told about a failure; without it the view shows `error` itself
 */
export function useTask(act, tell) {
  const [state, setState] = useState({ isBusy: false, error: /** @type {Error | null} */ (null) });
  /** @param {A} given */
  const run = async (...given) => {
    setState({ isBusy: true, error: null });
    await act(...given).then(
      () => setState({ isBusy: false, error: null }),
      (error) => {
        setState({ isBusy: false, error });
        tell?.(error);
      },
    );
  };
  return { ...state, run };
}

/**
 * Offer actions to the keyboard while a view is on the page; active before the view's first paint.
 * @param {App} app @param {Actions} actions
 */
export function useActions(app, actions) {
  useLayoutEffect(() => {
    app.actions.set([...app.actions.get(), actions]);
    return () => app.actions.set(app.actions.get().filter((offered) => offered !== actions));
  }, [app, actions]);
}

/**
 * The text of a field while it is being typed: other redraws do not reset it. `onChange` is called after a pause, or
 * at once when the field is left or removed.
 * @param {string} value @param {(value: string) => void} onChange @param {number} pauseMs
 */
export function useTyped(value, onChange, pauseMs) {
  const [typed, setTyped] = useState(/** @type {string | null} */ (null));
  const submit = useRef(() => {});
  submit.current = () => {
    if (typed === null) return;
    setTyped(null);
    onChange(typed.trim());
  };
  useEffect(() => {
    if (typed === null) return;
    const timer = setTimeout(() => submit.current(), pauseMs);
    return () => clearTimeout(timer);
  }, [typed]);
  useEffect(() => () => submit.current(), []);
  return {
    shown: typed ?? value,
    /** @param {{currentTarget: HTMLInputElement}} event */
    onInput: ({ currentTarget }) => setTyped(currentTarget.value),
    onBlur: () => submit.current(),
  };
}

/** How often a list is loaded again while it grows, and for how long nothing may come before that ends. */
const GROWTH_MS = 2000;
const STILL_MS = 20_000;

/** What is rendered or recorded may take as long until the first comes. */
const EMPTY_MS = 300_000;

/**
 * Load again while frames come in, so that somebody who looks on sees them.
 * @param {{state: string, reload: () => void}} loaded @param {number} count of what is there
 * @param {string} [since] when the newest dataset was made
 */
export function useGrowth({ state, reload }, count, since) {
  const last = useRef({ count, at: -Infinity });
  if (last.current.count !== count) last.current = { count, at: Date.now() };
  useEffect(() => {
    if (state !== "ready" || document.visibilityState !== "visible") return;
    const grewAt = Math.max(last.current.at, Date.parse(since ?? "") || -Infinity);
    if (Date.now() - grewAt > (count === 0 ? EMPTY_MS : STILL_MS)) return;
    const timer = setTimeout(reload, GROWTH_MS);
    return () => clearTimeout(timer);
  });
}

/**
 * Close an open menu when Escape is pressed or when somebody clicks outside it.
 * @param {{current: HTMLElement | null}} root @param {boolean} isOpen @param {() => void} close
 */
export function useClosing(root, isOpen, close) {
  useEffect(() => {
    if (!isOpen) return;
    /** @param {Event} event */
    const onEvent = (event) => {
      const isInside = event.target instanceof Node && root.current?.contains(event.target);
      if (event instanceof KeyboardEvent && event.key === "Escape") {
        event.preventDefault();
        close();
      } else if (!(event instanceof KeyboardEvent) && !isInside) close();
    };
    addEventListener("pointerdown", onEvent);
    addEventListener("keydown", onEvent, { capture: true });
    return () => {
      removeEventListener("pointerdown", onEvent);
      removeEventListener("keydown", onEvent, { capture: true });
    };
  }, [isOpen]);
}

/** @typedef {{text: string, href?: string}} Crumb  one step of the path to a view; the last one has no address */
/**
 * @typedef {{dataset: string, crumbs: readonly Crumb[], tools: unknown}} TopBar what the top bar shows: `dataset` is
 *   the current dataset, or ""; `tools` are shown in the bar
 */

/** @param {string} dataset @returns {Crumb[]} */
const pathTo = (dataset) => [{ text: "Datasets", href: linkTo("datasets") }, ...(dataset ? [{ text: dataset }] : [])];

/**
 * Set what the top bar shows while a view is on the page.
 * @param {App} app @param {{title: string, dataset?: string, crumbs?: readonly Crumb[], tools?: unknown}} head
 */
export function useTopBar(app, { title, dataset = "", crumbs = pathTo(dataset), tools = null }) {
  useTitle(title);
  useLayoutEffect(() => app.topBar.set({ dataset, crumbs, tools }), [app, dataset, JSON.stringify(crumbs), tools]);
}

/** @param {string} title */
export function useTitle(title) {
  useEffect(() => {
    document.title = title ? `${title} · Unghost` : "Unghost";
  }, [title]);
}

/** @template T @typedef {{items: readonly T[], cursor: string | null, isDone: boolean, error: Error | null}} Pages */

/**
 * Lists that were left, by key: how many items were shown, and the scroll position, to be restored.
 * @type {Map<string, {shown: number, scroll: number}>}
 */
const left = new Map();

/**
 * @template T
 * @param {string} key  identifies the list
 * @param {number} size  of a page
 * @param {(limit: number, cursor: string | undefined) => Promise<{items: readonly T[], next_cursor: string | null}>}
 *   load
 */
export function usePages(key, size, load) {
  const [pages, setPages] = useState(/** @type {Pages<T>} */ ({ items: [], cursor: null, isDone: false, error: null }));
  const isBusy = useRef(false);
  const back = useRef(left.get(key));
  const shown = useRef(0);
  shown.current = pages.items.length;

  const more = useCallback(async () => {
    if (isBusy.current || pages.isDone) return;
    isBusy.current = true;
    const limit = pages.items.length ? size : Math.min(Math.max(size, back.current?.shown ?? 0), MOST_AT_ONCE);
    await load(limit, pages.cursor ?? undefined).then(
      ({ items, next_cursor: cursor }) =>
        setPages({ items: [...pages.items, ...items], cursor, isDone: cursor === null, error: null }),
      (error) => setPages({ ...pages, error }),
    );
    isBusy.current = false;
  }, [pages]);

  useEffect(() => void more(), []);
  useLayoutEffect(() => {
    if (shown.current === 0 || !back.current) return;
    scrollTo(0, back.current.scroll);
    back.current = undefined;
  }, [pages]);
  useLayoutEffect(() => () => void left.set(key, { shown: shown.current, scroll: scrollY }), [key]);

  /** Add items that have come since: what is on show stays where it is. */
  const append = useCallback(
    (/** @type {(known: readonly T[]) => readonly T[]} */ newer) =>
      setPages((now) => ({ ...now, items: [...now.items, ...newer(now.items)] })),
    [],
  );
  return { ...pages, more, append };
}

/** For so long after the browser is online again, what fails is tried again. */
const RECOVERY_MS = 5000;
const PAUSE_MS = 1000;
let wasOnlineAgainAt = -Infinity;
globalThis.addEventListener?.("online", () => void (wasOnlineAgainAt = Date.now()));

/**
 * Try again when the browser is online again. The first attempt then may fail, too, for instance if a request from
 * before is still under way for the same module.
 * @param {unknown} failure  another object after each failure; null: there is none
 * @param {() => void} [onRetry]
 */
export function useRetryOnline(failure, onRetry) {
  const latest = useRef(onRetry);
  latest.current = onRetry;
  // In a layout effect, so that an "online" event right after the failure is not missed.
  useLayoutEffect(() => {
    if (failure === null) return undefined;
    const retry = () => latest.current?.();
    addEventListener("online", retry);
    const timer = Date.now() - wasOnlineAgainAt < RECOVERY_MS ? setTimeout(retry, PAUSE_MS) : 0;
    return () => {
      removeEventListener("online", retry);
      clearTimeout(timer);
    };
  }, [failure]);
}

/**
 * Try again after a pause, a longer one each time, as long as the error may pass without a person's doing.
 * @param {Error | null} error  another object after each failure
 * @param {() => void} retry @param {unknown} subject  what is asked for; for another one the pauses are short again
 */
export function useRetries(error, retry, subject) {
  const latest = useRef(retry);
  latest.current = retry;
  const retries = useMemo(() => createRetries(), [subject]);
  useEffect(() => {
    if (!mayPass(error)) return undefined;
    let isOver = false;
    retries.wait(() => void (isOver || latest.current()), error instanceof ApiError ? error.retryAfterS : null);
    return () => void (isOver = true);
  }, [error]);
}
