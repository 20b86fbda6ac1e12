// @ts-check
// The two bars over the stage: what to answer, and how to look. Every button shows its key.

import { html } from "../html.js";
import { boundKeys } from "../keymap.js";
import { answerOf } from "../reviews.js";
import { useValue } from "./hooks.js";
import { Icon } from "./icons.js";
import { Keys } from "./parts.js";

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../app.js").Actions} Actions */
/** @typedef {import("../types.js").Decision} Decision */

/** A click with the mouse must not take the keys away from the stage. @param {Event} event */
const keepFocus = (event) => event.preventDefault();

/** @type {readonly {action: string, answer: string, icon: string, text: string}[]} */
const ANSWERS = [
  { action: "keep", answer: "keep", icon: "check", text: "Keep" },
  { action: "reject", answer: "reject", icon: "cross", text: "Reject" },
  { action: "unsure", answer: "unsure", icon: "question", text: "Unsure" },
];

/** @param {{app: App, box: Decision | null, isWaiting: boolean, actions: Actions}} props */
export function AnswerBar({ app, box, isWaiting, actions }) {
  const rows = boundKeys(useValue(app.keys));
  /** @param {string} action */
  const keysOf = (action) => rows.find((row) => row.action === action)?.keys.slice(0, 1) ?? [];
  const given = box ? answerOf(box) : null;
  return html`<div class="bar bar--answer" role="toolbar" aria-label="Answer" onMouseDown=${keepFocus}>
    ${ANSWERS.map(
      ({ action, answer, icon, text }) => html`<button class="answer answer--${answer}" aria-pressed=${given === answer} disabled=${!box} onClick=${actions[action]}>
        <${Icon} name=${icon} /><span>${text}</span><${Keys} app=${app} keys=${keysOf(action)} />
        ${given === answer && html`<span class="answer__state ${isWaiting ? "is-waiting" : ""}" title=${isWaiting ? "not saved yet" : "saved"}></span>`}
      </button>`,
    )}
    <span class="bar__rule" aria-hidden="true"></span>
    <button class="answer answer--undo" onClick=${actions.undo} aria-label="Undo" title="Take back your last answer"><${Icon} name="undo" /><${Keys} app=${app} keys=${keysOf("undo")} /></button>
  </div>`;
}

/** @param {{app: App, frame: import("../types.js").Frame, actions: Actions}} props */
export function LookBar({ app, frame, actions }) {
  const { mask, opacity, lit, edges, blind, crop } = useValue(app.prefs);
  const hasEdges = frame.boxes.some((box) => box.edges?.length);
  /** @param {{currentTarget: HTMLInputElement}} event */
  const setOpacity = ({ currentTarget }) => app.prefs.change({ opacity: Number(currentTarget.value), mask: true });
  return html`<div class="bar bar--look" role="toolbar" aria-label="View">
    ${frame.has_segmentation &&
    html`<${Toggle} app=${app} action="mask" icon="layers" isOn=${mask} run=${actions.mask} />
      <input class="slider" type="range" min="0.1" max="1" step="0.05" value=${opacity} aria-label="Segmentation opacity" onInput=${setOpacity} />
      <${Toggle} app=${app} action="lit" icon="light" isOn=${lit} run=${actions.lit} />`}
    ${hasEdges && html`<${Toggle} app=${app} action="edges" icon="cube" isOn=${edges} run=${actions.edges} />`}
    <${Toggle} app=${app} action="blind" icon="blind" isOn=${blind} run=${actions.blind} />
    <span class="bar__rule" aria-hidden="true"></span>
    <${Toggle} app=${app} action="crop" icon="crop" isOn=${crop} run=${actions.crop} />
    <${Toggle} app=${app} action="fit" icon="fit" run=${actions.fit} />
    <${Toggle} app=${app} action="zoomOut" icon="minus" run=${actions.zoomOut} />
    <${ZoomText} app=${app} />
    <${Toggle} app=${app} action="zoomIn" icon="plus" run=${actions.zoomIn} />
  </div>`;
}

/** @param {{app: App, action: string, icon: string, isOn?: boolean, run: (() => void) | undefined}} props */
export function Toggle({ app, action, icon, isOn, run }) {
  const row = boundKeys(useValue(app.keys)).find((binding) => binding.action === action);
  const title = `${row?.help ?? action}${row?.keys[0] ? ` (${row.keys[0]})` : ""}`;
  return html`<button class="button button--quiet button--icon" aria-pressed=${isOn} aria-label=${row?.help ?? action} title=${title} onMouseDown=${keepFocus} onClick=${run}>
    <${Icon} name=${icon} />
  </button>`;
}

/** @param {{app: App}} props */
function ZoomText({ app }) {
  return html`<output class="zoom num" aria-label="Zoom">${Math.round(useValue(app.zoom) * 100)}%</output>`;
}
