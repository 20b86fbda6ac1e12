// @ts-check
// Lists that one comes back to: what was read, what was selected, and how far down one was.

import { listBoxes } from "../calls/boxes.js";
import { createValue } from "../store.js";
import { selectionOf, sortOf } from "./filters.js";
import { createPager } from "./pager.js";
import { NOTHING } from "./selection.js";

/**
 * @typedef {object} Place
 * @property {string} key
 * @property {import("./pager.js").Pager} pager
 * @property {import("../store.js").Value<import("./selection.js").Selection>} selection
 * @property {{offset: number, seen: number}} scroll  how far down, and when one left
 * @property {() => void} end
 */

const KEPT = 4;
/** Others may be answering: a list that was left longer ago is read again. */
const FRESH_MS = 10 * 60_000;

/** @type {Map<string, Place>} the one used last comes last */
const places = new Map();

/** @param {import("../app.js").App} app @param {string} dataset @param {import("../router.js").Query} query @param {string} key @returns {Place} */
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
  for (const old of [...places.keys()].slice(0, -KEPT)) leave(old);
  return place;
}

/** Forget a list: it is read anew when it is wanted. @param {string} key */
export function leave(key) {
  places.get(key)?.end();
  places.delete(key);
}
