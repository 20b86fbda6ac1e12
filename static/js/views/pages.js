// @ts-check
// A list that grows by cursor, and is where it was when one comes back to it.

import { useCallback, useEffect, useLayoutEffect, useRef, useState } from "../html.js";

/**
 * @template T
 * @typedef {{items: readonly T[], cursor: string | null, isDone: boolean, error: Error | null}} Pages
 */

const MOST_AT_ONCE = 1000;

/** Lists left behind: how much was shown, and how far down one was. @type {Map<string, {shown: number, scroll: number}>} */
const left = new Map();

/**
 * @template T
 * @param {import("../app.js").App} app
 * @param {string} key  what makes it another list
 * @param {number} size  of a page
 * @param {(limit: number, cursor: string | undefined) => Promise<import("../types.js").Page<T>>} load
 */
export function usePages(app, key, size, load) {
  const [pages, setPages] = useState(/** @type {Pages<T>} */ ({ items: [], cursor: null, isDone: false, error: null }));
  const isBusy = useRef(false);
  const back = useRef(left.get(key));
  const shown = useRef(0);
  shown.current = pages.items.length;

  const more = useCallback(async () => {
    if (isBusy.current || pages.isDone) return;
    isBusy.current = true;
    const limit = pages.items.length ? size : Math.min(Math.max(size, back.current?.shown ?? 0), MOST_AT_ONCE);
    try {
      const page = await load(limit, pages.cursor ?? undefined);
      setPages({ items: [...pages.items, ...page.items], cursor: page.next_cursor, isDone: page.next_cursor === null, error: null });
    } catch (error) {
      app.notice(error);
      setPages({ ...pages, error: error instanceof Error ? error : new Error(String(error)) });
    } finally {
      isBusy.current = false;
    }
  }, [pages]);

  useEffect(() => void more(), []);
  useLayoutEffect(() => {
    if (shown.current === 0 || !back.current) return;
    scrollTo(0, back.current.scroll);
    back.current = undefined;
  }, [pages]);
  useLayoutEffect(() => () => void left.set(key, { shown: shown.current, scroll: scrollY }), [key]);
  return { ...pages, more };
}
