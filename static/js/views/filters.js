// @ts-check
// The filters above a list of frames. They only write the address.

import { html } from "../html.js";
import { FILTER_KEYS, REVIEW_CHOICES } from "../boxfilter.js";
import { REASONS } from "../wording.js";
import { useTyped } from "./hooks.js";
import { Icon } from "./icons.js";
import { Segments, Select } from "./parts.js";

/** @typedef {import("../router.js").Query} Query */

export const VERDICT_CHOICES = [
  { value: "", text: "All" },
  { value: "kept", text: "Kept" },
  { value: "rejected", text: "Rejected" },
  { value: "unmeasured", text: "Unmeasured" },
];

const REASON_CHOICES = Object.entries(REASONS).map(([value, text]) => ({ value, text }));
const TYPING_PAUSE_MS = 250;

/** @param {{classes: readonly string[], query: Query, onChange: (query: Query) => void}} props */
export function FrameFilters({ classes, query, onChange }) {
  /** @param {string} key */
  const set = (key) => (/** @type {string} */ value) => onChange({ ...query, [key]: value });
  const isSet = [...FILTER_KEYS, "key"].some((key) => query[key]);
  return html`<div class="filters" role="search" aria-label="Filter frames">
    <${Segments} label="Verdict" value=${query.verdict ?? ""} choices=${VERDICT_CHOICES} onChange=${set("verdict")} />
    <${Select} label="Reason" any="Any reason" value=${query.reason ?? ""} choices=${REASON_CHOICES} onChange=${set("reason")} />
    <${Select} label="Class" any="Any class" value=${query.class ?? ""} choices=${classes.map((name) => ({ value: name, text: name }))} onChange=${set("class")} />
    <${Select} label="Review" any="Answered or not" value=${query.review ?? ""} choices=${REVIEW_CHOICES} onChange=${set("review")} />
    <${KeyPrefix} value=${query.key ?? ""} onChange=${set("key")} />
    ${isSet && html`<button class="button button--quiet" onClick=${() => onChange({})}><${Icon} name="cross" />Clear</button>`}
  </div>`;
}

/** @param {{value: string, onChange: (value: string) => void}} props */
function KeyPrefix({ value, onChange }) {
  const { shown, onInput } = useTyped(value, onChange, TYPING_PAUSE_MS);
  return html`<label class="search"><span class="sr-only">Key starts with</span>
    <input type="search" value=${shown} placeholder="Key starts with…" spellcheck=${false} onInput=${onInput} />
  </label>`;
}
