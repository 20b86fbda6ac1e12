// @ts-check
// One frame: the image is the hero; list on its left, the selected box on its right.

import { html, useEffect, useMemo, useRef, useState } from "../html.js";
import { filtersOf, isShown } from "../boxfilter.js";
import { createFrameActions } from "../frame_actions.js";
import { withAnswer } from "../reviews.js";
import { linkTo } from "../router.js";
import { REMOTE } from "../store.js";
import { BoxList } from "./boxlist.js";
import { useActions, useBoxes, useLoaded, useSeen, useTitle, useValue } from "./hooks.js";
import { Inspector } from "./inspector.js";
import { FrameSteps } from "./framesteps.js";
import { Failure } from "./parts.js";
import { StageView } from "./stage_view.js";
import { AnswerBar, LookBar } from "./toolbar.js";
import { TopBar } from "./topbar.js";

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../types.js").Decision} Decision */
/** @typedef {import("../types.js").Frame} Frame */

/** @param {{app: App, route: import("../router.js").Route}} props */
export function FrameView({ app, route }) {
  const id = Number(route.params.id);
  const loaded = useLoaded(app, (signal) => app.frames.load(id, signal), [id]);
  const frame = loaded.value?.id === id ? loaded.value : null;
  if (loaded.state === "error" && !frame) {
    return html`<${TopBar} app=${app} crumbs=${[{ text: "Datasets", href: linkTo("datasets") }]} />
      <main id="main" class="page" tabindex="-1"><${Failure} error=${loaded.error} onRetry=${loaded.reload} /></main>`;
  }
  if (!frame) return html`<${Skeleton} app=${app} last=${loaded.value} />`;
  return html`<${FrameReview} key=${frame.id} app=${app} frame=${frame} query=${route.query} />`;
}

/** @param {{app: App, frame: Frame, query: import("../router.js").Query}} props */
function FrameReview({ app, frame, query }) {
  useTitle(`${frame.key} · ${frame.dataset}`);
  const stage = useRef(/** @type {import("../stage/stage.js").Stage | null} */ (null));
  const comment = useRef(/** @type {HTMLTextAreaElement | null} */ (null));
  const [tab, setTab] = useState("box");
  const { store } = useMemo(() => openWithWaiting(app, frame), [app, frame]);
  const actions = useMemo(() => {
    const openComment = () => {
      // At once, or the next keys would still be shortcuts. Again only if the panel was hidden:
      // a focus that comes late would take the keys of somebody who has finished typing.
      comment.current?.focus();
      const isReached = document.activeElement === comment.current;
      setTab("box");
      if (!isReached) setTimeout(() => comment.current?.focus());
    };
    return createFrameActions(app, frame, store, { stage: () => stage.current, openComment });
  }, [app, frame, store]);
  useActions(app, actions.byName);
  useEffect(() => store.observe((change) => (app.undo.notice(change), app.saver.notice(change))), [app, store]);
  useEffect(() => app.frames.fetchAhead(frame.next_id), [app, frame]);
  useArrival(app, actions, query);

  const answered = useBoxes(store);
  const boxes = useSeen(app, answered);
  const { waiting } = useValue(app.saver.state);
  const shown = useMemo(() => boxes.filter((_, i) => isShown(/** @type {Decision} */ (answered[i]), query)), [boxes, ...Object.values(filtersOf(query)), Object.keys(filtersOf(query)).join()]);
  const selected = boxes.find(({ box_id }) => box_id === Number(query.box)) ?? null;

  const crumbs = [
    { text: "Datasets", href: linkTo("datasets") },
    { text: frame.dataset, href: linkTo("frames", { dataset: frame.dataset }, { ...query, box: "" }) },
    { text: frame.key },
  ];
  return html`<${TopBar} app=${app} crumbs=${crumbs}><${FrameSteps} frame=${frame} query=${query} /><//>
    <main id="main" class="review" tabindex="-1" data-tab=${tab}>
      <h1 class="sr-only">${frame.key}</h1>
      <${Tabs} tab=${tab} count=${shown.length} onChange=${setTab} />
      <${BoxList} app=${app} boxes=${boxes} shown=${shown} selected=${selected} query=${query} waiting=${waiting}
        onSelect=${actions.select} onQuery=${(/** @type {import("../router.js").Query} */ next) => app.router.replace(linkTo("frame", { id: frame.id }, next))} />
      <div class="review__stage">
        <${StageView} app=${app} frame=${frame} shown=${shown} selected=${selected} onSelect=${actions.select} stageRef=${stage} />
        <${LookBar} app=${app} frame=${frame} actions=${actions.byName} />
        <${AnswerBar} app=${app} box=${selected} isWaiting=${selected !== null && waiting.has(selected.box_id)} actions=${actions.byName} />
      </div>
      <${Inspector} app=${app} frame=${frame} box=${selected} boxes=${boxes} actions=${actions} commentRef=${comment}
        isWaiting=${selected !== null && waiting.has(selected.box_id)} />
    </main>`;
}

/** Open the frame with what this browser has answered and the server does not know yet. @param {App} app @param {Frame} frame */
function openWithWaiting(app, frame) {
  const open = app.frames.open(frame);
  for (const item of app.saver.waitingFor(frame.id)) {
    const box = open.store.get(item.boxId);
    if (box) open.store.apply(withAnswer(box, item.verdict, item.comment), REMOTE);
  }
  return open;
}

/** The address may ask for "the first box" or for an undo here: do it once and write the result. @param {App} app @param {import("../frame_actions.js").FrameActions} actions @param {import("../router.js").Query} query */
function useArrival(app, actions, query) {
  useEffect(() => {
    if (query.undo) {
      const { undo, ...rest } = query;
      app.router.replace(linkTo("frame", app.router.route.get().params, rest));
      actions.byName.undo();
    } else if (query.box && !Number(query.box)) actions.select(actions.resolve(query.box));
  }, [actions]);
}

/** On a narrow screen, list and box take turns. @param {{tab: string, count: number, onChange: (tab: string) => void}} props */
function Tabs({ tab, count, onChange }) {
  return html`<div class="review__tabs segments segments--wide" role="group" aria-label="Panel">
    <button class="segments__item" aria-pressed=${tab === "box"} onClick=${() => onChange("box")}>Selected box</button>
    <button class="segments__item" aria-pressed=${tab === "list"} onClick=${() => onChange("list")}>Boxes <span class="num">${count}</span></button>
  </div>`;
}

/** @param {{app: App, last: Frame | null}} props */
function Skeleton({ app, last }) {
  const crumbs = [{ text: "Datasets", href: linkTo("datasets") }, ...(last ? [{ text: last.dataset }] : [])];
  return html`<${TopBar} app=${app} crumbs=${crumbs} />
    <main id="main" class="review" tabindex="-1" aria-busy="true">
      <aside class="panel panel--list">${Array.from({ length: 8 }, () => html`<div class="bone bone--row" />`)}</aside>
      <div class="review__stage"><div class="stage shimmer" /></div>
      <aside class="panel panel--inspector"><div class="bone" /><div class="bone bone--short" /><div class="bone bone--tall" /></aside>
      <p class="sr-only" role="status">Loading the frame</p>
    </main>`;
}
