// @ts-check
// One box at a time: the box with what is around it, and the next one after each answer.

import { html, useEffect, useMemo, useRef, useState } from "../html.js";
import { veiled } from "../blind.js";
import { withoutFilters } from "../grid/filters.js";
import { createQueueActions } from "../queue/actions.js";
import { isBlind } from "../queue/blind.js";
import { ahead, currentOf } from "../queue/line.js";
import { withoutList } from "../queue/listed.js";
import { createMedia } from "../queue/media.js";
import { sittingOf, touch } from "../queue/sitting.js";
import { linkTo } from "../router.js";
import { createValue } from "../store.js";
import { useActions, useBoxes, useLoaded, useTitle, useValue } from "./hooks.js";
import { Inspector } from "./inspector.js";
import { Failure } from "./parts.js";
import { BlindPanel } from "./queue_blind.js";
import { AllDone, Conflicts, Fetching, NoBoxesYet } from "./queue_states.js";
import { QueueHead } from "./queue_head.js";
import { QueueStage } from "./queue_stage.js";
import { QueueStrip } from "./queue_strip.js";
import { AnswerBar } from "./toolbar.js";
import { TopBar } from "./topbar.js";

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../router.js").Query} Query */
/** @typedef {import("../queue/sitting.js").Sitting} Sitting */

const AHEAD = 3;
const RENEW_MS = 4 * 60_000;

/** @param {{app: App, route: import("../router.js").Route}} props */
export function QueueView({ app, route }) {
  const name = route.params.dataset ?? "";
  useTitle(`Queue · ${name}`);
  const dataset = useLoaded(app, (signal) => app.api.dataset(name, signal), [name]);
  const sitting = sittingOf(app, name, route.query);
  /** @param {Query} query */
  const setQuery = (query) => app.router.replace(linkTo("queue", { dataset: name }, query));
  const crumbs = [{ text: "Datasets", href: linkTo("datasets") }, { text: name }];
  const failed = dataset.state === "error" && !dataset.value;
  return html`<${TopBar} app=${app} crumbs=${crumbs} />
    <main id="main" class="queue" tabindex="-1">
      <h1 class="sr-only">Queue of ${name}</h1>
      ${failed
        ? html`<${Failure} error=${dataset.error} onRetry=${dataset.reload} />`
        : html`<${QueueHead} app=${app} sitting=${sitting} classes=${dataset.value?.classes ?? []} query=${route.query} onChange=${setQuery} />
            <${Sitter} key=${sitting} app=${app} sitting=${sitting} query=${route.query} isEmpty=${dataset.value?.counts.boxes === 0} onQuery=${setQuery} />`}
    </main>`;
}

/** @param {{app: App, sitting: Sitting, query: Query, isEmpty: boolean, onQuery: (query: Query) => void}} props */
function Sitter({ app, sitting, query, isEmpty, onQuery }) {
  const media = useMemo(() => createMedia(app), [app]);
  const stage = useRef(/** @type {import("../stage/stage.js").Stage | null} */ (null));
  const comment = useRef(/** @type {HTMLTextAreaElement | null} */ (null));
  const [view] = useState(() => createValue(/** @type {"crop" | "frame"} */ ("crop")));
  const now = useRef(query);
  now.current = query;
  const actions = useMemo(
    () =>
      createQueueActions(app, sitting, {
        stage: () => stage.current,
        openComment: () => comment.current?.focus(),
        isBlind: () => isBlind(now.current, app.prefs.get()),
        view,
      }),
    [app, sitting],
  );
  useActions(app, actions.byName);
  useSupply(app, sitting, media);

  useBoxes(sitting.store);
  const line = useValue(sitting.line);
  const { waiting } = useValue(app.saver.state);
  const prefs = useValue(app.prefs);
  const verdicts = useValue(sitting.tally).verdicts;
  const box = sitting.store.get(currentOf(line) ?? 0) ?? null;
  const isHidden = box !== null && isBlind(query, prefs) && !verdicts.has(box.box_id);
  const shown = isHidden && box ? veiled(box) : box;
  const isWaiting = box !== null && waiting.has(box.box_id);

  return html`<div class="queue__body ${box ? "" : "is-empty"}">
    <${QueueStrip} app=${app} sitting=${sitting} line=${line} isHidden=${isHidden} onShow=${actions.show} />
    ${box && shown
      ? html`<div class="review__stage queue__stage">
            <${QueueStage} app=${app} box=${shown} media=${media} view=${view} isBlind=${isHidden} actions=${actions.byName} stageRef=${stage} />
            <${Conflicts} app=${app} sitting=${sitting} onShow=${actions.show} />
            <${AnswerBar} app=${app} box=${shown} isWaiting=${isWaiting} actions=${actions.byName} />
          </div>
          ${isHidden
            ? html`<${BlindPanel} key=${box.box_id} box=${shown} sitting=${sitting} onSee=${() => onQuery({ ...query, blind: "off" })} />`
            : html`<${Inspector} app=${app} frame=${media.ready(box.frame_id)?.frame ?? null} box=${box} boxes=${[]} actions=${actions} commentRef=${comment} isWaiting=${isWaiting} />`}`
      : html`<${NoBox} app=${app} sitting=${sitting} query=${query} actions=${actions} isEmpty=${isEmpty} onQuery=${onQuery} />`}
  </div>`;
}

/** @param {{app: App, sitting: Sitting, query: Query, actions: import("../queue/actions.js").QueueActions, isEmpty: boolean, onQuery: (query: Query) => void}} props */
function NoBox({ app, sitting, query, actions, isEmpty, onQuery }) {
  const { state, error, isEnd } = useValue(sitting.supply);
  if (state === "error" && error) return html`<div class="queue__message"><${Failure} error=${error} onRetry=${() => void sitting.refill()} /></div>`;
  if (!isEnd) return html`<${Fetching} />`;
  if (isEmpty) return html`<${NoBoxesYet} />`;
  return html`<${AllDone} app=${app} sitting=${sitting} query=${query} actions=${actions} onAll=${() => onQuery(withoutList(withoutFilters(query)))} />`;
}

/** Boxes, frames and pictures are here before they are looked at. @param {App} app @param {Sitting} sitting @param {import("../queue/media.js").MediaCache} media */
function useSupply(app, sitting, media) {
  const line = useValue(sitting.line);
  const { lit, mask } = useValue(app.prefs);
  useEffect(() => {
    void sitting.refill();
    sitting.showWaiting();
    const giveBack = app.stores.lend(sitting.store, { takesAnswers: true });
    const renewing = setInterval(() => document.visibilityState === "visible" && void sitting.renew(), RENEW_MS);
    return () => {
      giveBack();
      clearInterval(renewing);
      touch(app);
    };
  }, [sitting]);
  useEffect(() => {
    const frames = new Set(ahead(line, AHEAD).flatMap((id) => sitting.store.get(id)?.frame_id ?? []));
    for (const frame of frames) (lit || mask ? media.wantAll(frame) : media.want(frame)).catch(() => {});
  }, [line, lit, mask]);
}
