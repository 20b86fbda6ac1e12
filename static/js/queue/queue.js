// @ts-check
// The queue view: stage, panel, and what is shown when there is no box.

import { answerOf, asShown, isWithheld } from "../boxes/box.js";
import { BINS, cycleVerdict, isFiltered, withoutFilters, withoutList } from "../boxes/filters.js";
import { useBoxes } from "../boxes/store.js";
import { distanceText, spokenText } from "../boxes/wording.js";
import { get } from "../core/api.js";
import { useActions, useDataset, useGrowth, useLoaded, useTopBar, useValue } from "../core/hooks.js";
import { html, useCallback, useEffect, useLayoutEffect, useMemo, useRef, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf, countText } from "../core/numbers.js";
import { createValue } from "../core/observable.js";
import { Failure, Notice } from "../core/parts.js";
import { linkTo } from "../core/router.js";
import { AnswerBar, OvertakenNotice } from "../review/answer_bar.js";
import { Inspector, NOT_PAINTED, forgetTyped, typedComment } from "../review/inspector.js";
import { useMedia } from "../stage/media.js";
import { createLookActions } from "../stage/view.js";
import { AlikeDialog } from "./alike.js";
import { QueueHead, QueueStrip } from "./head.js";
import { backToSkipped, currentOf, isBlind, movedTo, nextOpen, skippedBoxes, stepped, upcoming } from "./line.js";
import { keepSession, sessionOf } from "./session.js";
import { QueueStage } from "./stage.js";
import { TrackStrip, useTrack } from "./track.js";

/** @import { Answer, Decision } from "../boxes/box.js" */
/** @import { Value } from "../core/observable.js" */
/** @import { Query, Route } from "../core/router.js" */
/** @import { ReviewApp as App } from "../review/answers.js" */
/** @import { MediaCache } from "../stage/media.js" */
/** @import { Stage } from "../stage/stage.js" */
/** @import { Line } from "./line.js" */
/** @import { Session } from "./session.js" */

const AHEAD = 3;
const RENEW_MS = 4 * 60_000;

/** @param {{app: App, route: Route}} props */
export function QueueView({ app, route }) {
  const name = route.params.dataset ?? "";
  useTopBar(app, { title: `Queue · ${name}`, dataset: name });
  const dataset = useDataset(name);
  const { session, isChecked } = sessionOf(app, name, route.query, dataset.value?.active_run);
  const frames = dataset.value?.counts.frames ?? 0;
  useGrowth(dataset, frames, dataset.value?.created_at);
  // Who was faster than the frames come in gets the boxes that have come since.
  useEffect(() => {
    if (session.supply.get().isEnd && session.listed.length === 0) session.lookAgain();
  }, [session, frames]);
  /** @param {Query} query */
  const setQuery = ({ box: _, ...query }) => app.router.replace(linkTo("queue", { dataset: name }, query));
  const failed = dataset.state === "error" && !dataset.value;
  return html`<main id="main" class="queue" tabindex="-1">
    <h1 class="sr-only">Queue of ${name}</h1>
    ${
      failed
        ? html`<${Failure} error=${dataset.error} onRetry=${dataset.reload} />`
        : html`<${QueueHead} app=${app} session=${session} classes=${dataset.value?.classes ?? []}
          query=${route.query} onChange=${setQuery} />
        ${
          isChecked
            ? html`<${SessionView} key=${session} app=${app} session=${session} query=${route.query}
              rule=${dataset.value?.rule ?? ""} isEmpty=${dataset.value?.counts.boxes === 0} onQuery=${setQuery} />`
            : html`<div class="queue__body is-empty"><${Fetching} /></div>`
        }`
    }
  </main>`;
}

/**
 * @param {{app: App, session: Session, query: Query, rule: string, isEmpty: boolean, onQuery: (query: Query) => void}}
 *   props
 */
