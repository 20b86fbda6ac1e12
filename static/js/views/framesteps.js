// @ts-check
// To the frame before and after, in the order of their keys.

import { html } from "../html.js";
import { linkTo } from "../router.js";
import { Icon } from "./icons.js";

/** @param {{frame: import("../types.js").Frame, query: import("../router.js").Query}} props */
export function FrameSteps({ frame, query }) {
  return html`<div class="framesteps" role="group" aria-label="Frames">
    <${Step} id=${frame.previous_id} query=${query} icon="left" text="Previous frame" />
    <${Step} id=${frame.next_id} query=${query} icon="right" text="Next frame" />
  </div>`;
}

/** @param {{id: number | null, query: import("../router.js").Query, icon: string, text: string}} props */
function Step({ id, query, icon, text }) {
  if (id === null) return html`<span class="button button--quiet button--icon is-disabled" aria-hidden="true"><${Icon} name=${icon} /></span>`;
  return html`<a class="button button--quiet button--icon" href=${linkTo("frame", { id }, { ...query, box: "" })} aria-label=${text} title=${text}><${Icon} name=${icon} /></a>`;
}
