// @ts-check
// A long list read by cursor as if it lay there whole: ids, kept for whoever comes back.

import { seenRevision } from "../boxes/box.js";
import { selectionOf, sortOf } from "../boxes/filters.js";
import { request, urlOf } from "../core/api.js";
import { createValue } from "../core/observable.js";
import { NOTHING } from "./selection.js";

/** @typedef {import("../core/types.js").Decision} Decision */

/**
 * @typedef {object} Part  boxes that one request brought, in their order
 * @property {number} start  index of the first
 * @property {readonly number[]} ids
 * @property {readonly number[]} revisions  of these boxes, as they were shown
 * @property {string | undefined} cursor  that brings them again
 * @property {ReadonlyMap<number, Decision> | null} boxes  null: let go of
 */

/** @typedef {{items: Decision[], next_cursor: string | null, total?: number | null, snapshot?: string | null}} BoxPage */
/** @typedef {{limit: number, cursor: string | undefined, count: boolean}} BoxRequest */

const PAGE = 200;
const LARGE_PAGE = 1000;

/** Places shown before anything is known. */
const FIRST_SIGHT = 60;

/** Boxes kept in memory besides those in sight. */
const KEPT = 6000;

/** @param {(request: BoxRequest) => Promise<BoxPage>} load */
export function createPager(load) {
  /** @type {Part[]} in order, without gaps */
  const parts = [];
  /** Answered on this page: what a page read before says of them is old. @type {Map<number, Decision>} */
  const changed = new Map();
  /** @type {Set<() => void>} */
  const observers = new Set();
  let wanted = { first: 0, end: PAGE };
  let total = /** @type {number | null} */ (null);
  /** Stands for all boxes of the list as they were when it was read first. */
  let snapshot = "";
  let next = /** @type {string | null | undefined} */ (undefined);
  let error = /** @type {Error | null} */ (null);
  let isBusy = false;

  const known = () => (parts.at(-1)?.start ?? 0) + (parts.at(-1)?.ids.length ?? 0);
  const isWhole = () => next === null;
  const tell = () => [...observers].forEach((notify) => notify());

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
    try {
      while (await step());
    } catch (fault) {
      error = fault instanceof Error ? fault : new Error(String(fault));
    } finally {
      isBusy = false;
      tell();
    }
  }

  /** One request, if something in sight is missing. @returns {Promise<boolean>} was there one? */
  async function step() {
    const missing = parts.find((part) => part.boxes === null && isInSight(part));
    if (missing) await again(missing);
    else if (!isWhole() && wanted.end > known()) await further();
    else return false;
    letGo();
    tell();
    return true;
  }

  async function further() {
    const isFirst = parts.length === 0;
    const limit = wanted.end - known() > 2 * PAGE ? LARGE_PAGE : PAGE;
    const cursor = next ?? undefined;
    const page = await load({ limit, cursor, count: isFirst });
    if (isFirst) {
      total = page.total ?? null;
      snapshot = page.snapshot ?? "";
    }
    next = page.next_cursor;
    if (page.items.length > 0) {
      const ids = page.items.map(({ box_id }) => box_id);
      parts.push({ start: known(), ids, revisions: page.items.map(seenRevision), cursor, boxes: byId(page.items) });
    }
    if (next === null) total = known();
  }

  /** @param {Part} part */
  async function again(part) {
    const page = await load({ limit: part.ids.length, cursor: part.cursor, count: false });
    const boxes = byId(page.items);
    const revisions = part.ids.map((id, i) => seenRevision(boxes.get(id) ?? { revision: part.revisions[i] }));
    parts[parts.indexOf(part)] = { ...part, revisions, boxes };
  }

  /** Forget the boxes farthest away; their ids and cursors stay. */
  function letGo() {
    const middle = (wanted.first + wanted.end) / 2;
    const full = parts.filter((part) => part.boxes && !isInSight(part));
    full.sort((a, b) => Math.abs(b.start - middle) - Math.abs(a.start - middle));
    let held = full.reduce((sum, part) => sum + part.ids.length, 0);
    for (const part of full) {
      if (held <= KEPT) return;
      held -= part.ids.length;
      parts[parts.indexOf(part)] = { ...part, boxes: null };
    }
  }

  /** @param {number} boxId */
  function get(boxId) {
    const own = changed.get(boxId);
    if (own) return own;
    for (const { boxes } of parts) if (boxes?.has(boxId)) return boxes.get(boxId);
    return undefined;
  }

  return {
    get,
    known,
    isWhole,
    total: () => total,
    snapshot: () => snapshot,
    error: () => error,

    /** How many cells the list has, as far as one can tell. */
    count() {
      if (isWhole()) return known();
      return parts.length === 0 ? FIRST_SIGHT : Math.max(total ?? 0, known() + 1);
    },

    /** @param {number} index */
    idAt(index) {
      const part = partAt(index);
      return part?.ids[index - part.start];
    },

    /** The box at a place; null: still to come; undefined: the filter does not find it any more. @param {number} index @returns {Decision | null | undefined} */
    at(index) {
      const part = partAt(index);
      if (!part) return null;
      const id = /** @type {number} */ (part.ids[index - part.start]);
      return changed.get(id) ?? (part.boxes ? part.boxes.get(id) : null);
    },

    /** Ids of places that were reached, both ends included. @param {number} a @param {number} b */
    idsBetween(a, b) {
      const [first, last] = a < b ? [a, b] : [b, a];
      return parts
        .filter((part) => part.start <= last && part.start + part.ids.length > first)
        .flatMap((part) => part.ids.slice(Math.max(0, first - part.start), last + 1 - part.start));
    },

    /** The revision of every box that was shown, those that are not kept in memory included. */
    revisions() {
      const shown = new Map(parts.flatMap(({ ids, revisions }) => ids.map((id, i) => /** @type {const} */ ([id, revisions[i] ?? 0]))));
      for (const box of changed.values()) shown.set(box.box_id, seenRevision(box));
      return shown;
    },

    allIds: () => parts.flatMap(({ ids }) => ids),

    /** These places are looked at. @param {number} first @param {number} end */
    want(first, end) {
      if (first === wanted.first && end === wanted.end && parts.length > 0) return;
      wanted = { first, end };
      if (!error) void work();
    },

    retry: () => void work(),

    /** A box's next state. @param {Decision} box */
    apply(box) {
      changed.set(box.box_id, box);
      tell();
    },

    /** Boxes that were answered here. */
    changed: () => [...changed.values()],

    /** @param {() => void} notify @returns {() => void} stop observing */
    observe(notify) {
      observers.add(notify);
      return () => observers.delete(notify);
    },
  };
}