function SessionView({ app, session, query, rule, isEmpty, onQuery }) {
  const media = useMedia(app.boxes);
  const stage = useRef(/** @type {Stage | null} */ (null));
  const comment = useRef(/** @type {HTMLTextAreaElement | null} */ (null));
  /** The box of the same object in another frame, while one looks at it; 0: the asked one is on the stage. */
  const [peek] = useState(() => createValue(0));
  const track = useRef(/** @type {readonly import("./track.js").Place[]} */ ([]));
  const [alike, setAlike] = useState(/** @type {ReturnType<Session["lastAnswer"]>} */ (null));
  const [view] = useState(() => createValue(/** @type {"crop" | "frame"} */ ("crop")));
  const now = useRef(query);
  now.current = query;
  const actions = useMemo(
    () =>
      createQueueActions(app, session, {
        stage: () => stage.current,
        openComment: () => comment.current?.focus(),
        isBlind: () => isBlind(now.current, app.prefs.get()),
        openAlike: setAlike,
        view,
        peek,
        track: () => track.current,
      }),
    [app, session],
  );
  useActions(app, actions.byName);
  useSupply(app, session, media);

  const line = useValue(session.line);
  useBoxes(app.boxes, line.ids);
  useBoxInAddress(app, session, currentOf(line));
  const { waiting } = useValue(app.sender.state);
  const prefs = useValue(app.prefs);
  const verdicts = useValue(session.tally).verdicts;
  const box = app.boxes.get(currentOf(line) ?? 0) ?? null;
  const isBlindNow = isBlind(query, prefs);
  const lesson = useValue(session.lesson);
  // In a lesson, the filter tells nothing before the answer.
  const isAsked = box !== null && lesson.includes(box.box_id) && !session.isTold(box);
  /** What this session may show of a box. */
  const see = useCallback(
    (/** @type {Decision} */ one) => asShown(one, isBlindNow || isAsked, ({ box_id }) => verdicts.has(box_id)),
    [isBlindNow, isAsked, verdicts],
  );
  const shown = box && see(box);
  const isHidden = shown !== null && isWithheld(shown);
  const taught = box &&
    lesson.includes(box.box_id) && {
      at: lesson.indexOf(box.box_id) + 1,
      count: lesson.length,
      onNext: () => actions.show(nextOpen(session.line.get())),
      onSkip: () => session.skipLesson(),
    };
  track.current = useTrack(app.boxes, box?.box_id ?? 0);
  const peeked = app.boxes.get(useValue(peek));
  const staged = peeked && track.current.some(({ boxId }) => boxId === peeked.box_id) ? see(peeked) : shown;
  const offset = track.current.find(({ boxId }) => boxId === staged?.box_id)?.offset ?? 0;
  const isWaiting = box !== null && waiting.has(box.box_id);

  return html`<div class="queue__body ${box ? "" : "is-empty"}" data-panels=${prefs.panels ? undefined : "off"}>
    <${QueueStrip} app=${app} session=${session} media=${media} line=${line} isHidden=${isHidden}
      onShow=${actions.show} />
    ${
      box && shown && staged
        ? html`<div class="review__stage queue__stage">
          <${QueueStage} app=${app} box=${staged} see=${see} media=${media.of(staged.frame_id)} view=${view}
            actions=${actions.byName} stageRef=${stage} rule=${rule} offset=${offset} lesson=${taught}
            strip=${html`<${TrackStrip} app=${app} places=${track.current} shownId=${staged.box_id} see=${see}
              isBlind=${isHidden} onShow=${actions.peek} actions=${actions.byName} />`} />
          <${OvertakenNotices} app=${app} session=${session} onShow=${actions.show} />
          <${AnswerBar} app=${app} box=${shown} isWaiting=${isWaiting} actions=${actions.byName} />
        </div>
        ${
          isHidden
            ? html`<${BlindPanel} key=${box.box_id} box=${shown} session=${session}
              onSee=${isAsked ? null : () => onQuery({ ...query, blind: "off" })} />`
            : html`<${Inspector} app=${app} frame=${null} box=${box} boxes=${[]} actions=${actions}
              commentRef=${comment} isWaiting=${isWaiting} />`
        }`
        : html`<${NoBox} app=${app} session=${session} query=${query} actions=${actions} isEmpty=${isEmpty}
          onQuery=${onQuery} />`
    }
    ${alike && html`<${AlikeDialog} app=${app} session=${session} answered=${alike} onClose=${() => setAlike(null)} />`}
  </div>`;
}

/**
 * @param {{app: App, session: Session, query: Query, actions: QueueActions, isEmpty: boolean, onQuery: (query: Query)
 *   => void}} props
 */
function NoBox({ app, session, query, actions, isEmpty, onQuery }) {
  const { state, error, isEnd } = useValue(session.supply);
  if (state === "error" && error)
    return html`<div class="queue__message"><${Failure} error=${error} onRetry=${() => void session.refill()} /></div>`;
  if (!isEnd) return html`<${Fetching} />`;
  if (isEmpty)
    return html`<div class="queue__message">
    <${Notice} icon="grid" title="No boxes yet"><p>No frames have been uploaded to this dataset.</p><//></div>`;
  return html`<${AllDone} app=${app} session=${session} query=${query} actions=${actions}
    onAll=${() => onQuery(withoutList(withoutFilters(query)))} />`;
}

