// @ts-check
// Everything about one box: verdict, explanation, numbers, comment, overlapping boxes, history.

import { answerOf, isUnanswered, isWithheld, seenRevision } from "../boxes/box.js";
import { ANSWER_ICONS, AnswerSign, StrokeSwatch, VerdictBadge } from "../boxes/signs.js";
import {
  ANSWER_TEXT,
  acceptedText,
  distanceText,
  evidenceText,
  isByShare,
  labelText,
  matchText,
  reasonText,
} from "../boxes/wording.js";
import { get } from "../core/api.js";
import { useNewest, useValue } from "../core/hooks.js";
import { html, useEffect, useMemo, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { Keys, useKeys } from "../core/keymap.js";
import { agoText, countOf, countText, exactPercentText, percentText, unbroken } from "../core/numbers.js";
import { FailureLine, MiddleCut } from "../core/parts.js";
import { linkTo } from "../core/router.js";
import { overlapping } from "../stage/geometry.js";
import { OvertakenNotice } from "./answer_bar.js";

/** @import { Decision } from "../boxes/box.js" */
/** @import { HistoryEntry } from "../core/openapi.js" */
/** @import { Frame } from "../stage/media.js" */
/** @import { ReviewApp as App } from "./answers.js" */
/** @import { FrameActions } from "./frame.js" */

/** Said in place of an answer by somebody who cannot have seen the box. */
export const NOT_PAINTED =
  "Nothing was saved: the picture of this box is not on the screen yet. Unsure can be answered without it.";

/**
 * @param {{app: App, frame: Frame | null, box: Decision | null, boxes: readonly Decision[], isWaiting: boolean,
 *   actions: FrameActions, commentRef: {current: HTMLTextAreaElement | null}}} props
 *   `frame`: whose view this is; null: the view is not of one frame, so the box's is named
 */
export function Inspector({ app, frame, box, boxes, isWaiting, actions, commentRef }) {
  return html`<aside class="panel panel--inspector" aria-label="Selected box">
    ${
      box
        ? html`<${BoxDetails} key=${box.box_id} app=${app} frame=${frame} box=${box} boxes=${boxes}
          isWaiting=${isWaiting} actions=${actions} commentRef=${commentRef} />`
        : html`<${FrameDetails} app=${app} frame=${frame} boxes=${boxes} onStart=${actions.byName.nextUnanswered} />`
    }
  </aside>`;
}

/**
 * @param {{app: App, frame: Frame | null, box: Decision, boxes: readonly Decision[], isWaiting: boolean,
 *   actions: FrameActions, commentRef: {current: HTMLTextAreaElement | null}}} props
 */
function BoxDetails({ app, frame, box, boxes, isWaiting, actions, commentRef }) {
  const mine = useValue(app.overtaken).get(box.box_id);
  // The server keeps a comment as part of an answer only. On a box that has none, the comment comes with "unsure",
  // which
  // leaves the filter's verdict in force.
  const saveComment = (/** @type {string} */ text) => actions.saveComment(answerOf(box) ?? "unsure", text);
  return html`
    <header class="inspector__head">
      <h2>${box.class} <span class="faint">${box.id}</span></h2>
      <${VerdictBadge} verdict=${box.verdict} />
    </header>
    ${
      !frame &&
      html`<p class="inspector__frame faint"><span>Frame</span>
        <a href=${linkTo("frame", { id: box.frame_id }, { box: String(box.box_id) })}
          title=${box.frame}><${MiddleCut} text=${box.frame} /></a></p>`
    }
    ${mine && html`<${OvertakenNotice} app=${app} box=${box} item=${mine} />`}
    <${AnswerLine} box=${box} isWaiting=${isWaiting} />
    <p class="inspector__sentence">
      ${
        isWithheld(box)
          ? "Blind re-check: the filter's verdict is shown once you have answered."
          : unbroken(box.explanation || labelText(box))
      }</p>
    ${
      box.question &&
      html`<p class="inspector__question"><${Icon} name="question" />To review: ${unbroken(box.question)}.</p>`
    }
    <${MatchBar} box=${box} />
    <${HiddenBy} box=${box} />
    <${Comment} box=${box} onSave=${saveComment} fieldRef=${commentRef} />
    <${Neighbours} boxes=${boxes} box=${box} onSelect=${actions.select} />
    <section class="numbers">
      <h3>Numbers</h3>
      <dl class="facts">
        ${rowsOf(box).map(
          ([name, value]) => value !== null && html`<div><dt>${name}</dt><dd class="num">${value}</dd></div>`,
        )}
      </dl>
    </section>
    ${!isWithheld(box) && html`<${History} app=${app} box=${box} />`}`;
}

/** @param {{box: Decision, isWaiting: boolean}} props */
function AnswerLine({ box, isWaiting }) {
  const answer = answerOf(box);
  if (!answer) return html`<p class="answerline faint">It has no answer.</p>`;
  const state = isWaiting ? "not saved yet" : "saved";
  return html`<p class="answerline">
    <${AnswerSign} box=${box} isWaiting=${isWaiting} />
    <span><b>${answer}</b>${box.review?.reviewer ? ` by ${box.review.reviewer}` : ""}</span>
    <span class="answerline__state">${state}</span>
  </p>`;
}

/** What decided: the share of matching pixels and the threshold, or another channel. @param {{box: Decision}} props */
function MatchBar({ box }) {
  const { match_percent: match, threshold } = box;
  if (!isByShare(box) && !isWithheld(box)) return html`<${OtherChannel} box=${box} />`;
  if (match === null || match === undefined) return null;
  const share = percentText(match, threshold);
  const limit = threshold === null ? "" : `threshold ${exactPercentText(threshold)}`;
  const text = `${share} of the box is ${acceptedText(box)}${limit && `, ${limit}`}`;
  return html`<div class="match">
    <div class="match__text"><span>${acceptedText(box)}</span><span class="num">${share}</span></div>
    <div class="match__track" role="img" aria-label=${text}>
      <span class="match__fill match__fill--${box.verdict}" style=${{ width: `${Math.min(100, match)}%` }} />
      ${threshold !== null && html`<span class="match__tick" style=${{ left: `${Math.min(100, threshold)}%` }} />`}
    </div>
    ${
      threshold !== null &&
      html`<div class="match__scale"><span style=${{ left: `${Math.min(65, threshold)}%` }}>${limit}</span></div>`
    }
    ${
      box.toss_up &&
      html`<p class="match__note">
        <${Icon} name="warn" />A toss-up: too few pixels to be certain on which side of the threshold the box is.</p>`
    }
  </div>`;
}

/** Another channel decided; the share of matching pixels is shown as a side note. @param {{box: Decision}} props */
function OtherChannel({ box }) {
  const { match_percent: match, visible_pixels: visible } = box;
  return html`<div class="match match--other">
    <div class="match__text"><span>Decided by ${evidenceText(box.evidence ?? "")}</span>
      ${typeof visible === "number" && html`<span class="num">${countOf(visible, "pixel")} seen</span>`}</div>
    ${
      typeof match === "number" &&
      html`<p class="match__note">${percentText(match)} of the box is ${acceptedText(box)}, which did not decide.</p>`
    }
  </div>`;
}

/** @param {{box: Decision}} props */
function HiddenBy({ box }) {
  if (!box.hidden_by?.length) return null;
  return html`<section class="hidden-by">
    <h3>${box.verdict === "rejected" && isByShare(box) ? "Hidden by" : "Also in the box"}</h3>
    <ul>
      ${box.hidden_by.map(
        ({ name, rgb, percent }) => html`<li>
          <span class="hidden-by__name"><span class="swatch" style=${{ background: `rgb(${rgb.join(" ")})` }} />${name}
          </span>
          <span class="hidden-by__track"
            aria-hidden="true"><span style=${{ width: `${Math.min(100, percent)}%` }} /></span>
          <span class="num">${percentText(percent)}</span>
        </li>`,
      )}
    </ul>
  </section>`;
}

/**
 * No box is selected: the frame itself, and where to start.
 * @param {{app: App, frame: Frame, boxes: readonly Decision[], onStart: () => void}} props
 */
function FrameDetails({ app, frame, boxes, onStart }) {
  const unanswered = boxes.filter(isUnanswered).length;
  const { segmentation } = frame;
  const keys = useKeys(app).find(({ action }) => action === "nextUnanswered")?.keys ?? [];
  const facts = [
    ["Size", frame.width && frame.height ? `${frame.width} × ${frame.height}` : "unknown"],
    ["Map", frame.map],
    ["Part", frame.split ?? null],
    ["Sequence", frame.sequence ?? null],
    ["CARLA", frame.carla_version],
    [
      "Segmentation",
      segmentation
        ? `${segmentation.palette}, ${segmentation.encoding}, ${segmentation.channel_order}${segmentation.lossy ? ", lossy" : ""}`
        : "none",
    ],
    ["Revision", frame.revision > 1 ? String(frame.revision) : null],
  ];
  return html`
    <header class="inspector__head"><h2>This frame</h2></header>
    <p class="inspector__sentence">
      ${
        unanswered
          ? `${countText(unanswered)} of ${countText(boxes.length)} boxes have no answer yet.`
          : "Every box here has an answer."
      }</p>
    ${
      unanswered > 0 &&
      html`<button class="button button--primary"
        onClick=${onStart}>Next box without an answer<${Keys} app=${app} keys=${keys} /></button>`
    }
    <dl class="facts">${facts.map(([name, value]) => value && html`<div><dt>${name}</dt><dd>${value}</dd></div>`)}</dl>
    ${segmentation?.notes?.map((note) => html`<p class="faint">${note}</p>`)}`;
}

/** The comments that were typed and not saved yet, by box. @type {Map<number, string>} */
const typed = new Map();

/** The comment that was typed for a box, which goes with its answer; undefined: none. @param {number} boxId */
export const typedComment = (boxId) => typed.get(boxId)?.trim();

/** It went with an answer. @param {number} boxId */
export const forgetTyped = (boxId) => void typed.delete(boxId);

/**
 * @param {{box: Decision, onSave: (text: string) => boolean, fieldRef: {current: HTMLTextAreaElement | null}}} props
 *   `onSave` returns whether the comment was given as part of an answer
 */
function Comment({ box, onSave, fieldRef }) {
  const stored = box.review?.comment ?? "";
  const [text, show] = useState(/** @type {string | null} */ (typed.get(box.box_id) ?? null));
  const shown = text ?? stored;
  /** @param {string | null} next */
  const setText = (next) => {
    const text = next === stored ? null : next;
    if (text === null) typed.delete(box.box_id);
    else typed.set(box.box_id, text);
    show(text);
  };
  // It went with an answer.
  useEffect(() => {
    if (text?.trim() === stored) setText(null);
  }, [stored]);
  const save = () => {
    if (shown.trim() !== stored && !onSave(shown.trim())) return;
    setText(null);
    fieldRef.current?.blur();
  };
  /** @param {KeyboardEvent} event */
  const onKeyDown = (event) => {
    if (event.key === "Enter" && !event.shiftKey) {
      event.preventDefault();
      save();
    } else if (event.key === "Escape") {
      event.stopPropagation();
      setText(null);
      fieldRef.current?.blur();
    }
  };
  const hint = answerOf(box) ? "Enter saves, Esc cancels" : "Enter saves and flags the box as unsure";
  return html`<div class="comment">
    <label class="field">
      <span>Comment</span>
      <textarea ref=${fieldRef} rows="2" maxlength="2000" value=${shown} placeholder="Why?" onKeyDown=${onKeyDown}
        onInput=${(/** @type {{currentTarget: HTMLTextAreaElement}} */ event) => setText(event.currentTarget.value)}>
      </textarea>
    </label>
    ${
      text !== null &&
      text !== stored &&
      html`<div class="comment__foot"><span class="faint">${hint}</span>
        <button class="button button--small" onClick=${save}>Save</button></div>`
    }
  </div>`;
}

/** How many entries of the history are shown at first. */
const NEWEST = 50;

/** @param {{app: import("../core/app.js").App, box: Decision}} props */
function History({ app, box }) {
  const { box_id } = box;
  const loaded = useNewest(
    NEWEST,
    (query, signal) => get("/api/v1/boxes/{box_id}/history", { path: { box_id }, query, signal }),
    [box_id, seenRevision(box), box.run],
  );
  return html`<section class="history" aria-busy=${loaded.state === "loading"}>
    <h3>History</h3>
    ${loaded.error && html`<${FailureLine} error=${loaded.error} onRetry=${loaded.reload} />`}
    ${
      !loaded.error &&
      html`<ol class="history__list">
        ${
          loaded.value?.items.map(
            (item) => html`<li class="history__item">
              ${item.kind === "review" ? html`<${ReviewLine} item=${item} />` : html`<${DecisionLine} item=${item} />`}
            </li>`,
          ) ??
          html`<li class="history__wait"
            aria-hidden="true"><div class="skeleton" /><div class="skeleton skeleton--short" /></li>`
        }
      </ol>`
    }
    ${
      loaded.showOlder &&
      html`<p class="more"><button class="button button--small" onClick=${loaded.showOlder}>Older entries</button></p>`
    }
  </section>`;
}

/** @param {HistoryEntry} item */
function textOfReview({ verdict, undoes }) {
  if (!undoes) return ANSWER_TEXT[verdict ?? ""] ?? verdict;
  return verdict === "clear" ? "undid the answer" : `undid an answer, ${verdict} again`;
}

/** A look that is shorter is said with the answer. */
const HURRIED_MS = 250;

/** @param {{item: HistoryEntry}} props */
function ReviewLine({ item }) {
  return html`<span
    class="sign sign--${item.verdict}"><${Icon} name=${ANSWER_ICONS[item.verdict ?? ""] ?? "question"} /></span>
  <div>
    <p><b>${item.reviewer}</b>: ${textOfReview(item)} <${TimeAgo} at=${item.at} /></p>
    ${
      typeof item.looked_ms === "number" &&
      item.looked_ms < HURRIED_MS &&
      html`<p class="faint">after a look of ${(item.looked_ms / 1000).toFixed(2)} s</p>`
    }
    ${
      item.batch_size &&
      html`<p class="faint">one of ${countText(item.batch_size)} at once${
        typeof item.looked_at === "number" ? `, ${countText(item.looked_at)} of them looked at` : ""
      }</p>`
    }
    ${item.imported_by && html`<p class="faint">imported by ${item.imported_by}</p>`}
    ${
      item.chosen_by &&
      html`<p class="faint">from the queue, ${item.chosen_by === "random" ? "at random" : `by ${item.chosen_by}`}</p>`
    }
    ${item.comment && html`<p class="history__comment">${item.comment}</p>`}
  </div>`;
}

/** @param {{item: HistoryEntry}} props */
function DecisionLine({ item }) {
  const { verdict, reason, match_percent: match, threshold, run } = item;
  // Without a threshold the share decided nothing.
  const hasThreshold = typeof match === "number" && typeof threshold === "number";
  const numbers = hasThreshold ? ` · ${percentText(match, threshold)}, threshold ${exactPercentText(threshold)}` : "";
  return html`<span class="sign sign--filter"><${Icon} name="filter" /></span>
  <div>
    <p>Run ${run}
      : ${
        verdict
          ? html`<b>${verdict}</b>, ${reasonText(reason ?? "")}${unbroken(numbers)}`
          : "its measurements are no longer stored"
      } <${TimeAgo} at=${item.at} /></p></div>`;
}

/** @param {{at: string}} props */
const TimeAgo = ({ at }) => html`<time class="faint" datetime=${at} title=${at}>${agoText(at)}</time>`;

const MOST = 6;

/** @param {{boxes: readonly Decision[], box: Decision, onSelect: (boxId: number) => void}} props */
function Neighbours({ boxes, box, onSelect }) {
  const found = useMemo(() => overlapping(boxes, box), [boxes, box]);
  if (found.length === 0) return null;
  return html`<section class="neighbours" aria-label="Overlapping boxes">
    <h3>Overlaps <span class="faint">${countText(found.length)}</span></h3>
    <ul>
      ${found.slice(0, MOST).map(
        (other) => html`<li key=${other.box_id}>
          <button class="neighbour" onClick=${() => onSelect(other.box_id)}>
            <${StrokeSwatch} verdict=${other.effective_verdict} />
            <span class="neighbour__name">${other.class} <span class="faint">${other.id}</span></span>
            <span class="sr-only">${other.effective_verdict}</span>
            <span class="num">${matchText(other)}</span>
          </button>
        </li>`,
      )}
    </ul>
    ${found.length > MOST && html`<p class="faint">and ${countText(found.length - MOST)} more</p>`}
  </section>`;
}

/** Whether any tag counts for the box: pixels cannot match an unknown class. @param {Decision} box */
const isCounted = ({ verdict, reason }) => verdict !== "unmeasured" || reason === "unknown_pixels";

/** @param {Decision} box @returns {readonly (readonly [string, string | null])[]} */
function rowsOf(box) {
  const { xyxy } = box;
  return [
    [
      "Matched pixels",
      box.box_pixels && isCounted(box) ? `${countText(box.matched_pixels ?? 0)} of ${countText(box.box_pixels)}` : null,
    ],
    ["Margin", box.margin === null ? null : `${box.margin < 0 ? "−" : "+"}${percentText(Math.abs(box.margin))}`],
    ["Share of the image", percentText(box.area_percent)],
    ["Crowding", box.crowding === null ? null : percentText(box.crowding)],
    ["Distance", distanceText(box)],
    ["Evidence", box.evidence],
    ["Pixels taken by", box.explained_by ? `box ${box.explained_by}` : null],
    ["Rectangle", xyxy ? xyxy.map((value) => Math.round(value * 10) / 10).join(", ") : "outside the image"],
    ["Segmentation", box.lossy ? "lossy" : null],
    ["Run", String(box.run)],
    ["Configuration", box.config.slice(0, 8)],
  ];
}
