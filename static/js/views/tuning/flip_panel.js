// @ts-check
// Beside the histograms: the boxes that would flip.

import { html } from "../../html.js";
import { countOf, countText } from "../../wording.js";
import { FlipGrid, WayTabs, wayOf } from "./flips.js";

/** @typedef {import("../../app.js").App} App */
/** @typedef {import("./state.js").Tuning} Tuning */

/** @param {{app: App, tuning: Tuning, selected: string, way: string, onWay: (way: string) => void}} props */
export function FlipPanel({ app, tuning, selected, way, onWay }) {
  const { preview, listed } = tuning;
  const flips = preview?.flips;
  const counts = (selected ? flips?.by_class[selected] : flips) ?? { kept_to_rejected: 0, rejected_to_kept: 0 };
  const items = (listed?.flips?.items ?? []).filter((flip) => (!selected || flip.class === selected) && (!way || wayOf(flip) === way));
  const wanted = way === "lost" ? counts.kept_to_rejected : way === "won" ? counts.rejected_to_kept : counts.kept_to_rejected + counts.rejected_to_kept;
  return html`<aside class="panelbox flippanel" aria-labelledby="flips-title">
    <header class="panelbox__head">
      <h2 id="flips-title">Would flip${selected ? `: ${selected}` : ""}</h2>
      <span class="faint">nearest to the threshold first</span>
    </header>
    <${WayTabs} way=${way} lost=${counts.kept_to_rejected} won=${counts.rejected_to_kept} onChange=${onWay} />
    <${Body} app=${app} tuning=${tuning} items=${items} wanted=${wanted} />
  </aside>`;
}

/** @param {{app: App, tuning: Tuning, items: readonly import("../../types_jobs.js").Flip[], wanted: number}} props */
function Body({ app, tuning, items, wanted }) {
  const { preview, listed, isListed } = tuning;
  if (!preview) return html`<div class="flippanel__list"><${Bones} /></div>`;
  if (wanted === 0) return html`<p class="panelbox__empty">No box changes sides. Move a threshold to see which ones would.</p>`;
  return html`<div class="flippanel__list ${isListed ? "" : "is-behind"}" aria-busy=${!isListed}>
    ${items.length === 0 && (isListed ? html`<p class="panelbox__empty">None of these is among the ${countText(listed?.flips?.items.length ?? 0)} nearest.</p>` : html`<${Bones} />`)}
    <${FlipGrid} app=${app} items=${items} />
    <${More} tuning=${tuning} shown=${items.length} wanted=${wanted} />
  </div>`;
}

const Bones = () => html`<ul class="flips" aria-hidden="true">${[0, 1, 2, 3, 4, 5].map(() => html`<li class="flip"><span class="flip__picture shimmer"></span></li>`)}</ul>`;

/** @param {{tuning: Tuning, shown: number, wanted: number}} props */
function More({ tuning, shown, wanted }) {
  if (shown >= wanted || !tuning.isListed) return null;
  return html`<p class="flippanel__more">
    <span class="faint">${countText(shown)} of ${countOf(wanted, "box", "boxes")}</span>
    ${!tuning.showsMany && html`<button class="button button--small" onClick=${tuning.showMany}>Show more</button>`}
  </p>`;
}