/**
 * The address names the box on show; one that names another box when the view opens shows that one.
 * @param {App} app @param {Session} session @param {number | null} here
 */
function useBoxInAddress(app, session, here) {
  const [asked, setAsked] = useState(() => Number(app.router.route.get().query.box) || 0);
  useEffect(() => {
    if (!asked) return;
    session
      .showBox(asked)
      .catch(app.toasts.fail)
      .finally(() => setAsked(0));
  }, [session]);
  useEffect(() => {
    const { name, params, query } = app.router.route.get();
    if (!asked && here !== null && name === "queue")
      app.router.replace(linkTo(name, params, { ...query, box: String(here) }));
  }, [asked, here]);
}

/**
 * Load boxes, frames and pictures before they are shown.
 * @param {App} app @param {Session} session @param {MediaCache} media
 */
function useSupply(app, session, media) {
  const line = useValue(session.line);
  const { lit, mask } = useValue(app.prefs);
  useEffect(() => {
    keepSession(app, "shown");
    void session.refill();
    const renewing = setInterval(() => document.visibilityState === "visible" && void session.renew(), RENEW_MS);
    return () => {
      clearInterval(renewing);
      keepSession(app, "left");
    };
  }, [session]);
  // Before the strip asks for its crops: the picture of the question comes first.
  useLayoutEffect(() => {
    /** @param {number} id */
    const fetch = (id) => {
      const { picture, segmentation, mask: painted } = media.of(id);
      return Promise.allSettled(
        [picture, ...(lit ? [segmentation] : []), ...(mask ? [painted] : [])].map((one) => one.get()),
      );
    };
    // The others do not slow down the one that is looked at.
    const [now, ...later] = new Set(upcoming(line, AHEAD).flatMap((id) => app.boxes.get(id)?.frame_id ?? []));
    if (now !== undefined) void fetch(now).then(() => later.forEach((id) => void fetch(id)));
  }, [line, lit, mask]);
}

/**
 * @param {App} app @param {Session} session
 * @param {{stage: () => Stage | null, openComment: () => void, isBlind: () => boolean, openAlike: (answered: {boxId:
 *   number, verdict: Answer}) => void, peek: Value<number>, track: () => readonly import("./track.js").Place[], view:
 *   Value<"crop" | "frame">}} page
 */
