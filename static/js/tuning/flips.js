// @ts-check
// Boxes whose verdict changes ("flips"): counts, tabs, cards. The view of runs shows them, too.

import { NearBox } from "../boxes/crops.js";
import { causeText } from "../boxes/wording.js";
import { html } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf, countText } from "../core/numbers.js";
import { linkTo } from "../core/router.js";

/** @import { App } from "../core/app.js" */
/** @import { Flip } from "../core/openapi.js" */
/** @import { Tuning } from "./preview.js" */
/** @typedef {"kept_to_rejected" | "rejected_to_kept"} Direction */

/** How large a picture is, in css px: about that, as cards share the width of the list. */
const PICTURE_PX = 140;

const DIRECTIONS = /** @type {const} */ ({
  kept_to_rejected: { after: "rejected", text: "kept → rejected" },
  rejected_to_kept: { after: "kept", text: "rejected → kept" },
});

/** @param {Flip} flip @returns {Direction} */
export const directionOf = (flip) => (flip.before.verdict === "kept" ? "kept_to_rejected" : "rejected_to_kept");

/**
 * @param {{direction: string, counts: Record<Direction, number>, onChange: (direction: Direction | "") => void}} props
 */
export function DirectionTabs({ direction, counts, onChange }) {
  const choices = /** @type {const} */ ([
    { value: "", count: sumOf(counts), text: "All" },
    { value: "kept_to_rejected", count: counts.kept_to_rejected, text: DIRECTIONS.kept_to_rejected.text },
    { value: "rejected_to_kept", count: counts.rejected_to_kept, text: DIRECTIONS.rejected_to_kept.text },
  ]);
  return html`<div class="segments segments--wide directiontabs" role="group" aria-label="Which flips">
    ${choices.map(
      ({
        value,
        count,
        text,
      }) => html`<button class="segments__item" aria-pressed=${direction === value} onClick=${() => onChange(value)}>
        ${value && html`<${DirectionSign} direction=${value} />`}<span>${text}</span>
        <span class="num directiontabs__count">${countText(count)}</span>
      </button>`,
    )}
  </div>`;
}

/** @param {Record<Direction, number>} counts */
const sumOf = (counts) => counts.kept_to_rejected + counts.rejected_to_kept;

/**
 * @typedef {{before: (verdict: string) => string, after: (verdict: string) => string}} SideWords how the verdicts of
 *   both sides are said
 */

/** @type {SideWords} */
const TRIED = { before: (verdict) => `${verdict} now`, after: (verdict) => `would be ${verdict}` };

/** @param {{items: readonly Flip[], words: SideWords}} props */
export const FlipGrid = ({ items, words }) => html`<ul class="flips">
  ${items.map((flip) => html`<li key=${flip.box_id}><${FlipCard} flip=${flip} words=${words} /></li>`)}
</ul>`;

/** @param {{flip: Flip, words: SideWords}} props */
function FlipCard({ flip, words }) {
  const { box_id: id, xyxy, before, after } = flip;
  const direction = directionOf(flip);
  const box = { box_id: id, xyxy, reason: after.reason, effective_verdict: after.verdict };
  return html`<a class="flip flip--${DIRECTIONS[direction].after}"
    href=${linkTo("frame", { id: flip.frame_id }, { box: String(id) })}>
    <span class="flip__picture"><${NearBox} box=${box} size=${PICTURE_PX} /><${DirectionSign} direction=${direction} />
      <${Truth} flip=${flip} /></span>
    <span class="flip__class">${flip.class}<span class="sr-only"> of box ${id}</span></span>
    <span class="flip__side"><b>${words.before(before.verdict)}:</b> <span>${causeText(before)}</span></span>
    <span class="flip__side"><b>${words.after(after.verdict)}:</b> <span>${causeText(after)}</span></span>
  </a>`;
}

