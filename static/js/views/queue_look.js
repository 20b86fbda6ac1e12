// @ts-check
// How to look at the box of the queue: few buttons, each with its key in its name.

import { html } from "../html.js";
import { useValue } from "./hooks.js";
import { Toggle } from "./toolbar.js";

/** @param {{app: import("../app.js").App, frame: import("../types.js").Frame, mode: string, isBlind: boolean, actions: import("../app.js").Actions}} props */
export function QueueLook({ app, frame, mode, isBlind, actions }) {
  const { mask, lit } = useValue(app.prefs);
  return html`<div class="bar bar--look" role="toolbar" aria-label="View">
    ${frame.has_segmentation && html`<${Toggle} app=${app} action="mask" icon="layers" isOn=${mask} run=${actions.mask} />`}
    ${frame.has_segmentation && !isBlind && html`<${Toggle} app=${app} action="lit" icon="light" isOn=${lit} run=${actions.lit} />`}
    <${Toggle} app=${app} action="crop" icon="crop" isOn=${mode === "crop"} run=${actions.crop} />
    <${Toggle} app=${app} action="fit" icon="fit" isOn=${mode === "frame"} run=${actions.fit} />
    <${Toggle} app=${app} action="zoomOut" icon="minus" run=${actions.zoomOut} />
    <${Toggle} app=${app} action="zoomIn" icon="plus" run=${actions.zoomIn} />
  </div>`;
}
