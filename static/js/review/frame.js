// @ts-check
// The view of one frame: the stage in the middle, the list of boxes on the left, the selected box on the right.

import { asShown, isUnanswered } from "../boxes/box.js";
import {
  cycleVerdict,
  filtersOf,
  inListOrder,
  isShown,
  neighbour,
  nextUnanswered,
  shownBoxes,
} from "../boxes/filters.js";
import { useAsShown, useBoxes } from "../boxes/store.js";
import { isFar, spokenText } from "../boxes/wording.js";
import { get } from "../core/api.js";
import { useActions, useLoaded, useTopBar, useValue } from "../core/hooks.js";
import { html, useEffect, useMemo, useRef, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { Toggle } from "../core/keymap.js";
import { countOf } from "../core/numbers.js";
import { Failure } from "../core/parts.js";
import { linkTo } from "../core/router.js";
import { useMedia } from "../stage/media.js";
import { LookBar, StageView, createLookActions } from "../stage/view.js";
import { AnswerBar } from "./answer_bar.js";
import { BoxList } from "./boxlist.js";
import { Inspector, NOT_PAINTED, forgetTyped, typedComment } from "./inspector.js";

/** @import { Answer, Decision } from "../boxes/box.js" */
/** @import { Actions } from "../core/app.js" */
/** @import { Query, Route } from "../core/router.js" */
/** @import { Frame, Media, MediaCache } from "../stage/media.js" */
/** @import { Stage } from "../stage/stage.js" */
/** @import { ReviewApp as App } from "./answers.js" */

/** @param {{app: App, route: Route}} props */
export function FrameView({ app, route }) {
  const id = Number(route.params.id);
  const media = useMedia(app.boxes);
  const loaded = useLoaded((signal) => media.frame(id, signal), [id]);
  const frame = loaded.value?.id === id ? loaded.value : null;
  if (loaded.state === "error" && !frame) {
    return html`<${NoFrame} app=${app} error=${loaded.error} onRetry=${loaded.reload} />`;
  }
  if (!frame) return html`<${Skeleton} app=${app} last=${loaded.value} />`;
  return html`<${FrameReview} key=${frame.id} app=${app} frame=${frame} media=${media} query=${route.query} />`;
}

/** @param {{app: App, error: Error, onRetry: () => void}} props */
function NoFrame({ app, error, onRetry }) {
  useTopBar(app, { title: "" });
  return html`<main id="main" class="page" tabindex="-1"><${Failure} error=${error} onRetry=${onRetry} /></main>`;
}

/** @param {{app: App, frame: Frame, media: MediaCache, query: Query}} props */
function FrameReview({ app, frame, media, query }) {
  useTopBar(app, {
    title: `${frame.key} · ${frame.dataset}`,
    dataset: frame.dataset,
    crumbs: [
      { text: "Datasets", href: linkTo("datasets") },
      { text: frame.dataset, href: linkTo("frames", { dataset: frame.dataset }, { ...query, box: "" }) },
      { text: frame.key },
    ],
    tools: useMemo(() => html`<${FrameSteps} frame=${frame} query=${query} />`, [frame, query]),
  });
  const stage = useRef(/** @type {Stage | null} */ (null));
  const comment = useRef(/** @type {HTMLTextAreaElement | null} */ (null));
  const [tab, setTab] = useState("box");
  const { panels } = useValue(app.prefs);
  const ids = useMemo(
    () => inListOrder(app.boxes.all(frame.boxIds), query.by).map(({ box_id }) => box_id),
    [app, frame, query.by],
  );
  const actions = useMemo(() => {
    const openComment = () => {
      // At once, or the next keys would still be shortcuts. Again only if the panel was hidden:
      // a focus that comes late would take the keys of somebody who has finished typing.
      comment.current?.focus();
      const isReached = document.activeElement === comment.current;
      setTab("box");
      if (!isReached) setTimeout(() => comment.current?.focus());
    };
    return createFrameActions(app, frame, ids, { stage: () => stage.current, openComment });
  }, [app, frame, ids]);
  useActions(app, actions.byName);
  useEffect(() => {
    if (frame.next_id !== null) media.fetchAhead(frame.next_id);
  }, [media, frame]);
  // The address may ask for the first, last or next unanswered box: select it, and put its id into the address.
  useEffect(() => {
    if (query.box && !Number(query.box)) actions.select(actions.resolve(query.box));
  }, [actions]);
  useFollowing(app, frame, query);

  const current = useBoxes(app.boxes, ids);
  const boxes = useAsShown(app, current);
  const { waiting } = useValue(app.sender.state);
  const filters = filtersOf(query);
  const shown = useMemo(
    () => boxes.filter((_, i) => isShown(/** @type {Decision} */ (current[i]), query)),
    [boxes, ...Object.values(filters), Object.keys(filters).join()],
  );
  const selected = boxes.find(({ box_id }) => box_id === Number(query.box)) ?? null;

  return html`<main id="main" class="review" tabindex="-1" data-tab=${tab} data-panels=${panels ? undefined : "off"}>
    <h1 class="sr-only">${frame.key}</h1>
    <div class="review__tabs segments segments--wide" role="group" aria-label="Panel">
      <button class="segments__item" aria-pressed=${tab === "box"} onClick=${() => setTab("box")}>Selected box</button>
      <button class="segments__item" aria-pressed=${tab === "list"}
        onClick=${() => setTab("list")}>Boxes <span class="num">${shown.length}</span></button>
    </div>
    <${BoxList} boxes=${boxes} shown=${shown} selected=${selected} query=${query} waiting=${waiting}
      onSelect=${actions.select} onQuery=${(/** @type {Query} */ next) =>
        app.router.replace(linkTo("frame", { id: frame.id }, next))} />
    <div class="review__stage">
      <${FrameStage} app=${app} frame=${frame} media=${media.of(frame.id)} shown=${shown} selected=${selected}
        onSelect=${actions.select} stageRef=${stage} />
      <${FrameLook} app=${app} frame=${frame} actions=${actions.byName} />
      <${AnswerBar} app=${app} box=${selected} isWaiting=${selected !== null && waiting.has(selected.box_id)}
        actions=${actions.byName} />
    </div>
    <${Inspector} app=${app} frame=${frame} box=${selected} boxes=${boxes} actions=${actions} commentRef=${comment}
      isWaiting=${selected !== null && waiting.has(selected.box_id)} />
  </main>`;
}

/**
 * @param {{app: App, frame: Frame, media: Media, shown: readonly Decision[], selected:
 *   Decision | null, onSelect: (boxId: number | null) => void, stageRef: {current: Stage |
 *   null}}} props `shown`: the boxes that the filters leave; the selected one is drawn even if it is not among them
 */
function FrameStage({ app, frame, media, shown, selected, onSelect, stageRef }) {
  const { crop } = useValue(app.prefs);
  const boxes = useMemo(
    () => (selected && !shown.includes(selected) ? [...shown, selected] : shown),
    [shown, selected],
  );
  const words = `${countOf(shown.length, "box", "boxes")} shown${selected ? `; selected: ${spokenText(selected)}` : ""}`;
  return html`<${StageView} app=${app} frame=${frame} media=${media} boxes=${boxes} selected=${selected} isCrop=${crop}
    label=${`Frame ${frame.key}: ${words}`} onSelect=${onSelect}
    onCrop=${(/** @type {boolean} */ isOnBox) => app.prefs.change({ crop: isOnBox })} stageRef=${stageRef} />`;
}

/** @param {{app: App, frame: Frame, actions: Actions}} props */
function FrameLook({ app, frame, actions }) {
  const { mask, opacity, lit, edges, blind, crop, far } = useValue(app.prefs);
  const boxes = app.boxes.all(frame.boxIds);
  const hasEdges = boxes.some((box) => box.edges?.length);
  /** @param {{currentTarget: HTMLInputElement}} event */
  const setOpacity = ({ currentTarget }) => app.prefs.change({ opacity: Number(currentTarget.value), mask: true });
  return html`<${LookBar} app=${app} actions=${actions} isCrop=${crop} hasZoomText=${true}>
    ${
      frame.has_segmentation &&
      html`<${Toggle} app=${app} action="mask" icon="layers" isOn=${mask} run=${actions.mask} />
      <input class="slider" type="range" min="0.1" max="1" step="0.05" value=${opacity}
        aria-label="Segmentation opacity" onInput=${setOpacity} />
      <${Toggle} app=${app} action="lit" icon="light" isOn=${lit} run=${actions.lit} />`
    }
    ${hasEdges && html`<${Toggle} app=${app} action="edges" icon="cube" isOn=${edges} run=${actions.edges} />`}
    ${
      boxes.some(isFar) &&
      html`<span
        class="bar__wide"><${Toggle} app=${app} action="far" icon="far" isOn=${far} run=${actions.far} /></span>`
    }
    <${Toggle} app=${app} action="blind" icon="blind" isOn=${blind} run=${actions.blind} />
    <span class="bar__rule" aria-hidden="true"></span>
  <//>`;
}

const FOLLOW_MS = 500;

/**
 * If the address says `follow`, the newest frame of the dataset is shown as soon as it is there.
 * @param {App} app @param {Frame} frame @param {Query} query
 */
function useFollowing(app, frame, query) {
  const isOn = Boolean(query.follow);
  useEffect(() => {
    if (!isOn) return undefined;
    const stopped = new AbortController();
    const path = { dataset: frame.dataset };
    const { signal } = stopped;
    const look = async () => {
      const { items } = await get("/api/v1/datasets/{dataset}/frames", {
        path,
        query: { sort: "-id", limit: 1 },
        signal,
      });
      const id = items[0]?.id ?? frame.id;
      const { query: now } = app.router.route.get();
      if (id !== frame.id && now.follow) app.router.replace(linkTo("frame", { id }, { ...now, box: "" }));
    };
    const timer = setInterval(() => look().catch(() => {}), FOLLOW_MS); // the next look may find the server again
    return () => {
      clearInterval(timer);
      stopped.abort();
    };
  }, [app, frame, isOn]);
}

/** @param {{app: App, last: Frame | null}} props */
function Skeleton({ app, last }) {
  useTopBar(app, { title: "", dataset: last?.dataset });
  return html`<main id="main" class="review" tabindex="-1" aria-busy="true">
    <aside
      class="panel panel--list">${Array.from({ length: 8 }, () => html`<div class="skeleton skeleton--row" />`)}</aside>
    <div class="review__stage"><div class="stage shimmer" /></div>
    <aside class="panel panel--inspector"><div class="skeleton" /><div class="skeleton skeleton--short" />
      <div class="skeleton skeleton--tall" /></aside>
    <p class="sr-only" role="status">Loading the frame</p>
  </main>`;
}

/**
 * @param {App} app @param {Frame} frame @param {readonly number[]} ids  of its boxes, in the order of the list
 * @param {{stage: () => Stage | null, openComment: () => void}} page
 */
export function createFrameActions(app, frame, ids, page) {
  const query = () => app.router.route.get().query;
  const selectedId = () => Number(query().box) || null;
  const boxes = () => app.boxes.all(ids);
  const known = new Set(ids);
  const selected = () => (known.has(selectedId() ?? 0) ? (app.boxes.get(selectedId() ?? 0) ?? null) : null);

  /** @param {number | null} boxId */
  function select(boxId) {
    const box = boxId === null || !known.has(boxId) ? undefined : app.boxes.get(boxId);
    app.router.replace(linkTo("frame", { id: frame.id }, { ...query(), box: box ? String(boxId) : "" }));
    app.announcement.set(box ? spokenText(asShown(box, app.prefs.get().blind)) : "");
  }

  /** @param {Answer} verdict @param {string} [comment] @returns {boolean} false: it was not given */
  function answer(verdict, comment) {
    const box = selected();
    if (!box) {
      app.toasts.show("Select a box first.");
      return false;
    }
    const lookedMs = page.stage()?.lookedMs(box.box_id) ?? null;
    if (verdict !== "unsure" && comment === undefined && lookedMs === null) {
      app.toasts.show(NOT_PAINTED);
      return false;
    }
    const words = comment ?? typedComment(box.box_id) ?? box.review?.comment ?? "";
    if (box.review?.verdict === verdict && (box.review.comment ?? "") === words) return true;
    if (!app.answer(box.box_id, verdict, words, lookedMs)) return false;
    forgetTyped(box.box_id);
    app.announcement.set(`${box.class} ${box.id}: ${verdict}`);
    return true;
  }

  /** @param {number | null} id @param {string} box  which one there: first, last, unanswered */
  function goToFrame(id, box) {
    if (id === null) return app.toasts.show("There are no more frames.");
    app.router.go(linkTo("frame", { id }, { ...query(), box }));
  }

  /** @param {1 | -1} step */
  function step(step) {
    const box = neighbour(boxes(), query(), selectedId(), step);
    if (box) select(box.box_id);
    else goToFrame(step > 0 ? frame.next_id : frame.previous_id, step > 0 ? "first" : "last");
  }

  function undo() {
    app.undo((box) => {
      if (known.has(box.box_id)) select(box.box_id);
      else app.router.go(linkTo("frame", { id: box.frame_id }, { box: String(box.box_id) }));
    });
  }

  /** Crop stays on from box to box, and from frame to frame, until it is switched off. */
  function crop() {
    const isCrop = app.prefs.get().crop;
    const hasMoved = page.stage()?.mode() === "free";
    if (isCrop && hasMoved && selected()?.xyxy) page.stage()?.recrop();
    else app.prefs.change({ crop: !isCrop });
  }

  function fit() {
    app.prefs.change({ crop: false });
    page.stage()?.fit();
  }

  return {
    select,
    saveComment: answer,

    /**
     * The id of the box that the address asks for by a word (first, last, unanswered).
     * @param {string} which @returns {number | null}
     */
    resolve(which) {
      const shown = shownBoxes(boxes(), query());
      if (which === "first") return shown[0]?.box_id ?? null;
      if (which === "last") return shown.at(-1)?.box_id ?? null;
      return (shown.find(isUnanswered) ?? shown[0])?.box_id ?? null;
    },

    /** By the names of the keymap. */
    byName: {
      keep: () => void answer("keep"),
      reject: () => void answer("reject"),
      unsure: () => void answer("unsure"),
      undo,
      comment: () => (selected() ? page.openComment() : app.toasts.show("Select a box first.")),
      next: () => step(1),
      previous: () => step(-1),
      nextUnanswered() {
        const box = nextUnanswered(boxes(), query(), selectedId());
        if (box) select(box.box_id);
        else goToFrame(frame.next_id, "unanswered");
      },
      nextFrame: () => goToFrame(frame.next_id, ""),
      previousFrame: () => goToFrame(frame.previous_id, ""),
      grid: () => app.router.go(linkTo("grid", { dataset: frame.dataset }, { ...query(), box: "" })),
      ...createLookActions(app, page.stage),
      blind: () => app.prefs.change({ blind: !app.prefs.get().blind }),
      cycleVerdict: () => cycleVerdict(app),
      crop,
      fit,
      escape: () => select(null),
    },
  };
}

/** @typedef {ReturnType<typeof createFrameActions>} FrameActions */

/** @param {{frame: Frame, query: Query}} props */
function FrameSteps({ frame, query }) {
  return html`<div class="framesteps" role="group" aria-label="Frames">
    ${
      query.follow &&
      html`<a class="button button--small"
        href=${linkTo("frame", { id: frame.id }, { ...query, follow: "" })}>Following the newest: stop</a>`
    }
    ${
      frame.has_image &&
      html`<a class="button button--quiet button--icon" href=${linkTo("compare", { id: frame.id })}
        aria-label="Before and after" title="Before and after the filter"><${Icon} name="halves" /></a>`
    }
    <${Step} id=${frame.previous_id} query=${query} icon="left" text="Previous frame" />
    <${Step} id=${frame.next_id} query=${query} icon="right" text="Next frame" />
  </div>`;
}

/** @param {{id: number | null, query: Query, icon: string, text: string}} props */
function Step({ id, query, icon, text }) {
  if (id === null)
    return html`<span class="button button--quiet button--icon is-disabled"
      aria-hidden="true"><${Icon} name=${icon} /></span>`;
  return html`<a class="button button--quiet button--icon" href=${linkTo("frame", { id }, { ...query, box: "" })}
    aria-label=${text} title=${text}><${Icon} name=${icon} /></a>`;
}
