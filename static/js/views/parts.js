// @ts-check
// Small pieces that several views use.

import { html, useState } from "../html.js";
import { shownKey } from "../keymap.js";
import { linkTo } from "../router.js";
import { countOf, countText } from "../wording.js";
import { useValue } from "./hooks.js";
import { Icon } from "./icons.js";

/** @typedef {import("../types.js").FrameCounts} FrameCounts */

/** @param {{verdict: string}} props */
export function VerdictBadge({ verdict }) {
  const icon = { kept: "check", rejected: "cross", veiled: "blind" }[verdict] ?? "question";
  return html`<span class="badge badge--${verdict}"><${Icon} name=${icon} />${verdict === "veiled" ? "hidden" : verdict}</span>`;
}

/** The swatch draws the stroke that the stage draws: solid, dashed, dotted. @param {{verdict: string}} props */
export const StrokeSwatch = ({ verdict }) => html`<span class="stroke stroke--${verdict}" aria-hidden="true"></span>`;

/** Kept, rejected and unmeasured as one bar, with the numbers for whoever cannot see it. @param {{counts: FrameCounts}} props */
export function VerdictBar({ counts }) {
  const { boxes, kept, rejected, unmeasured } = counts;
  const text = `${countText(kept)} kept, ${countText(rejected)} rejected, ${countText(unmeasured)} unmeasured`;
  /** @param {number} n */
  const share = (n) => ({ flexGrow: String(n) });
  return html`<div class="vbar" role="img" aria-label=${boxes ? text : "no boxes"}>
    ${kept > 0 && html`<span class="vbar__kept" style=${share(kept)} />`}
    ${rejected > 0 && html`<span class="vbar__rejected" style=${share(rejected)} />`}
    ${unmeasured > 0 && html`<span class="vbar__unmeasured" style=${share(unmeasured)} />`}
  </div>`;
}

/** How far people have come. @param {{counts: FrameCounts}} props */
export function ReviewProgress({ counts }) {
  const all = counts.reviewed + counts.to_review;
  const percent = all ? Math.floor((100 * counts.reviewed) / all) : counts.boxes ? 100 : 0;
  const left = counts.to_review ? `${countText(counts.to_review)} to review` : "nothing to review";
  return html`<div class="progress">
    <div class="progress__text">
      <span>${countOf(counts.reviewed, "answer")}</span><span>${left}</span>
    </div>
    <div class="progress__track" role="progressbar" aria-label="reviewed" aria-valuemin="0" aria-valuemax="100" aria-valuenow=${percent}>
      <span class="progress__fill" style=${{ width: `${percent}%` }} />
    </div>
  </div>`;
}

/** The keys of an action, as they are bound now. @param {{app: import("../app.js").App, keys: readonly string[]}} props */
export function Keys({ app, keys }) {
  const { off } = useValue(app.keys);
  return html`<span class="keys" aria-hidden="true">
    ${keys.map((key) => html`<kbd class=${off && [...key].length === 1 ? "is-off" : ""}>${shownKey(key)}</kbd>`)}
  </span>`;
}

/** @param {{title: string, children?: unknown, icon?: string, actions?: unknown}} props */
export function Notice({ title, children, icon = "image", actions }) {
  return html`<section class="notice">
    <div class="notice__icon"><${Icon} name=${icon} /></div>
    <h2 class="notice__title">${title}</h2>
    <div class="notice__text">${children}</div>
    ${actions && html`<div class="notice__actions">${actions}</div>`}
  </section>`;
}

/** What went wrong, in the server's words, and a way on. @param {{error: Error, onRetry: () => void}} props */
export function Failure({ error, onRetry }) {
  const { problem, status } = /** @type {{problem?: {title?: string, request_id?: string}, status?: number}} */ (error);
  return html`<${Notice} icon="warn" title=${problem?.title ?? "This could not be loaded"}
    actions=${html`${status === 404 && html`<a class="button button--primary" href=${linkTo("datasets")}>All datasets</a>`}<button class="button" onClick=${onRetry}>Try again</button>`}>
    <p role="alert">${error.message}</p>
    ${problem?.request_id && html`<p class="faint">Request ${problem.request_id}</p>`}
  <//>`;
}

/** A name that may break behind its dots and underscores, and nowhere else. @param {{text: string}} props */
export const Words = ({ text }) => text.split(/(?<=[._])/).map((part, i) => (i ? html`<wbr />${part}` : part));

/** A command to copy. @param {{text: string}} props */
export function Command({ text }) {
  const [isCopied, setCopied] = useState(false);
  const copy = async () => {
    await navigator.clipboard?.writeText(text);
    setCopied(true);
    setTimeout(() => setCopied(false), 1500);
  };
  return html`<div class="command">
    <code>${text}</code>
    <button class="button button--quiet button--icon" onClick=${copy} aria-label=${`Copy: ${text}`} title="Copy">
      <${Icon} name=${isCopied ? "check" : "copy"} />
    </button>
    <span class="sr-only" role="status">${isCopied ? "Copied" : ""}</span>
  </div>`;
}

/** A choice among few. @param {{label: string, value: string, choices: readonly {value: string, text: string}[], onChange: (value: string) => void}} props */
export function Segments({ label, value, choices, onChange }) {
  return html`<div class="segments" role="group" aria-label=${label}>
    ${choices.map(
      (choice) => html`<button class="segments__item" aria-pressed=${choice.value === value} onClick=${() => onChange(choice.value)}>
        ${choice.text}
      </button>`,
    )}
  </div>`;
}

/** @param {{label: string, value: string, choices: readonly {value: string, text: string}[], any: string, onChange: (value: string) => void}} props */
export function Select({ label, value, choices, any, onChange }) {
  const known = value === "" || choices.some((choice) => choice.value === value);
  return html`<span class="select ${value ? "is-set" : ""}">
    <select aria-label=${label} value=${value} onChange=${(/** @type {{currentTarget: HTMLSelectElement}} */ event) => onChange(event.currentTarget.value)}>
      <option value="">${any}</option>
      ${choices.map((choice) => html`<option value=${choice.value}>${choice.text}</option>`)}
      ${!known && html`<option value=${value}>${value}</option>`}
    </select>
  </span>`;
}
