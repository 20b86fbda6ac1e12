// @ts-check
// A comment travels with an answer; on an undecided box it flags the box as unsure.

import { html, useState } from "../html.js";
import { answerOf } from "../reviews.js";

/** @typedef {import("../types.js").Decision} Decision */

/** @param {{box: Decision, onSave: (text: string) => void, fieldRef: {current: HTMLTextAreaElement | null}}} props */
export function Comment({ box, onSave, fieldRef }) {
  const stored = box.review?.comment ?? "";
  const [text, setText] = useState(/** @type {string | null} */ (null));
  const shown = text ?? stored;
  const save = () => {
    if (shown.trim() !== stored) onSave(shown.trim());
    setText(null);
    fieldRef.current?.blur();
  };
  /** @param {KeyboardEvent} event */
  const onKeyDown = (event) => {
    if (event.key === "Enter" && !event.shiftKey) {
      event.preventDefault();
      save();
    } else if (event.key === "Escape") {
      event.stopPropagation();
      setText(null);
      fieldRef.current?.blur();
    }
  };
  const hint = answerOf(box) ? "Enter saves, Esc leaves it" : "Enter saves and flags the box as unsure";
  return html`<div class="comment">
    <label class="field">
      <span>Comment</span>
      <textarea ref=${fieldRef} rows="2" maxlength="2000" value=${shown} placeholder="Why?" onKeyDown=${onKeyDown}
        onInput=${(/** @type {{currentTarget: HTMLTextAreaElement}} */ event) => setText(event.currentTarget.value)}></textarea>
    </label>
    ${text !== null && text !== stored && html`<div class="comment__foot"><span class="faint">${hint}</span><button class="button button--small" onClick=${save}>Save</button></div>`}
  </div>`;
}
