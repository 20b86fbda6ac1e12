// @ts-check
// The boxes that change sides, with what they show; each leads to its frame.

import { html } from "../../html.js";
import { jobs } from "../../calls/jobs.js";
import { linkTo } from "../../router.js";
import { countText, percentText, reasonText } from "../../wording.js";
import { NearPicture } from "../crop_cache.js";
import { Icon } from "../icons.js";
import { Way } from "./summary.js";

/** @typedef {import("../../app.js").App} App */
/** @typedef {import("../../types_jobs.js").Flip} Flip */
/** @typedef {"lost" | "won"} WayOf */

const CROP_PX = 144;

export const WAYS = /** @type {const} */ ({
  lost: { text: "kept → rejected", spoken: "from kept to rejected" },
  won: { text: "rejected → kept", spoken: "from rejected to kept" },
});

/** @param {Flip} flip @returns {WayOf} */
export const wayOf = (flip) => (flip.before.verdict === "kept" ? "lost" : "won");

/** @param {{way: string, lost: number, won: number, onChange: (way: WayOf | "") => void}} props */
export function WayTabs({ way, lost, won, onChange }) {
  const choices = /** @type {const} */ ([
    { value: "", count: lost + won, text: "All" },
    { value: "lost", count: lost, text: WAYS.lost.text },
    { value: "won", count: won, text: WAYS.won.text },
  ]);
  return html`<div class="segments segments--wide waytabs" role="group" aria-label="Which flips">
    ${choices.map(
      ({ value, count, text }) => html`<button class="segments__item" aria-pressed=${way === value} onClick=${() => onChange(value)}>
        ${value && html`<${Way} way=${value} />`}<span>${text}</span><span class="num waytabs__count">${countText(count)}</span>
      </button>`,
    )}
  </div>`;
}

/** @param {{app: App, items: readonly Flip[]}} props */
export const FlipGrid = ({ app, items }) => html`<ul class="flips">
  ${items.map((flip) => html`<li key=${flip.box_id}><${FlipCard} app=${app} flip=${flip} /></li>`)}
</ul>`;

/** @param {{app: App, flip: Flip}} props */
function FlipCard({ app, flip }) {
  const way = wayOf(flip);
  const match = flip.match_percent === null ? "no match" : percentText(flip.match_percent);
  return html`<a class="flip flip--${way}" href=${linkTo("frame", { id: flip.frame_id }, { box: String(flip.box_id) })}
    title=${`${flip.class}, ${match}: ${reasonText(flip.before.reason)} → ${reasonText(flip.after.reason)}`}>
    <span class="flip__picture">
      <${NearPicture} app=${app} url=${jobs.cropUrl(flip.box_id, CROP_PX)}><${Icon} name="image" /><//>
      <${Way} way=${way} />
    </span>
    <span class="flip__text"><span class="flip__class">${flip.class}</span><span class="num">${match}</span></span>
    <span class="flip__reason">${reasonText(flip.after.verdict === "kept" ? flip.before.reason : flip.after.reason)}<span class="sr-only">, ${WAYS[way].spoken}, box ${flip.box_id}</span></span>
  </a>`;
}
