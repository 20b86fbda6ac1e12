// @ts-check
// A long list of boxes, read page by page with a cursor and addressed by index. Lists that were left are kept for a
// while.

import { seenRevision } from "../boxes/box.js";
import { selectionOf, sortOf } from "../boxes/filters.js";
import { get } from "../core/api.js";
import { createValue } from "../core/observable.js";
import { NOTHING } from "./selection.js";

/** @import { Decision } from "../boxes/box.js" */
/** @import { Boxes } from "../boxes/store.js" */
/** @import { Value } from "../core/observable.js" */
/** @import { Query } from "../core/router.js" */
/** @import { ReviewApp } from "../review/answers.js" */
/** @import { Selection } from "./selection.js" */

/**
 * @typedef {object} Part  boxes that one request brought, in their order
 * @property {number} start  index of the first
 * @property {readonly number[]} ids
 * @property {readonly number[]} revisions  of these boxes, as they were shown
 * @property {string | undefined} cursor  with which they can be requested again
 * @property {ReadonlySet<number> | null} found  those that the last request returned; null: not in memory
 * @property {() => void} release  ends the hold on the boxes, so that the store may drop them
 */

/**
 * @typedef {Pick<import("../core/openapi.js").BoxPage, "items" | "next_cursor"> & {total?: number | null, snapshot?:
 *   string | null}} BoxPage
 */
/** @typedef {{limit: number, cursor: string | undefined, count: boolean}} BoxRequest */

const PAGE = 200;
const LARGE_PAGE = 1000;

/** Empty cells shown before the first answer. */
const PLACEHOLDERS = 60;

/** How many boxes outside the visible part are kept in memory. */
const KEPT = 6000;

