// @ts-check
// Crops by the hundred: filters above, a grid that scrolls over all of them, and one bar that
// answers for everything selected.

import { html, useEffect, useMemo, useRef, useState } from "../html.js";
import { isFiltered, selectionOf, sortOf, withoutFilters } from "../grid/filters.js";
import { leave, placeOf } from "../grid/places.js";
import { everything, nothing, sizeOf } from "../grid/selection.js";
import { linkTo } from "../router.js";
import { countOf } from "../wording.js";
import { createGridActions } from "../grid/actions.js";
import { GridBar } from "./grid_bar.js";
import { GridCells } from "./grid_cells.js";
import { GridFilters } from "./grid_filters.js";
import { GridStatus, OpenActs } from "./grid_status.js";
import { useActions, useLoaded, useTitle, useValue } from "./hooks.js";
import { Failure, Notice } from "./parts.js";
import { TopBar } from "./topbar.js";

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../router.js").Query} Query */

/** @param {{app: App, route: import("../router.js").Route}} props */
export function GridView({ app, route }) {
  const name = route.params.dataset ?? "";
  useTitle(`Grid · ${name}`);
  const dataset = useLoaded(app, (signal) => app.api.dataset(name, signal), [name]);
  /** @param {Query} query */
  const setQuery = (query) => app.router.replace(linkTo("grid", { dataset: name }, query));
  const crumbs = [{ text: "Datasets", href: linkTo("datasets") }, { text: name }];
  const failed = dataset.state === "error" && !dataset.value;
  return html`<${TopBar} app=${app} crumbs=${crumbs} />
    <main id="main" class="grid-view" tabindex="-1">
      <h1 class="sr-only">Boxes of ${name} as a grid</h1>
      ${failed
        ? html`<${Failure} error=${dataset.error} onRetry=${dataset.reload} />`
        : html`<${GridFilters} app=${app} classes=${dataset.value?.classes ?? []} query=${route.query} onChange=${setQuery} />
            <${OpenActs} app=${app} dataset=${name} />
            <${Boxes} key=${name} app=${app} dataset=${name} query=${route.query} onQuery=${setQuery}
              inAll=${dataset.value?.counts.boxes ?? null} />`}
    </main>`;
}

/** @param {{app: App, dataset: string, query: Query, inAll: number | null, onQuery: (query: Query) => void}} props */
function Boxes({ app, dataset, query, inAll, onQuery }) {
  const { place, update } = usePlace(app, dataset, query);
  const { pager } = place;
  const version = usePager(app, place);
  useValue(place.selection);
  const selection = place.selection.get();
  const select = place.selection.set;
  const frameSize = useFrameSize(app, dataset);
  const latest = useRef({ place, query });
  latest.current = { place, query };
  const actions = useMemo(() => createGridActions(app, dataset, () => latest.current), [dataset]);
  useActions(app, actions.byName);
  useEffect(() => app.bulk.sweeps.observe(update), [update]);

  const total = pager.total();
  if (pager.known() === 0 && pager.error()) return html`<${Failure} error=${pager.error()} onRetry=${pager.retry} />`;
  if (pager.isWhole() && pager.known() === 0) return html`<${Nothing} query=${query} inAll=${inAll} onQuery=${onQuery} />`;
  const selected = sizeOf(selection, total);
  return html`<${GridStatus} app=${app} pager=${pager} query=${query} inAll=${inAll} version=${version} selected=${selected}
      onUpdate=${update} onAll=${() => select(everything(selection))} />
    <${GridCells} key=${place.key} app=${app} place=${place} version=${version} frameSize=${frameSize} actions=${actions} />
    <${GridBar} app=${app} selected=${selected} isAll=${selection.all} actions=${actions.byName} onNone=${() => select(nothing(selection))} />
    <div class="sr-only" role="status">${selected ? `${countOf(selected, "box", "boxes")} selected` : ""}</div>`;
}

/** The list of a filter, where one left it; `update` reads it anew. @param {App} app @param {string} dataset @param {Query} query */
function usePlace(app, dataset, query) {
  const [reading, setReading] = useState(0);
  const key = `${dataset} ${JSON.stringify([sortOf(query), selectionOf(query)])}`;
  const place = useMemo(() => placeOf(app, dataset, query, key), [key, reading]);
  const update = useMemo(
    () => () => {
      leave(key);
      setReading((n) => n + 1);
    },
    [key],
  );
  return { place, update };
}

/** Draw again whenever the list knows more. @param {App} app @param {import("../grid/places.js").Place} place */
function usePager(app, { pager }) {
  const [version, setVersion] = useState(0);
  useEffect(() => {
    const change = () => {
      app.notice(pager.error());
      setVersion((n) => n + 1);
    };
    const stop = pager.observe(change);
    const stopActs = app.bulk.open.observe(change);
    pager.want(0, 1);
    change();
    return () => {
      stop();
      stopActs();
    };
  }, [pager]);
  return version;
}

/** Frames of a dataset are of one size, nearly always. @param {App} app @param {string} dataset */
function useFrameSize(app, dataset) {
  const frames = useLoaded(app, (signal) => app.api.frames(dataset, { limit: 1 }, signal), [dataset]);
  const frame = frames.value?.items[0];
  return useMemo(() => (frame?.width && frame.height ? { width: frame.width, height: frame.height } : null), [frame]);
}

/** @param {{query: Query, inAll: number | null, onQuery: (query: Query) => void}} props */
function Nothing({ query, inAll, onQuery }) {
  if (!isFiltered(query)) return html`<${Notice} icon="grid" title="No boxes yet"><p>Nothing has been pushed to this dataset.</p><//>`;
  const clear = html`<button class="button" onClick=${() => onQuery(withoutFilters(query))}>Clear the filters</button>`;
  return html`<${Notice} icon="filter" title="No box matches" actions=${clear}>
    <p>${inAll ? `All ${countOf(inAll, "box", "boxes")} of this dataset are hidden by the filters.` : "Every box is hidden by the filters."}</p>
  <//>`;
}
