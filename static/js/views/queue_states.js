// @ts-check
// The queue when there is no box to look at, and when two people have looked at one.

import { html } from "../html.js";
import { isFiltered } from "../grid/filters.js";
import { lookedAt, passed } from "../queue/line.js";
import { linkTo } from "../router.js";
import { countOf, countText } from "../wording.js";
import { useValue } from "./hooks.js";
import { Icon } from "./icons.js";
import { Notice } from "./parts.js";

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../router.js").Query} Query */
/** @typedef {import("../queue/sitting.js").Sitting} Sitting */

export const Fetching = () => html`<div class="queue__message" aria-busy="true"><div class="queue__wait shimmer"></div><p class="sr-only" role="status">Loading the next boxes</p></div>`;

/** @param {{app: App, sitting: Sitting, query: Query, actions: import("../queue/actions.js").QueueActions, onAll: () => void}} props */
export function AllDone({ app, sitting, query, actions, onAll }) {
  const { verdicts } = useValue(sitting.tally);
  const { elsewhere } = useValue(sitting.counts);
  const { waiting } = useValue(app.saver.state);
  const open = passed(useValue(sitting.line)).length;
  const { dataset, order } = sitting;
  const title = verdicts.size ? "All done" : order === "audit" ? "Nothing to audit" : "Nothing to review";
  return html`<div class="queue__message">
    <${Notice} icon="check" title=${title} actions=${html`<${Ways} dataset=${dataset} order=${order} query=${query} open=${open} elsewhere=${elsewhere} sitting=${sitting} actions=${actions} onAll=${onAll} />`}>
      <p>${doneText(verdicts) || (order === "audit" ? "Nobody has answered a box of these filters yet." : "Every box of these filters has an answer.")}</p>
      ${waiting.size > 0 && html`<p>${countOf(waiting.size, "answer is", "answers are")} kept in this browser and will be sent.</p>`}
      ${open > 0 && html`<p>You passed over ${countOf(open, "box", "boxes")}.</p>`}
      ${elsewhere > 0 && html`<p>${countOf(elsewhere, "box is", "boxes are")} with somebody else at the moment.</p>`}
    <//>
  </div>`;
}

export const NoBoxesYet = () => html`<div class="queue__message"><${Notice} icon="grid" title="No boxes yet"><p>Nothing has been pushed to this dataset.</p><//></div>`;

/** What one can do now. @param {{dataset: string, order: string, query: Query, open: number, elsewhere: number, sitting: Sitting, actions: import("../queue/actions.js").QueueActions, onAll: () => void}} props */
function Ways({ dataset, order, query, open, elsewhere, sitting, actions, onAll }) {
  return html`${open > 0 && html`<button class="button button--primary" onClick=${actions.again}>Go through ${open === 1 ? "it" : "them"}</button>`}
    ${elsewhere > 0 && html`<button class="button" onClick=${sitting.lookAgain}>Look again</button>`}
    ${(isFiltered(query) || sitting.listed.length > 0) && html`<button class="button" onClick=${onAll}>${sitting.listed.length > 0 ? "The whole queue" : "Without the filters"}</button>`}
    ${order !== "audit" && html`<a class="button" href=${linkTo("queue", { dataset }, { order: "audit" })}>Audit the answers</a>`}
    <a class="button" href=${linkTo("grid", { dataset })}>Grid</a>
    <a class="button" href=${linkTo("frames", { dataset })}>Frames</a>`;
}

/** @param {ReadonlyMap<number, string>} verdicts */
function doneText(verdicts) {
  if (verdicts.size === 0) return "";
  const of = (/** @type {string} */ verdict) => [...verdicts.values()].filter((given) => given === verdict).length;
  const parts = [`${countText(of("keep"))} kept`, `${countText(of("reject"))} rejected`, ...(of("unsure") ? [`${countText(of("unsure"))} unsure`] : [])];
  return `You answered ${countOf(verdicts.size, "box", "boxes")}: ${parts.join(", ")}.`;
}

/** Somebody was first: their answer stands, and one goes on where one is. @param {{app: App, sitting: Sitting, onShow: (line: import("../queue/line.js").Line) => void}} props */
export function Conflicts({ app, sitting, onShow }) {
  const conflicts = [...useValue(app.conflicts).values()].flatMap((item) => {
    const box = sitting.store.get(item.boxId);
    return box ? [{ item, box }] : [];
  });
  if (conflicts.length === 0) return null;
  return html`<div class="queue__conflicts">
    ${conflicts.map(({ item, box }) => {
      const { reviewer = "", verdict = "clear" } = box.review ?? {};
      const theirs = verdict === "clear" ? "took the answer back" : `answered ${verdict}`;
      return html`<section key=${box.box_id} class="conflict" role="alert">
        <p><${Icon} name="warn" /> ${box.class} ${box.id}: <b>${reviewer || "somebody else"} ${theirs}</b> while you answered ${item.verdict}. Yours is not stored.</p>
        <div class="conflict__actions">
          <button class="button button--small" onClick=${() => app.settle(box.box_id)}>Leave it</button>
          <button class="button button--small" onClick=${() => app.insist(box, item)}>Use mine: ${item.verdict}</button>
          <button class="button button--small button--quiet" onClick=${() => onShow(lookedAt(sitting.line.get(), box.box_id))}>Look at it</button>
        </div>
      </section>`;
    })}
  </div>`;
}