/** @param {Boxes} boxes @param {(request: BoxRequest, signal: AbortSignal) => Promise<BoxPage>} load */
export function createPager(boxes, load) {
  /** @type {Part[]} in order, without gaps */
  const parts = [];
  /** Of this list. @type {Set<number>} */
  const listed = new Set();
  /**
   * Boxes that have changed since they were listed, each with the function that releases it.
   * @type {Map<number, () => void>}
   */
  const changed = new Map();
  /** @type {Set<() => void>} */
  const observers = new Set();
  let wanted = { first: 0, end: PAGE };
  let total = /** @type {number | null} */ (null);
  /** The server's identifier of the list's state at the first request. */
  let snapshot = "";
  let next = /** @type {string | null | undefined} */ (undefined);
  let error = /** @type {Error | null} */ (null);
  let isBusy = false;
  const ended = new AbortController();

  const known = () => (parts.at(-1)?.start ?? 0) + (parts.at(-1)?.ids.length ?? 0);
  const isWhole = () => next === null;
  const tell = () => [...observers].forEach((notify) => notify());
  const stop = boxes.observe((others) => {
    const mine = [...others].filter((id) => listed.has(id));
    for (const id of mine) if (!changed.has(id)) changed.set(id, boxes.hold([id]));
    if (mine.length > 0) tell();
  });

  /** @param {number} index */
  function partAt(index) {
    let low = 0;
    let high = parts.length - 1;
    while (low <= high) {
      const middle = (low + high) >> 1;
      const part = /** @type {Part} */ (parts[middle]);
      if (index < part.start) high = middle - 1;
      else if (index >= part.start + part.ids.length) low = middle + 1;
      else return part;
    }
    return null;
  }

  /** @param {Part} part */
  const isInSight = (part) => part.start < wanted.end && part.start + part.ids.length > wanted.first;

  async function work() {
    if (isBusy) return;
    isBusy = true;
    error = null;
    await steps().catch((fault) => (error = fault));
    isBusy = false;
    tell();
  }

  async function steps() {
    while (await step());
  }

  /**
   * Make one request, if boxes of the visible part are missing.
   * @returns {Promise<boolean>} whether a request was made
   */
  async function step() {
    const missing = parts.find((part) => part.found === null && isInSight(part));
    if (missing) await loadAgain(missing);
    else if (!isWhole() && wanted.end > known()) await loadNext();
    else return false;
    releaseFarthest();
    tell();
    return true;
  }

  /** @param {BoxRequest} request */
  async function loaded(request) {
    const page = await load(request, ended.signal);
    ended.signal.throwIfAborted();
    return page;
  }

  async function loadNext() {
    const isFirst = parts.length === 0;
    const limit = wanted.end - known() > 2 * PAGE ? LARGE_PAGE : PAGE;
    const cursor = next ?? undefined;
    const page = await loaded({ limit, cursor, count: isFirst });
    if (isFirst) {
      total = page.total ?? null;
      snapshot = page.snapshot ?? "";
    }
    next = page.next_cursor;
    if (page.items.length > 0) {
      const ids = boxes.receive(page.items);
      for (const id of ids) listed.add(id);
      parts.push({
        start: known(),
        ids,
        revisions: page.items.map(seenRevision),
        cursor,
        found: new Set(ids),
        release: boxes.hold(ids),
      });
    }
    if (next === null) total = known();
  }

  /** @param {Part} part */
  async function loadAgain(part) {
    const page = await loaded({ limit: part.ids.length, cursor: part.cursor, count: false });
    const ids = boxes.receive(page.items);
    const found = new Set(ids);
    const revisions = part.ids.map((id, i) =>
      seenRevision((found.has(id) && boxes.get(id)) || { revision: part.revisions[i] }),
    );
    parts[parts.indexOf(part)] = { ...part, revisions, found, release: boxes.hold(ids) };
  }

  /** Release the boxes farthest from the visible part; their ids and cursors stay. */
  function releaseFarthest() {
    const middle = (wanted.first + wanted.end) / 2;
    const full = parts.filter((part) => part.found && !isInSight(part));
    full.sort((a, b) => Math.abs(b.start - middle) - Math.abs(a.start - middle));
    let held = full.reduce((sum, part) => sum + part.ids.length, 0);
    for (const part of full) {
      if (held <= KEPT) return;
      held -= part.ids.length;
      part.release();
      parts[parts.indexOf(part)] = { ...part, found: null };
    }
  }

  return {
    known,
    isWhole,
    total: () => total,
    snapshot: () => snapshot,
    error: () => error,

    /** How many cells to show: the exact number once it is known. */
    count() {
      if (isWhole()) return known();
      return parts.length === 0 ? PLACEHOLDERS : Math.max(total ?? 0, known() + 1);
    },

    /** @param {number} index */
    idAt(index) {
      const part = partAt(index);
      return part?.ids[index - part.start];
    },

    /** The place of a box; -1: it is not in the part of the list that has been read. @param {number} boxId */
    indexOf(boxId) {
      const part = listed.has(boxId) ? parts.find(({ ids }) => ids.includes(boxId)) : undefined;
      return part ? part.start + part.ids.indexOf(boxId) : -1;
    },

    /**
     * The box at a place; null: not loaded yet; undefined: it no longer matches the filter.
     * @param {number} index @returns {Decision | null | undefined}
     */
    at(index) {
      const part = partAt(index);
      if (!part) return null;
      const id = /** @type {number} */ (part.ids[index - part.start]);
      if (changed.has(id) || part.found?.has(id)) return boxes.get(id);
      return part.found ? undefined : null;
    },

    /** The known ids between two indices, both included. @param {number} a @param {number} b */
    idsBetween(a, b) {
      const [first, last] = a < b ? [a, b] : [b, a];
      return parts
        .filter((part) => part.start <= last && part.start + part.ids.length > first)
        .flatMap((part) => part.ids.slice(Math.max(0, first - part.start), last + 1 - part.start));
    },

    /** The revision of every box that was shown, including boxes no longer in memory. */
    revisions() {
      const shown = new Map(
        parts.flatMap(({ ids, revisions }) => ids.map((id, i) => /** @type {const} */ ([id, revisions[i] ?? 0]))),
      );
      for (const box of boxes.all([...changed.keys()])) shown.set(box.box_id, seenRevision(box));
      return shown;
    },

    allIds: () => parts.flatMap(({ ids }) => ids),

    /** Load the boxes of these indices, which are visible now. @param {number} first @param {number} end */
    want(first, end) {
      if (first === wanted.first && end === wanted.end && parts.length > 0) return;
      wanted = { first, end };
      if (!error) void work();
    },

    retry: () => void work(),

    /** Boxes that have changed since they were listed, mostly by an answer. */
    changed: () => boxes.all([...changed.keys()]),

    /** Stop loading and observing, and release all boxes. */
    end() {
      ended.abort();
      stop();
      for (const { release } of parts) release();
      for (const release of changed.values()) release();
    },

    /** @param {() => void} notify @returns {() => void} stop observing */
    observe(notify) {
      observers.add(notify);
      return () => observers.delete(notify);
    },
  };
}

