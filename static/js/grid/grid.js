// @ts-check
// The grid view: filters, status, bulk answers that are not saved yet, and the bar for selected boxes.

import { isUnanswered } from "../boxes/box.js";
import { FilterMenus, PlaceFilters, VerdictFilter, classChoices } from "../boxes/filter_bar.js";
import {
  SORTS,
  countOfMore,
  cycleVerdict,
  isFiltered,
  isShown,
  selectionOf,
  sortOf,
  withoutFilters,
} from "../boxes/filters.js";
import { get } from "../core/api.js";
import {
  useActions,
  useClosing,
  useDataset,
  useLoaded,
  useTask,
  useTopBar,
  useTyped,
  useValue,
} from "../core/hooks.js";
import { html, useEffect, useMemo, useRef, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { keyText, useKeyText, withKey } from "../core/keymap.js";
import { capital, countOf, countText } from "../core/numbers.js";
import { Failure, FailureLine, Notice } from "../core/parts.js";
import { linkTo } from "../core/router.js";
import { ANSWERS, AnswerButton } from "../review/answer_bar.js";
import { VERBS } from "../review/bulk.js";
import { isBulkUndo } from "../review/outbox.js";
import { GridCells } from "./cells.js";
import { leave, placeOf } from "./pager.js";
import { allBut, everything, nothing, sizeOf, toggled } from "./selection.js";

/** @import { Answer } from "../boxes/box.js" */
/** @import { BoxSelection } from "../core/openapi.js" */
/** @import { Query, Route } from "../core/router.js" */
/** @import { ReviewApp as App } from "../review/answers.js" */
/** @import { OpenBulkItem } from "../review/sender.js" */
/** @import { Pager, Place } from "./pager.js" */
/** @import { Selection } from "./selection.js" */

/** @param {{app: App, route: Route}} props */
export function GridView({ app, route }) {
  const name = route.params.dataset ?? "";
  useTopBar(app, { title: `Grid · ${name}`, dataset: name });
  const dataset = useDataset(name);
  /** @param {Query} query */
  const setQuery = (query) => app.router.replace(linkTo("grid", { dataset: name }, query));
  const failed = dataset.state === "error" && !dataset.value;
  return html`<main id="main" class="grid-view" tabindex="-1">
    <h1 class="sr-only">Boxes of ${name} as a grid</h1>
    ${
      failed
        ? html`<${Failure} error=${dataset.error} onRetry=${dataset.reload} />`
        : html`<${GridFilters} app=${app} dataset=${name} classes=${dataset.value?.classes ?? []} query=${route.query}
          onChange=${setQuery} />
        <${UnsentBulkAnswers} app=${app} dataset=${name} />
        <${LeftOut} app=${app} dataset=${name} />
        <${Boxes} app=${app} dataset=${name} query=${route.query} onQuery=${setQuery}
          inAll=${dataset.value?.counts.boxes ?? null} />`
    }
  </main>`;
}

/** @param {{app: App, dataset: string, query: Query, inAll: number | null, onQuery: (query: Query) => void}} props */
function Boxes({ app, dataset, query, inAll, onQuery }) {
  const { place, update } = usePlace(app, dataset, query);
  const { pager } = place;
  usePager(app, place);
  useValue(place.selection);
  const selection = place.selection.get();
  const select = place.selection.set;
  const frameSize = useFrameSize(app, dataset);
  const latest = useRef({ place, query });
  latest.current = { place, query };
  const actions = useMemo(() => createGridActions(app, dataset, () => latest.current), [dataset]);
  useActions(app, actions.byName);
  useEffect(() => app.boxes.reloads.observe(update), [update]);
  useEffect(() => {
    let isOver = false;
    place.isOutdated.then((isOutdated) => isOutdated && !isOver && update());
    return () => void (isOver = true);
  }, [place]);

  const total = pager.total();
  if (pager.known() === 0 && pager.error()) return html`<${Failure} error=${pager.error()} onRetry=${pager.retry} />`;
  if (pager.isWhole() && pager.known() === 0)
    return html`<${NoBoxes} query=${query} inAll=${inAll} onQuery=${onQuery} />`;
  const selected = sizeOf(selection, total);
  return html`<${GridStatus} app=${app} pager=${pager} query=${query} inAll=${inAll} selected=${selected}
    onUpdate=${update} onAll=${() => select(everything(selection))} />
  <${GridCells} key=${place.key} app=${app} place=${place} frameSize=${frameSize} actions=${actions} />
  <${SelectionBar} app=${app} selected=${selected} isAll=${selection.all} actions=${actions.byName}
    onNone=${() => select(nothing(selection))} />
  <div class="sr-only" role="status">${selected ? `${countOf(selected, "box", "boxes")} selected` : ""}</div>`;
}

const ANSWERS_TO_MANY = [...ANSWERS, { action: "clear", icon: "minus", text: "Remove" }];

/**
 * The buttons for answers on the selected boxes.
 * @param {{app: App, selected: number, isAll: boolean, actions: Record<string, () => void>, onNone: () => void}} props
 */
function SelectionBar({ app, selected, isAll, actions, onNone }) {
  const escape = useKeyText(app, "escape");
  if (selected === 0) return null;
  return html`<div class="bar bar--answer bar--grid" role="toolbar" aria-label="Answer for the selected boxes">
    <span class="bar__count"><b class="num">${countText(selected)}</b> ${isAll ? "of this filter" : "selected"}</span>
    ${ANSWERS_TO_MANY.map((row) => html`<${AnswerButton} app=${app} row=${row} actions=${actions} />`)}
    <span class="bar__rule" aria-hidden="true"></span>
    <button class="answer" aria-label="Select none" title=${withKey("Select none", escape)}
      onClick=${onNone}><${Icon} name="cross" /></button>
  </div>`;
}

/**
 * The list of boxes that match the filters, as it was left; `update` reads it again.
 * @param {App} app @param {string} dataset @param {Query} query
 */
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

/** Draw again whenever the list changes. @param {App} app @param {Place} place */
function usePager(app, { pager }) {
  const [, setVersion] = useState(0);
  useEffect(() => {
    const change = () => setVersion((n) => n + 1);
    const stop = pager.observe(change);
    const stopUnsent = app.sender.state.observe(change);
    pager.want(0, 1);
    change();
    return () => {
      stop();
      stopUnsent();
    };
  }, [pager]);
}

/**
 * The size of the first frame; nearly always all frames of a dataset have the same.
 * @param {App} app @param {string} dataset
 */
function useFrameSize(app, dataset) {
  const frames = useLoaded(
    (signal) => get("/api/v1/datasets/{dataset}/frames", { path: { dataset }, query: { limit: 1 }, signal }),
    [dataset],
  );
  const frame = frames.value?.items[0];
  return useMemo(() => (frame?.width && frame.height ? { width: frame.width, height: frame.height } : null), [frame]);
}

/** @param {{query: Query, inAll: number | null, onQuery: (query: Query) => void}} props */
function NoBoxes({ query, inAll, onQuery }) {
  if (!isFiltered(query))
    return html`<${Notice} icon="grid" title="No boxes yet"><p>No frames have been uploaded to this dataset.</p><//>`;
  const clear = html`<button class="button" onClick=${() => onQuery(withoutFilters(query))}>Clear the filters</button>`;
  return html`<${Notice} icon="filter" title="No box matches" actions=${clear}>
    <p>
      ${
        inAll
          ? `All ${countOf(inAll, "box", "boxes")} of this dataset are hidden by the filters.`
          : "Every box is hidden by the filters."
      }</p>
  <//>`;
}

/**
 * How many boxes match a filter, and the snapshot that identifies their current state.
 * @param {string} dataset @param {BoxSelection} filter
 */
async function countBoxes(dataset, filter) {
  const { total, snapshot } = await get("/api/v1/boxes", { query: { dataset, ...filter, limit: 1, count: true } });
  return typeof total === "number" && snapshot ? { total, snapshot } : null;
}

/**
 * How many boxes that match a filter have an answer; null: all of them.
 * @param {string} dataset @param {BoxSelection} filter
 */
async function countAnswered(dataset, filter) {
  const { review } = filter;
  if (review === "none") return 0;
  if (review && review !== "undecided") return null;
  const answered = await countBoxes(dataset, { ...filter, review: review ? "unsure" : "any" });
  return answered?.total ?? 0;
}

/**
 * @param {App} app @param {string} dataset
 * @param {() => {place: Place, query: Query}} page the current place and query
 */
function createGridActions(app, dataset, page) {
  /** Read again for each action: keys may be pressed faster than the page is drawn. */
  function now() {
    const { place, query } = page();
    return { selection: place.selection.get(), pager: place.pager, query };
  }

  /** @param {Selection} selection */
  const select = (selection) => page().place.selection.set(selection);

  /** @param {Answer} verdict */
  function answer(verdict) {
    const { selection, pager, query } = now();
    const total = pager.total();
    if (selection.all && total !== null)
      app.bulkAnswers.answerAll(dataset, verdict, selectionOf(query), {
        total,
        snapshot: pager.snapshot(),
        knownIds: [...pager.revisions().keys()],
      });
    else if (selection.ids.size) answerSelected(verdict, [...selection.ids]);
    else {
      const key = keyText("select", app.keys.get(), "grid");
      return app.toasts.show(`Select boxes first: ${key ? `click, drag, or press ${key}` : "click or drag"}.`);
    }
    select(nothing(selection));
  }

  /** @param {Answer} verdict @param {number[]} ids */
  function answerSelected(verdict, ids) {
    const unanswered = new Set(
      verdict === "clear"
        ? app.boxes
            .all(ids)
            .filter(isUnanswered)
            .map(({ box_id }) => box_id)
        : [],
    );
    const meant = ids.filter((id) => !unanswered.has(id));
    if (meant.length === 0) app.toasts.show("None of these boxes has an answer.");
    else app.bulkAnswers.answer(dataset, verdict, meant, now().pager.revisions());
  }

  function undo() {
    app.undo((box) => {
      const { place } = page();
      const index = place.pager.indexOf(box.box_id);
      if (index >= 0) place.show(index);
      else app.router.go(linkTo("frame", { id: box.frame_id }, { box: String(box.box_id) }));
    });
  }

  /** @param {number} index */
  function toggle(index) {
    const { selection, pager } = now();
    const id = pager.idAt(index);
    if (id === undefined) return;
    if (!selection.all) return select(toggled(selection, index, id));
    if (pager.isWhole()) return select(allBut(selection, pager.allIds(), index, id));
    app.toasts.show("All boxes that match the filters are selected. Narrow the filters to exclude some.");
  }

  function open() {
    const { selection, pager, query } = now();
    const box = pager.at(selection.focus);
    if (box) app.router.go(linkTo("frame", { id: box.frame_id }, { ...query, box: String(box.box_id) }));
  }

  return {
    toggle,
    open,

    all() {
      const { selection, pager } = now();
      const total = pager.total();
      if (total === null) return app.toasts.show("The number of boxes is not known yet.");
      select(everything(selection));
      app.announcement.set(`All ${countOf(total, "box", "boxes")} selected`);
    },

    /** By the names of the keymap. */
    byName: {
      keep: () => answer("keep"),
      reject: () => answer("reject"),
      unsure: () => answer("unsure"),
      clear: () => answer("clear"),
      undo,
      open,
      cycleVerdict: () => cycleVerdict(app),
      blind: () => app.prefs.change({ blind: !app.prefs.get().blind }),
      grid: () => app.router.go(linkTo("frames", { dataset }, now().query)),
      escape: () => select(nothing(now().selection)),
    },
  };
}

/** @typedef {ReturnType<typeof createGridActions>} GridActions */

const TYPING_PAUSE_MS = 400;
const SMALLEST_PX = 72;
const LARGEST_PX = 360;

/**
 * @param {{app: App, dataset: string, classes: readonly string[], query: Query, onChange: (query: Query) => void}}
 *   props
 */
function GridFilters({ app, dataset, classes, query, onChange }) {
  const [isOpen, setOpen] = useState(false);
  return html`<div class="grid-filters" role="search" aria-label="Filter boxes">
    <${VerdictFilter} query=${query} onChange=${onChange} />
    <button class="button grid-filters__toggle ${isFiltered(query) ? "is-set" : ""}" aria-expanded=${isOpen}
      onClick=${() => setOpen(!isOpen)}><${Icon} name="filter" />Filters</button>
    <div class="grid-filters__rest ${isOpen ? "is-open" : ""}">
      <${FilterMenus} query=${query} keys=${["bin", "reason", "class", "review"]}
        own=${{ class: { choices: classChoices(classes) } }} onChange=${onChange}
        onClear=${isFiltered(query) ? () => onChange(withoutFilters(query)) : null}>
        <${MoreFilters} dataset=${dataset} query=${query} onChange=${onChange} />
      <//>
    </div>
    <span class="grid-filters__middle"></span>
    <${Order} value=${sortOf(query)} onChange=${(/** @type {string} */ sort) => onChange({ ...query, sort })} />
    <${SizeSlider} app=${app} />
  </div>`;
}

/** @param {{value: string, onChange: (value: string) => void}} props */
function Order({ value, onChange }) {
  return html`<span class="select">
    <select aria-label="Order" value=${value}
      onChange=${(/** @type {{currentTarget: HTMLSelectElement}} */ event) => onChange(event.currentTarget.value)}>
      ${SORTS.map((sort) => html`<option value=${sort.value}>${sort.text}</option>`)}
    </select>
  </span>`;
}

/** @param {{app: App}} props */
function SizeSlider({ app }) {
  const { cropSize } = useValue(app.prefs);
  /** @param {{currentTarget: HTMLInputElement}} event */
  const onInput = ({ currentTarget }) => app.prefs.change({ cropSize: Number(currentTarget.value) });
  return html`<label class="size"><${Icon} name="grid" /><span class="sr-only">Size of the crops</span>
    <input class="slider" type="range" min=${SMALLEST_PX} max=${LARGEST_PX} step="4" value=${cropSize}
      onInput=${onInput} />
  </label>`;
}

/**
 * The less common filters, in a menu.
 * @param {{dataset: string, query: Query, onChange: (query: Query) => void}} props
 */
function MoreFilters({ dataset, query, onChange }) {
  const root = useRef(/** @type {HTMLDivElement | null} */ (null));
  const [isOpen, setOpen] = useState(false);
  useClosing(root, isOpen, () => setOpen(false));
  const count = countOfMore(query);
  /** @param {string} key */
  const flag = (key) => (/** @type {{currentTarget: HTMLInputElement}} */ event) =>
    onChange({ ...query, [key]: event.currentTarget.checked ? "true" : "" });
  return html`<div class="menu" ref=${root}>
    <button class="button ${count ? "is-set" : ""}" aria-expanded=${isOpen}
      onClick=${() => setOpen(!isOpen)}><${Icon} name="filter" />More${count > 0 && html` <b class="num">${count}</b>`}
    </button>
    ${
      isOpen &&
      html`<div class="menu__panel more-filters" role="group" aria-label="More filters">
        <label class="switch" title="Boxes with too few pixels to be certain on which side of the threshold they are">
          <input type="checkbox" checked=${query.toss_up === "true"} onChange=${flag("toss_up")} />
          <span>Toss-ups only</span></label>
        <label
          class="switch"><input type="checkbox" checked=${query.conflict === "true"} onChange=${flag("conflict")} />
          <span>The filter contradicts a person</span></label>
        <${Range} text="Match" unit="%" keys=${["match_min", "match_max"]} most=${100} query=${query}
          onChange=${onChange} />
        <${Range} text="Distance" unit="m" keys=${["distance_min", "distance_max"]} query=${query}
          onChange=${onChange} />
        <${Places} dataset=${dataset} query=${query} onChange=${onChange} />
      </div>`
    }
  </div>`;
}

/**
 * Asks for the names only while the menu is open.
 * @param {{dataset: string, query: Query, onChange: (query: Query) => void}} props
 */
function Places({ dataset, query, onChange }) {
  const path = { dataset };
  const stats = useLoaded((signal) => get("/api/v1/datasets/{dataset}/stats", { path, signal }), [dataset]);
  return html`<${PlaceFilters} stats=${stats.value} query=${query} onChange=${onChange} />`;
}

/**
 * @param {{text: string, unit: string, keys: [string, string], most?: number, query: Query, onChange: (query: Query) =>
 *   void}} props
 */
function Range({ text, unit, keys, most, query, onChange }) {
  return html`<fieldset class="range">
    <legend>${text}</legend>
    ${keys.map(
      (
        key,
        i,
      ) => html`<${RangeEnd} key=${key} label=${`${text}, ${i ? "at most" : "at least"}`} hint=${i ? "to" : "from"}
        most=${most} value=${query[key] ?? ""}
        onChange=${(/** @type {string} */ value) => onChange({ ...query, [key]: value })} />`,
    )}
    <span class="faint">${unit}</span>
  </fieldset>`;
}

/** @param {{label: string, hint: string, most?: number, value: string, onChange: (value: string) => void}} props */
function RangeEnd({ label, hint, most, value, onChange }) {
  const { shown, onInput, onBlur } = useTyped(value, onChange, TYPING_PAUSE_MS);
  return html`<input type="number" min="0" max=${most} step="any" inputmode="decimal" aria-label=${label}
    placeholder=${hint} value=${shown} onInput=${onInput} onBlur=${onBlur} />`;
}

/**
 * @param {{app: App, pager: Pager, query: Query, inAll: number | null, selected: number, onUpdate: () => void, onAll:
 *   () => void}} props
 */
function GridStatus({ app, pager, query, inAll, selected, onUpdate, onAll }) {
  const total = pager.total();
  const key = useKeyText(app, "select");
  const left = pager.changed().filter((box) => !isShown(box, query)).length;
  const hidden = total !== null && inAll !== null && isFiltered(query) ? Math.max(0, inAll - total) : 0;
  return html`<div class="grid-status">
    <p role="status">
      ${
        total === null && pager.known() === 0
          ? "Loading boxes"
          : html`<b class="num">${total === null ? `${countText(pager.known())}+` : countText(total)}</b> ${
              total === 1 ? "box" : "boxes"
            }`
      }
      ${hidden > 0 && html`<span class="faint"> · ${countText(hidden)} hidden by the filters</span>`}
    </p>
    ${
      left > 0 &&
      html`<button class="button button--small"
        onClick=${onUpdate}>${countOf(left, "box no longer matches", "boxes no longer match")} · update</button>`
    }
    ${pager.error() && html`<${FailureLine} error=${pager.error()} onRetry=${pager.retry} />`}
    <span class="grid-status__middle"></span>
    <span
      class="faint grid-status__hint">${selected ? "" : `Click${key ? `, drag or ${key}` : " or drag"} selects`}</span>
    ${
      total !== null &&
      total > 0 &&
      html`<button class="button button--small" onClick=${onAll}>Select all ${countText(total)}</button>`
    }
  </div>`;
}

/**
 * The boxes that the last bulk answer, or its undo, did not change, if it was on this dataset.
 * @param {{app: App, dataset: string}} props
 */
function LeftOut({ app, dataset }) {
  const report = useValue(app.bulkAnswers.report);
  if (report?.dataset !== dataset) return null;
  const shown = report.boxes.slice(0, 12);
  return html`<div class="strip" role="status">
    <${Icon} name="warn" />
    <p>${report.text} ${shown.map((id) => html`<${BoxLink} app=${app} id=${id} />`)}
      ${report.boxes.length > shown.length && html` and ${countText(report.boxes.length - shown.length)} more`}</p>
    <button class="button button--quiet button--icon" aria-label="Dismiss"
      onClick=${() => app.bulkAnswers.report.set(null)}><${Icon} name="cross" /></button>
  </div>`;
}

/** @param {{app: App, id: number}} props */
function BoxLink({ app, id }) {
  const box = app.boxes.get(id);
  if (!box) return html`<span class="strip__box num">${id}</span>`;
  return html`<a class="strip__box"
    href=${linkTo("frame", { id: box.frame_id }, { box: String(id) })}>${box.class} ${box.id}</a>`;
}

/** @type {Record<string, string>} */
const STATES = { changed: "Not done", waiting: "Not sent yet", refused: "Refused" };

/**
 * Bulk answers, and their undos, that the server has not stored, each with what the person can do about it.
 * @param {{app: App, dataset: string}} props
 */
function UnsentBulkAnswers({ app, dataset }) {
  const { bulkItems } = useValue(app.sender.state);
  const undone = new Set(bulkItems.map(({ item }) => isBulkUndo(item) && item.bulkKey)); // only the undo is listed
  const unsent = bulkItems.filter(
    ({ item, state }) => item.dataset === dataset && state !== "sending" && !undone.has(item.key),
  );
  return unsent.map((one) => html`<${UnsentStrip} key=${one.item.key} app=${app} ...${one} />`);
}

/**
 * @param {{total: number, answered: number}} now @param {number} before how many boxes the filter selected
 * @param {boolean} isRemoval
 */
function changedText({ total, answered }, before, isRemoval) {
  const text = `The filter selects ${countOf(total, "box", "boxes")} now, ${countText(before)} when you selected them.`;
  if (answered === 0 || isRemoval) return text;
  return `${text} ${countText(answered)} of these ${answered === 1 ? "has" : "have"} an answer, which yours would replace.`;
}

/** @param {{app: App} & OpenBulkItem} props */
function UnsentStrip({ app, item, state, text }) {
  /** The boxes that the filter selects by now, once the person has asked, and how many of them have an answer. */
  const [now, setNow] = useState(/** @type {{total: number, snapshot: string, answered: number} | null} */ (null));
  const bulk = isBulkUndo(item) ? null : item;
  const isChanged = bulk !== null && state === "changed";
  const what = `${bulk ? VERBS[bulk.verdict] : "undo the answers on"} ${countOf(item.count, "box", "boxes")}`;
  const count = useTask(async () => {
    if (!bulk) return;
    const { dataset, filter = {} } = bulk;
    const [all, answered] = await Promise.all([countBoxes(dataset, filter), countAnswered(dataset, filter)]);
    setNow(all && { ...all, answered: answered ?? all.total });
    app.boxes.reload();
  }, app.toasts.fail);
  return html`<div class="strip strip--error" role="alert">
    <${Icon} name="cloud" />
    <p>
      <b>${STATES[state]}: ${what}.</b> ${
        now
          ? changedText(now, item.count, bulk?.verdict === "clear")
          : text
            ? `${capital(text).replace(/\.$/, "")}.`
            : ""
      }</p>
    <div class="strip__actions">
      ${
        isChanged &&
        !now &&
        html`<button class="button button--small" disabled=${count.isBusy} onClick=${count.run}>Count again</button>`
      }
      ${
        bulk &&
        isChanged &&
        now &&
        html`<button class="button button--small" onClick=${() => app.bulkAnswers.answerAgain(bulk, now)}>
          ${capital(`${VERBS[bulk.verdict]} all ${countText(now.total)}`)}</button>`
      }
      ${state === "waiting" && html`<button class="button button--small" onClick=${app.resume}>Send now</button>`}
      ${
        bulk &&
        state === "refused" &&
        html`<button class="button button--small"
          onClick=${() => app.bulkAnswers.answerAgain(bulk)}>Send again</button>`
      }
      ${
        bulk &&
        html`<button class="button button--small button--quiet"
          onClick=${() => app.bulkAnswers.discard(bulk)}>${state === "waiting" && bulk.attempted ? "Undo" : "Discard"}
        </button>`
      }
    </div>
  </div>`;
}
