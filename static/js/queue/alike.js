// @ts-check
// The boxes like the one that was answered last, to be given the same answer at once.

import { NearBox } from "../boxes/crops.js";
import { distanceText } from "../boxes/wording.js";
import { get } from "../core/api.js";
import { useLoaded } from "../core/hooks.js";
import { html, useState } from "../core/html.js";
import { actionOf } from "../core/keymap.js";
import { capital, countOf, countText } from "../core/numbers.js";
import { Dialog, Failure, useDialog } from "../core/parts.js";
import { VERBS } from "../review/bulk.js";

/** @import { Answer } from "../boxes/box.js" */
/** @import { ReviewApp as App } from "../review/answers.js" */
/** @import { Session } from "./session.js" */

const SIZE_PX = 112;

/** @param {{app: App, session: Session, answered: {boxId: number, verdict: Answer}, onClose: () => void}} props */
export function AlikeDialog({ app, session, answered: { boxId, verdict }, onClose }) {
  const dialog = useDialog();
  const loaded = useLoaded(
    (signal) => get("/api/v1/boxes/{box_id}/alike", { path: { box_id: boxId }, signal }),
    [boxId],
  );
  const [chosen, setChosen] = useState(/** @type {ReadonlySet<number> | null} */ (null));
  const { items = [], total = 0, probable = 0 } = loaded.value ?? {};
  const selected = chosen ?? new Set(items.slice(0, probable).map(({ box_id }) => box_id));
  const box = app.boxes.get(boxId);
  const name = box ? `${box.class} ${box.id}` : "this";

  /** @param {number} id */
  const toggle = (id) => {
    const next = new Set(selected);
    if (!next.delete(id)) next.add(id);
    setChosen(next);
  };

  function give() {
    const boxes = items.filter(({ box_id }) => selected.has(box_id));
    if (boxes.length > 0 && session.answerMany(boxes, verdict)) dialog.close();
  }

  /** The key of the answer, the key that opened this, and Enter give the answer. @param {KeyboardEvent} event */
  const onKeyDown = (event) => {
    const action = actionOf(event, app.keys.get(), "queue");
    const isOnButton = event.target instanceof Element && event.target.closest("button") !== null;
    const isGiven =
      event.key === "Enter" ? !isOnButton : action === "alike" || (action === verdict && event.key !== " ");
    if (!isGiven || event.repeat) return;
    event.preventDefault();
    give();
  };

  const words =
    total === 0
      ? "No others"
      : html`<b class="num">${countOf(total, "other")}</b>, <b
        class="num">${countText(probable)}</b> probably the same`;
  return html`<${Dialog} dialog=${dialog} id="alike-title" title=${`All like ${name}`} kind="wide" isLight=${true}
    onClose=${onClose} onKeyDown=${onKeyDown}>
    ${loaded.state === "error" && html`<${Failure} error=${loaded.error} onRetry=${loaded.reload} />`}
    ${loaded.state === "loading" && html`<div class="skeleton skeleton--tall shimmer"></div>`}
    ${
      loaded.state === "ready" &&
      html`<p role="status">${words}${items.length < total && `; shown are ${countText(items.length)}`}</p>
      ${
        total > 0 &&
        html`<${Choice} items=${items} selected=${selected}
          text=${`${capital(VERBS[verdict])} ${countOf(selected.size, "box", "boxes")}`} onToggle=${toggle}
          onChoose=${setChosen} onGive=${give} />`
      }`
    }
  <//>`;
}

/**
 * @param {{items: readonly import("../boxes/box.js").Decision[], selected: ReadonlySet<number>, text: string, onToggle:
 *   (id: number) => void, onChoose: (ids: ReadonlySet<number>) => void, onGive: () => void}} props
 */
function Choice({ items, selected, text, onToggle, onChoose, onGive }) {
  return html`<p
    class="faint">Without an answer, of the same class, cause, hider and distance band. Click on those that differ.</p>
  <ul class="alike" aria-label="Boxes like it">
    ${items.map(
      (one) => html`<li key=${one.box_id}>
        <button class="alike__box" aria-pressed=${selected.has(one.box_id)} title=${one.frame}
          onClick=${() => onToggle(one.box_id)}>
          <${NearBox} box=${one} size=${SIZE_PX} />
          <span class="alike__name"><span class="sr-only">${one.class}${" "}</span>
            ${one.id} <span class="faint num">${distanceText(one) ?? ""}</span></span>
        </button></li>`,
    )}
  </ul>
  <footer class="dialog__foot">
    <span>
      <button class="button button--quiet"
        onClick=${() => onChoose(new Set(items.map(({ box_id }) => box_id)))}>All</button>
      <button class="button button--quiet" onClick=${() => onChoose(new Set())}>None</button></span>
    <button class="button button--primary alike__give" disabled=${selected.size === 0}
      onClick=${onGive}>${text}</button>
  </footer>`;
}