function createQueueActions(app, session, page) {
  const { line } = session;
  const current = () => app.boxes.get(currentOf(line.get()) ?? 0) ?? null;

  function say() {
    const box = current();
    if (box) app.announcement.set(page.isBlind() ? `${box.class} ${box.id}` : spokenText(box));
  }

  /** Look at the object in another frame, or in the asked one again. @param {number} boxId */
  const peek = (boxId) => page.peek.set(boxId === current()?.box_id ? 0 : boxId);

  /** @param {1 | -1} step  frames in which the object is */
  function scrub(step) {
    const places = page.track();
    const here = page.peek.get() || current()?.box_id;
    const next = places[places.findIndex(({ boxId }) => boxId === here) + step];
    if (next && here) peek(next.boxId);
    else app.toasts.show(step < 0 ? "No earlier frame has the object." : "No later frame has the object.");
  }

  /** One answer for the object in all frames of the strip. @param {"keep" | "reject"} verdict */
  function answerTrack(verdict) {
    const boxes = app.boxes.all(page.track().map(({ boxId }) => boxId));
    if (boxes.length === 0) return app.toasts.show("The object is in no other frame of its recording.");
    page.peek.set(0);
    if (session.answerMany(boxes, verdict)) say();
  }

  /** @param {Line} next */
  function show(next) {
    page.peek.set(0);
    page.view.set("crop");
    session.show(next);
    say();
  }

  /** @param {Answer} verdict */
  function answer(verdict) {
    const box = current();
    if (!box) return;
    if (page.peek.get()) {
      page.peek.set(0);
      return app.toasts.show("Nothing was saved: another frame was on show. This is the asked one.");
    }
    const lookedMs = page.stage()?.lookedMs(box.box_id) ?? null;
    if (verdict !== "unsure" && lookedMs === null) return app.toasts.show(NOT_PAINTED);
    performance.mark("queue:answer");
    const isOwn = session.tally.get().verdicts.has(box.box_id);
    const words = typedComment(box.box_id) ?? (page.isBlind() && !isOwn ? "" : (box.review?.comment ?? ""));
    const isSame = box.review?.verdict === verdict && (box.review.comment ?? "") === words;
    page.view.set("crop");
    if (isOwn && isSame) session.show(nextOpen(line.get()));
    else if (session.answer(box, verdict, words, { lookedMs, isBlindly: page.isBlind() && !isOwn }))
      forgetTyped(box.box_id);
    say();
  }

  function undo() {
    app.undo((box, dataset) => {
      if (dataset !== session.dataset)
        return app.router.go(linkTo("frame", { id: box.frame_id }, { box: String(box.box_id) }));
      page.view.set("crop");
      session.answerUndone(box);
    }, session.manyUndone);
  }

  function alike() {
    const answered = session.lastAnswer();
    if (answered) page.openAlike(answered);
    else app.toasts.show("Answer a box first; then this offers the boxes like it.");
  }

  /** The box, the whole frame, the box again; after a pan, first back to the box. */
  function crop() {
    if (page.stage()?.mode() === "free" && page.view.get() === "crop") page.stage()?.recrop();
    else page.view.set(page.view.get() === "crop" ? "frame" : "crop");
  }

  return {
    show,
    peek,

    /**
     * A comment on a box that has no answer flags it as unsure, and stays.
     * @param {Answer} verdict @param {string} comment @returns {boolean} false: it was not given
     */
    saveComment(verdict, comment) {
      const box = current();
      return box !== null && session.comment(box, answerOf(box) ?? verdict, comment);
    },

    reviewSkipped: () => show(backToSkipped(line.get())),

    /** By the names of the keymap. */
    byName: {
      keep: () => answer("keep"),
      reject: () => answer("reject"),
      unsure: () => answer("unsure"),
      undo,
      alike,
      keepTrack: () => answerTrack("keep"),
      rejectTrack: () => answerTrack("reject"),
      earlier: () => scrub(-1),
      later: () => scrub(1),
      comment: () => current() && page.openComment(),
      next: () => show(stepped(line.get(), 1)),
      previous: () => show(stepped(line.get(), -1)),
      nextUnanswered: () => show(nextOpen(line.get())),
      grid: () =>
        app.router.go(linkTo("grid", { dataset: session.dataset }, { ...session.query, order: "", blind: "" })),
      ...createLookActions(app, page.stage),
      cycleVerdict: () => cycleVerdict(app),
      blind() {
        const { query, params } = app.router.route.get();
        app.router.replace(linkTo("queue", params, { ...query, blind: page.isBlind() ? "off" : "on" }));
      },
      crop,
      fit() {
        page.view.set("frame");
        page.stage()?.fit();
      },
      escape() {
        page.peek.set(0);
        page.view.set("crop");
      },
    },
  };
}

/** @typedef {ReturnType<typeof createQueueActions>} QueueActions */

/**
 * @param {{box: Decision, session: Session, onSee: (() => void) |
 *   null}} props `onSee`: null if they cannot be shown before
 */
function BlindPanel({ box, session, onSee }) {
  const last = useValue(session.comparisons).at(-1);
  return html`<aside class="panel panel--inspector" aria-label="Selected box">
    <header class="inspector__head"><h2>${box.class} <span class="faint">${box.id}</span></h2></header>
    <p class="inspector__sentence">The filter's verdict and earlier answers are hidden until you have answered.</p>
    ${
      last &&
      html`<p class="agreement agreement--${last.agrees ? "yes" : "no"}"
        role="status"><${Icon} name=${last.agrees ? "check" : "warn"} /><span>${last.words}</span></p>`
    }
    <dl class="facts">
      <div><dt>Frame</dt><dd>${box.frame}</dd></div>
      ${distanceText(box) && html`<div><dt>Distance</dt><dd class="num">${distanceText(box)}</dd></div>`}
    </dl>
    ${onSee && html`<button class="button" onClick=${onSee}>Show verdicts</button>`}
  </aside>`;
}

const Fetching = () =>
  html`<div class="queue__message"
    aria-busy="true"><div class="queue__wait shimmer"></div><p class="sr-only" role="status">Loading the next boxes</p>
  </div>`;

