// @ts-check
// The frames of a dataset as thumbnails, with filters; more are loaded while one scrolls.

import { NearPicture } from "../boxes/crops.js";
import { FilterMenus, PlaceFilters, VerdictFilter, classChoices } from "../boxes/filter_bar.js";
import { LIST_KEYS, filtersOf, selectionOf } from "../boxes/filters.js";
import { VerdictBar } from "../boxes/signs.js";
import { get, pictureUrl } from "../core/api.js";
import { useDataset, useGrowth, useLazy, useLoaded, usePages, useTopBar, useTyped, useValue } from "../core/hooks.js";
import { html, useEffect, useRef, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf, countText } from "../core/numbers.js";
import { createLazy } from "../core/observable.js";
import { Failure, FailureLine, Notice } from "../core/parts.js";
import { linkTo } from "../core/router.js";
import { DatasetDialog } from "./settings.js";

/** @import { FrameSummary as FrameItem, Stats } from "../core/openapi.js" */
/** @import { Query, Route } from "../core/router.js" */
/** @import { UploadApp as App } from "../upload/uploader.js" */

const PAGE_SIZE = 60;

/** Most frames that are appended at once while a dataset grows. */
const MOST_NEWER = 1000;

/** The switch to stronger evidence, loaded after the frames are asked for. */
const STRONGER = createLazy(async () => (await import("../tuning/evidence.js")).StrongerEvidence);

/** Nothing where the strongest evidence decides. @param {{app: App, dataset: string, evidence: string}} props */
function Evidence({ app, dataset, evidence }) {
  const { value: StrongerEvidence } = useLazy(evidence === "auto" ? null : STRONGER);
  return StrongerEvidence ? html`<${StrongerEvidence} app=${app} dataset=${dataset} />` : null;
}

/** @param {{app: App, route: Route}} props */
export function FramesView({ app, route }) {
  const name = route.params.dataset ?? "";
  useTopBar(app, { title: name, dataset: name });
  const uploads = useValue(app.uploads.ended);
  const [isOpen, setOpen] = useState(false);
  const dataset = useDataset(name, uploads);
  useGrowth(dataset, dataset.value?.counts.frames ?? 0, dataset.value?.created_at);
  const counts = dataset.value?.counts;
  const path = { dataset: name };
  const stats = useLoaded((signal) => get("/api/v1/datasets/{dataset}/stats", { path, signal }), [name, uploads]);
  /** @param {Query} query */
  const setQuery = (query) => app.router.replace(linkTo("frames", { dataset: name }, query));

  return html`<main id="main" class="page" tabindex="-1">
    <div class="page__head">
      <h1>${name}</h1>
      ${
        counts &&
        html`<span class="faint">
          ${countOf(counts.frames, "frame")} · ${countOf(counts.boxes, "box", "boxes")} · ${countOf(
            counts.to_review,
            "needs review",
            "need review",
          )}</span>`
      }
      ${
        counts &&
        html`<button class="button page__settings" onClick=${() => setOpen(true)}>
          <${Icon} name="settings" />Dataset settings
          ${counts.problems > 0 && html`<span class="warn">${countOf(counts.problems, "refused frame")}</span>`}
        </button>`
      }
      ${
        isOpen &&
        dataset.value &&
        html`<${DatasetDialog} app=${app} dataset=${dataset.value}
          onClose=${() => setOpen(false)} onChanged=${dataset.reload} />`
      }
    </div>
    ${
      dataset.state === "error"
        ? html`<${Failure} error=${dataset.error} onRetry=${dataset.reload} />`
        : html`${dataset.value && html`<${Evidence} app=${app} dataset=${name} evidence=${dataset.value.evidence} />`}
        <${FrameFilters} classes=${dataset.value?.classes ?? []} stats=${stats.value} query=${route.query}
          onChange=${setQuery} />
        <${FrameGrid} key=${`${name} ${uploads} ${JSON.stringify(apiParams(route.query))}`} app=${app}
          dataset=${name} query=${route.query} total=${counts?.frames ?? null} onClear=${() => setQuery({})} />`
    }
  </main>`;
}

/** @param {Query} query */
const apiParams = (query) => ({ ...selectionOf(filtersOf(query)), key: query.key });

/** @param {Query} query */
const hasFilters = (query) => [...LIST_KEYS, "key"].some((key) => query[key]);

