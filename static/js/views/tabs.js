// @ts-check
// The navigation of a dataset: one tab per row of the router's table that has a `nav` name.

import { html, useLayoutEffect, useRef } from "../html.js";
import { filtersOf } from "../boxfilter.js";
import { ROUTES, linkTo } from "../router.js";
import { useValue } from "./hooks.js";

/** Does this view have the tabs above it? @param {import("../router.js").Route} route */
export const hasTabs = (route) => ROUTES.some(({ name, nav }) => nav && name === route.name);

/** The filters go along: what was looked at as frames can be looked at as a queue. @param {{app: import("../app.js").App}} props */
export function DatasetTabs({ app }) {
  const route = useValue(app.router.route);
  const list = useRef(/** @type {HTMLUListElement | null} */ (null));
  useLayoutEffect(() => list.current?.querySelector("[aria-current]")?.scrollIntoView({ block: "nearest", inline: "center" }), [route.name]);
  if (!hasTabs(route)) return null;
  const { dataset = "" } = route.params;
  return html`<nav class="tabs" aria-label="Dataset">
    <ul class="tabs__list" ref=${list}>
      ${ROUTES.filter(({ nav }) => nav).map(
        ({ name, nav }) => html`<li key=${name}>
          <a class="tabs__item" href=${linkTo(name, { dataset }, filtersOf(route.query))} aria-current=${name === route.name ? "page" : undefined}>${nav}</a>
        </li>`,
      )}
    </ul>
  </nav>`;
}