/** @param {{app: App, session: Session, query: Query, actions: QueueActions, onAll: () => void}} props */
function AllDone({ app, session, query, actions, onAll }) {
  const { verdicts } = useValue(session.tally);
  const { elsewhere } = useValue(session.counts);
  const { waiting } = useValue(app.sender.state);
  const open = skippedBoxes(useValue(session.line)).length;
  const { dataset, order } = session;
  const title = verdicts.size ? "All done" : order === "audit" ? "Nothing to audit" : "Nothing to review";
  return html`<div class="queue__message">
    <${Notice} icon="check" title=${title}
      actions=${html`<${NextSteps} dataset=${dataset} order=${order} query=${query} open=${open} elsewhere=${elsewhere}
        session=${session} actions=${actions} onAll=${onAll} />`}>
      <p>
        ${
          doneText(verdicts) ||
          (order === "audit"
            ? "Nobody else has answered a box that matches these filters and that you have not: nobody audits himself."
            : "All boxes that the queue asks about have an answer.")
        }</p>
      ${
        waiting.size > 0 &&
        html`<p>${countOf(waiting.size, "answer is", "answers are")} kept in this browser and will be sent.</p>`
      }
      ${open > 0 && html`<p>You skipped ${countOf(open, "box", "boxes")}.</p>`}
      <${OtherBins} dataset=${dataset} />
      ${
        elsewhere > 0 &&
        html`<p>${countOf(elsewhere, "box is", "boxes are")} being reviewed by somebody else at the moment.</p>`
      }
    <//>
  </div>`;
}

/**
 * The boxes that the queue does not ask about: they need no answer, and can be answered all at once.
 * @param {{dataset: string}} props
 */
function OtherBins({ dataset }) {
  const { value } = useLoaded(
    (signal) => get("/api/v1/datasets/{dataset}/stats", { path: { dataset }, signal }),
    [dataset],
  );
  const left = BINS.filter((bin) => bin.value !== "ask" && value?.bins?.[bin.value]);
  if (left.length === 0) return null;
  return html`<p>The other boxes need no answer. You can look at them, and answer all of a kind at once:</p>
  <ul class="bins">
    ${left.map(
      (bin) => html`<li key=${bin.value}>
        <a href=${linkTo("grid", { dataset }, { bin: bin.value, review: "undecided" })}>
          <b class="num">${countText(value?.bins?.[bin.value] ?? 0)}</b> ${bin.left}</a></li>`,
    )}
  </ul>`;
}

/**
 * What one can do now.
 * @param {{dataset: string, order: string, query: Query, open: number, elsewhere: number, session: Session, actions:
 *   QueueActions, onAll: () => void}} props
 */
function NextSteps({ dataset, order, query, open, elsewhere, session, actions, onAll }) {
  return html`${
    open > 0 &&
    html`<button class="button button--primary"
      onClick=${actions.reviewSkipped}>Review ${open === 1 ? "it" : "them"} now</button>`
  }
  ${elsewhere > 0 && html`<button class="button" onClick=${session.lookAgain}>Look again</button>`}
  ${
    (isFiltered(query) || session.listed.length > 0) &&
    html`<button class="button"
      onClick=${onAll}>${session.listed.length > 0 ? "The whole queue" : "Without the filters"}</button>`
  }
  ${
    order !== "audit" &&
    html`<a class="button" href=${linkTo("queue", { dataset }, { order: "audit" })}>Audit the answers</a>`
  }
  <a class="button" href=${linkTo("grid", { dataset })}>Grid</a>
  <a class="button" href=${linkTo("frames", { dataset })}>Frames</a>`;
}

/** @param {ReadonlyMap<number, string>} verdicts */
function doneText(verdicts) {
  if (verdicts.size === 0) return "";
  const of = (/** @type {string} */ verdict) => [...verdicts.values()].filter((given) => given === verdict).length;
  const parts = [
    `${countText(of("keep"))} kept`,
    `${countText(of("reject"))} rejected`,
    ...(of("unsure") ? [`${countText(of("unsure"))} unsure`] : []),
  ];
  return `You answered ${countOf(verdicts.size, "box", "boxes")}: ${parts.join(", ")}.`;
}

/**
 * Notices for boxes that somebody else answered first.
 * @param {{app: App, session: Session, onShow: (line: Line) => void}} props
 */
function OvertakenNotices({ app, session, onShow }) {
  const overtaken = [...useValue(app.overtaken).values()].flatMap((item) => {
    const box = session.line.get().ids.includes(item.boxId) ? app.boxes.get(item.boxId) : undefined;
    return box ? [{ item, box }] : [];
  });
  if (overtaken.length === 0) return null;
  return html`<div class="queue__overtaken">
    ${overtaken.map(
      ({ item, box }) => html`<${OvertakenNotice} key=${box.box_id} app=${app} box=${box} item=${item} isNamed=${true}>
        <button class="button button--small button--quiet"
          onClick=${() => onShow(movedTo(session.line.get(), box.box_id))}>Look at it</button>
      <//>`,
    )}
  </div>`;
}