/** @typedef {ReturnType<typeof createPager>} Pager */

/** @param {readonly Decision[]} items */
const byId = (items) => new Map(items.map((box) => [box.box_id, box]));

/** @param {string} dataset @param {Record<string, string | number | boolean>} filter @param {{sort?: string, limit: number, cursor?: string, count?: boolean}} page @param {AbortSignal} [signal] @returns {Promise<BoxPage>} */
export const listBoxes = (dataset, filter, { sort, limit, cursor, count }, signal) =>
  request(urlOf("/boxes", { dataset, ...texts(filter), sort, limit, cursor, count: count ? "true" : undefined }), { signal });

/** @param {Record<string, string | number | boolean>} filter */
const texts = (filter) => Object.fromEntries(Object.entries(filter).map(([key, value]) => [key, String(value)]));

/**
 * @typedef {object} Place
 * @property {string} key
 * @property {Pager} pager
 * @property {import("../core/observable.js").Value<import("./selection.js").Selection>} selection
 * @property {{offset: number, seen: number}} scroll  how far down, and when one left
 * @property {() => void} end
 */

const KEPT_PLACES = 4;

/** Others may be answering: a list that was left longer ago is read again. */
const FRESH_MS = 10 * 60_000;

/** @type {Map<string, Place>} the one used last comes last */
const places = new Map();

/** @param {import("../review/answers.js").ReviewApp} app @param {string} dataset @param {import("../core/router.js").Query} query @param {string} key @returns {Place} */
export function placeOf(app, dataset, query, key) {
  const known = places.get(key);
  if (known && Date.now() - known.scroll.seen < FRESH_MS && !known.pager.error()) {
    places.delete(key);
    places.set(key, known);
    return known;
  }
  leave(key);
  const filter = selectionOf(query);
  const pager = createPager((page) => listBoxes(dataset, filter, { ...page, sort: sortOf(query) }));
  const scroll = { offset: 0, seen: Date.now() };
  const place = { key, pager, selection: createValue(NOTHING), scroll, end: app.stores.lend(pager) };
  places.set(key, place);
  for (const old of [...places.keys()].slice(0, -KEPT_PLACES)) leave(old);
  return place;
}

/** Forget a list: it is read anew when it is wanted. @param {string} key */
export function leave(key) {
  places.get(key)?.end();
  places.delete(key);
}