/** @typedef {ReturnType<typeof createPager>} Pager */

/**
 * @typedef {object} Place
 * @property {string} key
 * @property {Pager} pager
 * @property {Value<Selection>} selection
 * @property {{offset: number, seen: number}} scroll  how far down it is scrolled, and when it was left
 * @property {Promise<string | null>} state  `stateNow`, about when the list was read; null: it could not be loaded
 * @property {Promise<boolean>} isOutdated whether the dataset has changed since the list was read; true if that is not
 *   known
 * @property {() => void} stop  end following whether lists have to be read again
 * @property {(index: number) => void} show moves the focus to that cell and scrolls to it; set by the view that shows
 *   the list
 */

const KEPT_PLACES = 4;

/** A list that was left longer ago is read again: others may have answered. */
const FRESH_MS = 10 * 60_000;

/**
 * It changes when lists have to be read again: after a run, an upload, or if the dataset is another one of this name.
 * (A frame that replaces another one may have as many boxes: it is the newest.)
 * @param {string} dataset @returns {Promise<string | null>} null: it could not be loaded
 */
async function stateNow(dataset) {
  const path = { dataset };
  try {
    const [{ created_at, active_run, counts }, newest] = await Promise.all([
      get("/api/v1/datasets/{dataset}", { path }),
      get("/api/v1/datasets/{dataset}/frames", { path, query: { sort: "-id", limit: 1 } }),
    ]);
    return JSON.stringify([created_at, active_run, counts.boxes, newest.items[0]?.id]);
  } catch {
    return null;
  }
}

/** @type {Map<string, Place>} the one used last comes last */
const places = new Map();

/**
 * The list of boxes that match the filters: as it was left, or a new one.
 * @param {ReviewApp} app @param {string} dataset
 * @param {Query} query @param {string} key @returns {Place}
 */
export function placeOf(app, dataset, query, key) {
  const known = places.get(key);
  if (known && Date.now() - known.scroll.seen < FRESH_MS && !known.pager.error()) {
    places.delete(key);
    places.set(key, known);
    known.isOutdated = Promise.all([known.state, stateNow(dataset)]).then(
      ([then, now]) => now !== null && now !== then,
    );
    return known;
  }
  leave(key);
  const filter = { ...selectionOf(query), sort: sortOf(query) };
  const pager = createPager(app.boxes, (page, signal) =>
    get("/api/v1/boxes", { query: { dataset, ...filter, ...page }, signal }),
  );
  const scroll = { offset: 0, seen: Date.now() };
  const stop = app.boxes.reloads.observe(() => leave(key));
  const place = {
    key,
    pager,
    selection: createValue(NOTHING),
    scroll,
    state: stateNow(dataset),
    isOutdated: Promise.resolve(false),
    stop,
    show: () => {},
  };
  places.set(key, place);
  for (const old of [...places.keys()].slice(0, -KEPT_PLACES)) leave(old);
  return place;
}

/** Forget a list, so that it is read again the next time. @param {string} key */
export function leave(key) {
  const place = places.get(key);
  place?.stop();
  place?.pager.end();
  places.delete(key);
}
