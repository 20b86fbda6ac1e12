// @ts-check
// Routes, links and the query: what is on the page is in the address, so that every view is a link.

import { createValue } from "./observable.js";

/** @typedef {Record<string, string>} Query  only what is set */
/** @typedef {{name: string, params: Record<string, string>, query: Query}} Route */

/**
 * One row per view. Rows with a `nav` name are the tabs of a dataset, in this order.
 * @type {readonly {name: string, pattern: string, nav?: string}[]}
 */
export const ROUTES = [
  { name: "datasets", pattern: "datasets" },
  { name: "home", pattern: "datasets/:dataset", nav: "Overview" },
  { name: "frames", pattern: "datasets/:dataset/frames", nav: "Frames" },
  { name: "queue", pattern: "datasets/:dataset/queue", nav: "Queue" },
  { name: "grid", pattern: "datasets/:dataset/grid", nav: "Grid" },
  { name: "thresholds", pattern: "datasets/:dataset/thresholds", nav: "Thresholds" },
  { name: "quality", pattern: "datasets/:dataset/quality", nav: "Quality" },
  { name: "runs", pattern: "datasets/:dataset/runs", nav: "Runs and exports" },
  { name: "frame", pattern: "frames/:id" },
  { name: "compare", pattern: "frames/:id/compare" },
];

/** @param {string} hash @returns {Route} */
export function parseHash(hash) {
  const [path = "", search = ""] = hash.replace(/^#?\/?/, "").split(/\?(.*)/s);
  const query = Object.fromEntries([...new URLSearchParams(search)].filter(([, value]) => value !== ""));
  if (path === "") return { name: "datasets", params: {}, query };
  for (const { name, pattern } of ROUTES) {
    const params = matchPath(pattern, path);
    if (params) return { name, params, query };
  }
  return { name: "unknown", params: { path }, query };
}

/** @param {string} pattern @param {string} path @returns {Record<string, string> | null} */
function matchPath(pattern, path) {
  const wanted = pattern.split("/");
  const found = path.replace(/\/$/, "").split("/");
  if (wanted.length !== found.length) return null;
  /** @type {Record<string, string>} */
  const params = {};
  for (const [i, part] of wanted.entries()) {
    const value = decoded(found[i] ?? "");
    if (part.startsWith(":")) params[part.slice(1)] = value;
    else if (part !== value) return null;
  }
  return params;
}

/** @param {string} part */
function decoded(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}

/** @param {string} name @param {Record<string, string | number>} [params] @param {Query} [query] */
export function linkTo(name, params = {}, query = {}) {
  const row = ROUTES.find((route) => route.name === name);
  if (!row) throw new RangeError(`there is no view ${name}`);
  const path = row.pattern.replace(/:(\w+)/g, (_, key) => encodeURIComponent(String(params[key] ?? "")));
  const search = new URLSearchParams(Object.entries(query).filter(([, value]) => value)).toString();
  return `#/${path}${search && `?${search}`}`;
}

/**
 * The code of a login link, and the view that it leads to, if it names one; null for any other address.
 * @param {string} hash
 */
export function loginOf(hash) {
  const [, code = "", to = ""] = /^#code=([^&]+)(?:&to=(.+))?$/.exec(hash) ?? [];
  return code ? { code: decoded(code), to: to && `#/${decoded(to)}` } : null;
}

/** A login link that leads to a view. @param {string} code @param {string} view  as `linkTo` gives it */
export const loginLink = (code, view) =>
  `${location.origin}/#code=${encodeURIComponent(code)}&to=${encodeURIComponent(view.replace("#/", ""))}`;

export function createRouter() {
  let address = location.hash;
  const route = createValue(parseHash(address));
  const read = () => {
    address = location.hash;
    route.set(parseHash(address));
  };
  addEventListener("hashchange", read);
  return {
    route,

    /** The address was changed from outside. */
    read,

    /** @param {string} hash */
    go(hash) {
      location.hash = hash;
    },

    /**
     * Same view, other details: no new entry in the history. A view that was left changes nothing, nor does
     * one whose address has changed without it having been told yet: the new address would be lost.
     * @param {string} hash
     */
    replace(hash) {
      if (hash === address || address !== location.hash || parseHash(hash).name !== parseHash(address).name) return;
      history.replaceState(history.state, "", hash);
      read();
    },
  };
}

/** @typedef {ReturnType<typeof createRouter>} Router */