/** @param {{app: App, dataset: string, query: Query, total: number | null, onClear: () => void}} props */
function FrameGrid({ app, dataset, query, total, onClear }) {
  const { items, isDone, error, more, append } = usePages(
    `${dataset} ${JSON.stringify(apiParams(query))}`,
    PAGE_SIZE,
    (limit, cursor) =>
      get("/api/v1/datasets/{dataset}/frames", { path: { dataset }, query: { ...apiParams(query), limit, cursor } }),
  );
  const isFiltered = hasFilters(query);
  const seen = useRef(total);
  useEffect(() => {
    const grown = (total ?? 0) - (seen.current ?? total ?? 0);
    seen.current = total;
    const lacks = !isFiltered && (total ?? 0) > items.length;
    if (!isDone || (grown <= 0 && !lacks)) return;
    const newest = {
      ...apiParams(query),
      sort: /** @type {const} */ ("-id"),
      limit: Math.min(grown + PAGE_SIZE, MOST_NEWER),
    };
    get("/api/v1/datasets/{dataset}/frames", { path: { dataset }, query: newest }).then(
      ({ items: found }) => append((known) => found.filter(({ id }) => !known.some((one) => one.id === id)).reverse()),
      app.toasts.fail,
    );
  }, [total, isDone]);
  if (error && items.length === 0) return html`<${Failure} error=${error} onRetry=${more} />`;
  if (isDone && items.length === 0) return html`<${NoFrames} isFiltered=${isFiltered} onClear=${onClear} />`;
  return html`<p class="page__count" role="status">${countLine(items.length, isDone, isFiltered, total)}</p>
  <ul class="thumbs" aria-busy=${!isDone && items.length === 0}>
    ${items.map((frame) => html`<li key=${frame.id}><${Thumb} app=${app} frame=${frame} query=${query} /></li>`)}
    ${
      items.length === 0 &&
      Array.from(
        { length: 12 },
        () => html`<li class="thumb thumb--skeleton" aria-hidden="true"><div class="thumb__picture shimmer" /></li>`,
      )
    }
  </ul>
  ${error && html`<${FailureLine} error=${error} onRetry=${more} />`}
  ${!isDone && !error && html`<${Sentinel} onSeen=${more} />`}`;
}

/** @param {number} shown @param {boolean} isDone @param {boolean} isFiltered @param {number | null} total */
function countLine(shown, isDone, isFiltered, total) {
  if (shown === 0) return "Loading frames";
  if (!isDone) return `First ${countText(shown)}${!isFiltered && total ? ` of ${countText(total)}` : ""} frames`;
  const hidden = isFiltered && total ? total - shown : 0;
  return countOf(shown, "frame") + (hidden > 0 ? ` · ${countText(hidden)} hidden by the filters` : "");
}

/** Calls `onSeen` when it is scrolled into view. @param {{onSeen: () => void}} props */
function Sentinel({ onSeen }) {
  const element = useRef(/** @type {HTMLDivElement | null} */ (null));
  useEffect(() => {
    const watcher = new IntersectionObserver((entries) => entries.some((entry) => entry.isIntersecting) && onSeen(), {
      rootMargin: "600px",
    });
    if (element.current) watcher.observe(element.current);
    return () => watcher.disconnect();
  }, [onSeen]);
  return html`<div class="more"
    ref=${element}><span class="spinner" aria-hidden="true"></span><span class="sr-only">Loading more frames</span>
  </div>`;
}

/** @param {{app: App, frame: FrameItem, query: Query}} props */
function Thumb({ app, frame, query }) {
  const { id, key, counts, has_image, lossy } = frame;
  const waiting = counts.to_review
    ? countOf(counts.to_review, "needs review", "need review")
    : !counts.boxes
      ? "no boxes"
      : counts.reviewed
        ? "reviewed"
        : "nothing to review";
  return html`<a class="thumb" href=${linkTo("frame", { id }, query)} title=${key}>
    <div class="thumb__picture">
      ${
        has_image
          ? html`<${NearPicture}
            url=${pictureUrl("/api/v1/frames/{frame_id}/thumbnail", { path: { frame_id: id } })} />`
          : html`<${Icon} name="image" />`
      }
      ${lossy && html`<span class="thumb__flag">lossy</span>`}
    </div>
    <div class="thumb__text"><span class="thumb__key">${key}</span>
      <span class="faint num">${countText(counts.boxes)}</span></div>
    <${VerdictBar} counts=${counts} />
    <div class="thumb__text faint"><span>${waiting}</span></div>
  </a>`;
}

/** @param {{isFiltered: boolean, onClear: () => void}} props */
function NoFrames({ isFiltered, onClear }) {
  return isFiltered
    ? html`<${Notice} icon="filter" title="No frame matches"
      actions=${html`<button class="button" onClick=${onClear}>Clear the filters</button>`}>
      <p>Every frame of this dataset is hidden by the filters.</p>
    <//>`
    : html`<${Notice} title="No frames yet"><p>No frames have been uploaded to this dataset.</p><//>`;
}

const TYPING_PAUSE_MS = 250;

/** @param {{classes: readonly string[], stats: Stats | null, query: Query, onChange: (query: Query) => void}} props */
function FrameFilters({ classes, stats, query, onChange }) {
  return html`<div class="filters" role="search" aria-label="Filter frames">
    <${VerdictFilter} query=${query} onChange=${onChange} />
    <${FilterMenus} query=${query} own=${{ class: { choices: classChoices(classes) } }} onChange=${onChange}
      onClear=${hasFilters(query) ? () => onChange({}) : null}>
      <${PlaceFilters} stats=${stats} query=${query} onChange=${onChange} />
      <${KeyPrefix} value=${query.key ?? ""} onChange=${(/** @type {string} */ key) => onChange({ ...query, key })} />
    <//>
  </div>`;
}

/** @param {{value: string, onChange: (value: string) => void}} props */
function KeyPrefix({ value, onChange }) {
  const { shown, onInput, onBlur } = useTyped(value, onChange, TYPING_PAUSE_MS);
  return html`<label class="search"><span class="sr-only">Key starts with</span>
    <input type="search" value=${shown} placeholder="Key starts with…" spellcheck=${false} onInput=${onInput}
      onBlur=${onBlur} />
  </label>`;
}