/** Whether the new verdict is right, where the truth is known. @param {{flip: Flip}} props */
function Truth({ flip: { visible, after } }) {
  if (typeof visible !== "boolean" || after.verdict === "unmeasured") return null;
  const isRight = (after.verdict === "kept") === visible;
  const text = `${isRight ? "right" : "wrong"}: the object is ${visible ? "" : "not "}visible`;
  return html`<span class="truth truth--${isRight ? "right" : "wrong"}" title=${text}>
    <${Icon} name=${isRight ? "check" : "cross"} /><span aria-hidden="true">${isRight ? "right" : "wrong"}</span>
    <span class="sr-only">${text}</span>
  </span>`;
}

/**
 * @param {{app: App, tuning: Tuning, selected: string, direction: string, onDirection: (direction: string) => void}}
 *   props
 */
export function FlipPanel({ app, tuning, selected, direction, onDirection }) {
  const { preview, listed } = tuning;
  const flips = preview?.flips;
  const counts = (selected ? flips?.by_class[selected] : flips) ?? { kept_to_rejected: 0, rejected_to_kept: 0 };
  const items = (listed?.flips?.items ?? []).filter(
    (flip) => (!selected || flip.class === selected) && (!direction || directionOf(flip) === direction),
  );
  const wanted =
    direction === "kept_to_rejected" || direction === "rejected_to_kept" ? counts[direction] : sumOf(counts);
  return html`<aside class="panelbox flippanel" aria-labelledby="flips-title">
    <header class="panelbox__head">
      <h2 id="flips-title">Would flip${selected ? `: ${selected}` : ""}</h2>
      <span class="faint">nearest to the threshold first</span>
    </header>
    <${DirectionTabs} direction=${direction} counts=${counts} onChange=${onDirection} />
    <${Body} app=${app} tuning=${tuning} items=${items} wanted=${wanted} />
  </aside>`;
}

/** @param {{app: App, tuning: Tuning, items: readonly Flip[], wanted: number}} props */
function Body({ app, tuning, items, wanted }) {
  const { preview, listed, isListed } = tuning;
  if (!preview) return html`<div class="flippanel__list"><${SkeletonCards} /></div>`;
  if (wanted === 0)
    return html`<p class="panelbox__empty">No verdict changes. Move a threshold to see which ones would.</p>`;
  return html`<div class="flippanel__list ${isListed ? "" : "is-behind"}" aria-busy=${!isListed}>
    ${
      items.length === 0 &&
      (isListed
        ? html`<p
          class="panelbox__empty">None of these is among the ${countText(listed?.flips?.items.length ?? 0)} nearest.
        </p>`
        : html`<${SkeletonCards} />`)
    }
    <${FlipGrid} items=${items} words=${TRIED} />
    <${ShowMoreFlips} tuning=${tuning} shown=${items.length} wanted=${wanted} />
  </div>`;
}

const SkeletonCards = () =>
  html`<ul class="flips" aria-hidden="true">
    ${[0, 1, 2, 3, 4, 5].map(() => html`<li class="flip"><span class="flip__picture shimmer"></span></li>`)}</ul>`;

/** @param {{tuning: Tuning, shown: number, wanted: number}} props */
function ShowMoreFlips({ tuning, shown, wanted }) {
  if (shown >= wanted || !tuning.isListed) return null;
  return html`<p class="flippanel__more">
    <span class="faint">${countText(shown)} of ${countOf(wanted, "box", "boxes")}</span>
    ${!tuning.showsMany && html`<button class="button button--small" onClick=${tuning.showMany}>Show more</button>`}
  </p>`;
}

/**
 * The difference to the active configuration.
 * @param {{count: number | undefined, before: number | undefined}} props
 */
export function Delta({ count, before }) {
  const by = count === undefined || before === undefined ? 0 : count - before;
  return html`<span class="delta num ${by === 0 ? "is-none" : ""}">
    ${by === 0 ? "±0" : `${by > 0 ? "+" : "−"}${countText(Math.abs(by))}`}</span>`;
}

/** The sign of a flip's new verdict. @param {{direction: Direction}} props */
export const DirectionSign = ({ direction }) =>
  html`<span class="direction direction--${DIRECTIONS[direction].after}"
    aria-hidden="true"><${Icon} name=${DIRECTIONS[direction].after === "rejected" ? "cross" : "check"} /></span>`;
