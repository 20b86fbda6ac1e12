// @ts-check
// What one has just answered and what comes next, as small crops beside the stage.

import { html, useEffect, useRef } from "../html.js";
import { veiled } from "../blind.js";
import { ahead, currentOf, lookedAt } from "../queue/line.js";
import { spokenText } from "../wording.js";
import { AnswerSign } from "./boxlist.js";
import { Picture } from "./grid_row.js";
import { useValue } from "./hooks.js";

/** @typedef {import("../queue/line.js").Line} Line */

const BEHIND = 3;
const AHEAD = 6;
const SIZE_PX = 56;

/** @param {{app: import("../app.js").App, sitting: import("../queue/sitting.js").Sitting, line: Line, isHidden: boolean, onShow: (line: Line) => void}} props */
export function QueueStrip({ app, sitting, line, isHidden, onShow }) {
  const { waiting } = useValue(app.saver.state);
  const list = useRef(/** @type {HTMLOListElement | null} */ (null));
  const { verdicts } = useValue(sitting.tally);
  const here = currentOf(line);
  useEffect(() => list.current?.querySelector("[aria-current]")?.scrollIntoView({ block: "nearest", inline: "nearest" }), [here]);
  const ids = [...line.ids.slice(Math.max(0, line.at - BEHIND), line.at), ...(here === null ? [] : [here]), ...ahead(line, AHEAD)];
  const boxes = ids.flatMap((id) => sitting.store.get(id) ?? []);
  return html`<ol class="strip-list" ref=${list} aria-label="Boxes before and after">
    ${boxes.map((box) => {
      const isCovered = isHidden && !verdicts.has(box.box_id);
      return html`<li key=${box.box_id}>
        <button class="strip-list__box ${isCovered ? "is-covered" : ""}" aria-current=${box.box_id === here ? "true" : undefined} aria-label=${isCovered ? `${box.class} ${box.id}` : spokenText(box)}
          title=${`${box.class} ${box.id}`} onClick=${() => onShow(lookedAt(line, box.box_id))}>
          <${Picture} app=${app} box=${isCovered ? veiled(box) : box} size=${SIZE_PX} frameSize=${null} />
          ${!isCovered && html`<span class="cell__answer"><${AnswerSign} box=${box} isWaiting=${waiting.has(box.box_id)} /></span>`}
        </button>
      </li>`;
    })}
  </ol>`;
}
