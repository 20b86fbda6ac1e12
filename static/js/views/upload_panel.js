// @ts-check
// How far an upload is, in the corner, whatever view is on.

import { html } from "../html.js";
import { linkTo } from "../router.js";
import { doneOf, isOver } from "../upload/sender.js";
import { countOf, countText } from "../wording.js";
import { useValue } from "./hooks.js";
import { Icon } from "./icons.js";
import { FileList } from "./upload_parts.js";

/** @typedef {import("../upload/sender.js").Progress} Progress */

/** @type {Record<import("../upload/sender.js").Phase, string>} */
const PHASES = {
  sending: "Uploading",
  paused: "Paused",
  offline: "The server does not answer; trying again",
  busy: "The server is busy; trying again",
  "signed-out": "Signed out; sign in to go on",
  done: "Uploaded",
  stopped: "Stopped",
};

/** @param {{app: import("../app.js").App, job: import("../upload/uploads.js").Job}} props */
export function UploadPanel({ app, job: { dataset, sender } }) {
  const progress = useValue(sender.state);
  const { phase, total, refused, trouble } = progress;
  const done = doneOf(progress);
  const percent = total ? Math.floor((100 * done) / total) : 100;
  const isEnd = isOver(phase);
  return html`<section class="upload-panel" aria-label="Upload">
    <header class="upload-panel__head">
      <h2>${PHASES[phase]} <span class="faint">${dataset}</span></h2>
      ${isEnd && html`<button class="button button--quiet button--icon" aria-label="Close the upload" onClick=${app.uploads.dismiss}><${Icon} name="cross" /></button>`}
    </header>
    <div class="progress__track" role="progressbar" aria-label="Frames uploaded" aria-valuemin="0" aria-valuemax=${total} aria-valuenow=${done}>
      <span class="progress__fill ${refused.length ? "has-refused" : ""}" style=${{ width: `${percent}%` }} />
    </div>
    <p class="upload-panel__text" role="status">${isEnd ? outcome(progress) : `${countText(done)} of ${countOf(total, "frame")}`}</p>
    ${trouble && html`<p class="upload__fault" role="alert">${trouble}</p>`}
    <${FileList} title="Refused" items=${refused.map(({ key, why, more }) => ({ name: key, why, more }))} isOpen=${isEnd} />
    <footer class="upload-panel__foot">
      ${!isEnd && html`<button class="button" onClick=${sender.cancel}>Cancel</button>`}
      ${phase === "sending" && html`<button class="button" onClick=${sender.pause}>Pause</button>`}
      ${!isEnd && phase !== "sending" && html`<button class="button button--primary" onClick=${sender.resume}>Go on</button>`}
      ${phase === "done" && refused.length > 0 && html`<button class="button" onClick=${sender.retry}>Try the refused again</button>`}
      ${isEnd && done > refused.length && html`<a class="button button--primary" href=${linkTo("frames", { dataset })} onClick=${app.uploads.dismiss}>Open the frames</a>`}
    </footer>
  </section>`;
}

/** @param {Progress} progress */
function outcome({ stored, same, refused }) {
  const parts = [`${countOf(stored, "frame")} stored`];
  if (same) parts.push(`${countText(same)} there already`);
  if (refused.length) parts.push(`${countText(refused.length)} refused`);
  return parts.join(" · ");
}
