// @ts-check
// Above the queue's stage: order, filters, progress, and the strip with the boxes before and after the current one.

import { withheld } from "../boxes/box.js";
import { Picture } from "../boxes/crops.js";
import { DECIDED, FilterMenus, UNDECIDED, classChoices } from "../boxes/filter_bar.js";
import { BINS, isFiltered, withoutFilters, withoutList } from "../boxes/filters.js";
import { AnswerSign } from "../boxes/signs.js";
import { spokenText } from "../boxes/wording.js";
import { useValue } from "../core/hooks.js";
import { html, useEffect, useRef, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf, countText } from "../core/numbers.js";
import { Segments } from "../core/parts.js";
import { currentOf, inOrder, isBlind, movedTo, paceOf, upcoming } from "./line.js";
import { ORDERS, hasOnlyDoubts, orderOf } from "./session.js";

/** @import { ReviewApp as App } from "../review/answers.js" */
/** @import { Line } from "./line.js" */
/** @import { Query } from "../core/router.js" */
/** @import { Session } from "./session.js" */
/** @import { MediaCache } from "../stage/media.js" */

/**
 * @param {{app: App, session: Session, classes: readonly string[], query: Query, onChange: (query: Query) => void}}
 *   props
 */
export function QueueHead({ app, session, classes, query, onChange }) {
  const prefs = useValue(app.prefs);
  return html`<div class="queue__head">
    ${
      session.listed.length > 0
        ? html`<p class="queue__listed">
          ${countOf(session.listed.length, "chosen box", "chosen boxes")} <button class="button button--small"
            onClick=${() => onChange(withoutList(query))}>The whole queue</button></p>`
        : html`<${Choices} classes=${classes} query=${query} onChange=${onChange} />`
    }
    <label class="switch queue__blind" title="Hide the filter's verdict and earlier answers until you have answered">
      <input type="checkbox" checked=${isBlind(query, prefs)}
        onChange=${(/** @type {{currentTarget: HTMLInputElement}} */ event) =>
          onChange({ ...query, blind: event.currentTarget.checked ? "on" : "off" })} /><span>Blind</span>
    </label>
    <span class="queue__middle"></span>
    <${Progress} session=${session} />
  </div>`;
}

/** The choices besides the boxes to review. */
const OTHER_BINS = [...BINS.filter(({ value }) => value !== "ask"), { value: "all", text: "In doubt or not" }];

/**
 * The order and the filters of the queue.
 * @param {{classes: readonly string[], query: Query, onChange: (query: Query) => void}} props
 */
function Choices({ classes, query, onChange }) {
  const [isOpen, setOpen] = useState(false);
  const order = orderOf(query);
  const own = {
    bin: { any: "To review", choices: OTHER_BINS },
    class: { choices: classChoices(classes) },
    reason: { any: "Any reason in the image" },
    review: { any: order === "audit" ? DECIDED : UNDECIDED },
  };
  return html`<${Segments} label="Order" value=${order} choices=${ORDERS}
    onChange=${(/** @type {string} */ value) => onChange(inOrder(query, value))} />
  <button class="button queue__more ${isFiltered(query) ? "is-set" : ""}" aria-expanded=${isOpen}
    onClick=${() => setOpen(!isOpen)}><${Icon} name="filter" />Filters</button>
  <div class="queue__filters ${isOpen ? "is-open" : ""}" role="search" aria-label="Filter boxes">
    <${FilterMenus} query=${query} keys=${["bin", "verdict", "class", "reason", "review"]} own=${own}
      onChange=${onChange} onClear=${isFiltered(query) ? () => onChange(withoutFilters(query)) : null} />
  </div>`;
}

/** @param {{session: Session}} props */
function Progress({ session }) {
  const { left: unanswered, unsure } = useValue(session.counts);
  const isToReview = hasOnlyDoubts(session.query);
  // A box that somebody was unsure about is still to be reviewed.
  const left = unanswered !== null && isToReview ? unanswered + unsure : unanswered;
  const { times, verdicts } = useValue(session.tally);
  const comparisons = useValue(session.comparisons);
  const pace = paceOf(times);
  const done = verdicts.size;
  const all = done + (left ?? 0);
  const percent = all ? Math.floor((100 * done) / all) : 0;
  return html`<div class="queue__progress">
    <p role="status">
      ${
        session.order === "audit" && left !== null
          ? html`<b class="num">${countText(done)}</b> of <b class="num">${countText(all)}</b> audited`
          : html`<b class="num">${countText(done)}</b> answered${
              left !== null &&
              html` · <b class="num">${countText(left)}</b> ${
                session.query.review ? "left" : isToReview ? "to review" : "unanswered"
              }`
            }`
      }
      ${pace !== null && html`<span class="faint"> · ${countText(Math.round(pace))} per minute</span>`}
      ${
        comparisons.length > 0 &&
        html`<span
          class="faint"> · agreed on ${countText(comparisons.filter(({ agrees }) => agrees).length)} of ${countText(
            comparisons.length,
          )}</span>`
      }</p>
    <div class="progress__track" role="progressbar" aria-label="answered" aria-valuemin="0" aria-valuemax="100"
      aria-valuenow=${percent}><span class="progress__fill" style=${{ width: `${percent}%` }} /></div>
  </div>`;
}

const BEHIND = 3;
const AHEAD = 6;
const SIZE_PX = 56;

/**
 * @param {{app: App, session: Session, media: MediaCache, line: Line, isHidden: boolean, onShow: (line: Line) => void}}
 *   props
 */
export function QueueStrip({ app, session, media, line, isHidden, onShow }) {
  const { waiting } = useValue(app.sender.state);
  const list = useRef(/** @type {HTMLOListElement | null} */ (null));
  const { verdicts } = useValue(session.tally);
  const here = currentOf(line);
  // The first picture of a question comes before these.
  const [hasPicture, setHasPicture] = useState(false);
  const frameId = app.boxes.get(here ?? 0)?.frame_id;
  useEffect(() => {
    const shown = () => setHasPicture(true);
    if (frameId && !hasPicture) void media.of(frameId).picture.get().then(shown, shown);
  }, [frameId, hasPicture]);
  useEffect(
    () => list.current?.querySelector("[aria-current]")?.scrollIntoView({ block: "nearest", inline: "nearest" }),
    [here],
  );
  const ids = [
    ...line.ids.slice(Math.max(0, line.at - BEHIND), line.at),
    ...(here === null ? [] : [here]),
    ...upcoming(line, AHEAD),
  ];
  const boxes = ids.flatMap((id) => app.boxes.get(id) ?? []);
  return html`<ol class="strip-list" ref=${list} aria-label="Boxes before and after">
    ${boxes.map((box) => {
      const isCovered = isHidden && !verdicts.has(box.box_id);
      return html`<li key=${box.box_id}>
        <button class="strip-list__box ${isCovered ? "is-covered" : ""}"
          aria-current=${box.box_id === here ? "true" : undefined}
          aria-label=${isCovered ? `${box.class} ${box.id}` : spokenText(box)}
          title=${`${box.class} ${box.id}`} onClick=${() => onShow(movedTo(line, box.box_id))}>
          ${
            hasPicture
              ? html`<${Picture} box=${isCovered ? withheld(box) : box} size=${SIZE_PX} frameSize=${null} />`
              : html`<div class="cell__none shimmer"></div>`
          }
          ${
            !isCovered &&
            html`<span class="cell__answer"><${AnswerSign} box=${box} isWaiting=${waiting.has(box.box_id)} /></span>`
          }
        </button>
      </li>`;
    })}
  </ol>`;
}
