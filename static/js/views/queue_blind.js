// @ts-check
// Beside a box that one judges blindly: nothing that would tell.

import { html } from "../html.js";
import { metresText } from "../wording.js";
import { useValue } from "./hooks.js";
import { Icon } from "./icons.js";

/** @param {{box: import("../types.js").Decision, sitting: import("../queue/sitting.js").Sitting, onSee: () => void}} props */
export function BlindPanel({ box, sitting, onSee }) {
  const last = useValue(sitting.comparisons).at(-1);
  return html`<aside class="panel panel--inspector" aria-label="Selected box">
    <header class="inspector__head"><h2>${box.class} <span class="faint">${box.id}</span></h2></header>
    <p class="inspector__sentence">Is there a ${box.class.replaceAll("_", " ")} to be seen in the box? The filter's verdict and earlier answers are hidden until you have answered.</p>
    ${last && html`<p class="agreement agreement--${last.agrees ? "yes" : "no"}" role="status"><${Icon} name=${last.agrees ? "check" : "warn"} /><span>${last.words}</span></p>`}
    <dl class="facts">
      <div><dt>Frame</dt><dd>${box.frame}</dd></div>
      ${box.distance !== null && html`<div><dt>Distance</dt><dd class="num">${metresText(box.distance)}</dd></div>`}
    </dl>
    <button class="button" onClick=${onSee}>Show verdicts</button>
  </aside>`;
}
