// @ts-check
// The boxes that overlap the selected one: often one of them explains it.

import { html, useMemo } from "../html.js";
import { overlapping } from "../geometry.js";
import { countText, matchText } from "../wording.js";
import { StrokeSwatch } from "./parts.js";

/** @typedef {import("../types.js").Decision} Decision */

const MOST = 6;

/** @param {{boxes: readonly Decision[], box: Decision, onSelect: (boxId: number) => void}} props */
export function Neighbours({ boxes, box, onSelect }) {
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
