// @ts-check
// How much is on show, how much is hidden, and acts that are not through yet.

import { html } from "../html.js";
import { isShown } from "../boxfilter.js";
import { countBoxes } from "../calls/boxes.js";
import { isFiltered } from "../grid/filters.js";
import { linkTo } from "../router.js";
import { countOf, countText } from "../wording.js";
import { useValue } from "./hooks.js";
import { Icon } from "./icons.js";

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../router.js").Query} Query */
/** @typedef {import("../grid/pager.js").Pager} Pager */

/** @param {{app: App, pager: Pager, query: Query, inAll: number | null, version: number, selected: number, onUpdate: () => void, onAll: () => void}} props */
export function GridStatus({ app, pager, query, inAll, selected, onUpdate, onAll }) {
  const total = pager.total();
  const report = useValue(app.bulk.report);
  const left = pager.changed().filter((box) => !isShown(box, query)).length;
  const hidden = total !== null && inAll !== null && isFiltered(query) ? Math.max(0, inAll - total) : 0;
  return html`<div class="grid-status">
    <p role="status">
      ${total === null && pager.known() === 0 ? "Loading boxes" : html`<b class="num">${total === null ? `${countText(pager.known())}+` : countText(total)}</b> ${total === 1 ? "box" : "boxes"}`}
      ${hidden > 0 && html`<span class="faint"> · ${countText(hidden)} hidden by the filters</span>`}
    </p>
    ${left > 0 && html`<button class="button button--small" onClick=${onUpdate}>${countOf(left, "box no longer matches", "boxes no longer match")} · update</button>`}
    ${pager.error() && html`<p class="grid-status__error" role="alert"><${Icon} name="warn" />${pager.error()?.message} <button class="button button--small" onClick=${pager.retry}>Try again</button></p>`}
    <span class="grid-status__middle"></span>
    <span class="faint grid-status__hint">${selected ? "" : "Click, drag or Space selects"}</span>
    ${total !== null && total > 0 && html`<button class="button button--small" onClick=${onAll}>Select all ${countText(total)}</button>`}
  </div>
  ${report && html`<${ReportLine} app=${app} report=${report} />`}`;
}

/** What an act or an undo left alone. @param {{app: App, report: import("../bulk_acts.js").Report}} props */
function ReportLine({ app, report }) {
  const shown = report.boxes.slice(0, 12);
  return html`<div class="strip" role="status">
    <${Icon} name="warn" /><p>${report.text} ${shown.map((id) => html`<${BoxLink} app=${app} id=${id} />`)}${report.boxes.length > shown.length && html` and ${countText(report.boxes.length - shown.length)} more`}</p>
    <button class="button button--quiet button--icon" aria-label="Dismiss" onClick=${() => app.bulk.report.set(null)}><${Icon} name="cross" /></button>
  </div>`;
}

/** @param {{app: App, id: number}} props */
function BoxLink({ app, id }) {
  const box = app.stores.find(id);
  if (!box) return html`<span class="strip__box num">${id}</span>`;
  return html`<a class="strip__box" href=${linkTo("frame", { id: box.frame_id }, { box: String(id) })}>${box.class} ${box.id}</a>`;
}

/** @type {Record<string, string>} */
const WILL = { keep: "keep", reject: "reject", unsure: "flag as unsure", clear: "take the answer back from" };

/** @type {Record<string, string>} */
const STATES = { changed: "Not done", waiting: "Not sent yet", refused: "Refused" };

/** Acts that are not stored: nothing is lost, and nothing is hidden. @param {{app: App, dataset: string}} props */
export function OpenActs({ app, dataset }) {
  const open = useValue(app.bulk.open).filter(({ act, state }) => act.dataset === dataset && state !== "sending");
  return open.map(({ act, state, text }) => {
    const what = `${WILL[act.verdict]} ${countOf(act.count, "box", "boxes")}`;
    return html`<div key=${act.key} class="strip strip--error" role="alert">
      <${Icon} name="cloud" />
      <p><b>${STATES[state]}: ${what}.</b> ${sentence(text)}</p>
      ${state === "changed" && html`<button class="button button--small" onClick=${() => void acceptNow(app, act)}>Count again</button>`}
      ${state === "waiting" && html`<button class="button button--small" onClick=${() => app.bulk.retry(act.key)}>Send now</button>`}
      <button class="button button--small button--quiet" onClick=${() => app.bulk.giveUp(act.key)}>Discard</button>
    </div>`;
  });
}

/** @param {string} text */
const sentence = (text) => (text ? `${text[0]?.toUpperCase()}${text.slice(1).replace(/\.$/, "")}.` : "");

/** The number that one agrees to is the one that is shown. @param {App} app @param {import("../bulk.js").Act} act */
async function acceptNow(app, act) {
  try {
    const list = await countBoxes(act.dataset, act.filter ?? {});
    if (list === null) return;
    app.bulk.giveUp(act.key);
    app.bulk.sweeps.set(app.bulk.sweeps.get() + 1);
    app.toasts.show(`${countOf(list.total, "box", "boxes")} by now, ${countText(act.count)} when you looked.`, {
      action: { text: `${WILL[act.verdict]} all ${countText(list.total)}`, run: () => app.bulk.answerAll(act.dataset, act.verdict, act.filter ?? {}, list) },
    });
  } catch (error) {
    app.notice(error);
    app.toasts.show(error instanceof Error ? error.message : String(error), { kind: "error" });
  }
}
