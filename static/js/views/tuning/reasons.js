// @ts-check
// Why boxes are rejected, now and with what is being tried.

import { html } from "../../html.js";
import { countText, reasonText } from "../../wording.js";
import { Delta } from "./summary.js";

/** @param {{tuning: import("./state.js").Tuning, selected: string}} props */
export function Reasons({ tuning, selected }) {
  /** @param {import("../../types_jobs.js").Preview | null} preview @returns {Record<string, number>} */
  const of = (preview) => (selected ? preview?.reasons_by_class?.[selected] : preview?.by_reason) ?? {};
  const before = of(tuning.baseline);
  const after = of(tuning.preview);
  const most = Math.max(1, ...Object.values(after), ...Object.values(before));
  const reasons = Object.keys({ ...before, ...after }).sort((a, b) => (before[b] ?? 0) - (before[a] ?? 0));
  return html`<section class="panelbox" aria-labelledby="reasons-title">
    <header class="panelbox__head"><h2 id="reasons-title">Reasons${selected ? `: ${selected}` : ""}</h2></header>
    <div class="tablewrap"><table class="table">
      <thead><tr><th scope="col">Reason</th><th class="is-num" scope="col">Now</th><th class="is-num" scope="col">Tried</th><th class="is-num" scope="col">Change</th><th class="table__bar" aria-hidden="true"></th></tr></thead>
      <tbody>
        ${reasons.map(
          (reason) => html`<tr key=${reason}>
            <th scope="row">${reasonText(reason)}</th>
            <td class="is-num num">${countText(before[reason] ?? 0)}</td>
            <td class="is-num num">${countText(after[reason] ?? 0)}</td>
            <td class="is-num"><${Delta} count=${after[reason] ?? 0} before=${before[reason] ?? 0} /></td>
            <td class="table__bar" aria-hidden="true"><span class="meter meter--${reason === "visible" ? "kept" : "rejected"}"><i style=${{ width: `${(100 * (after[reason] ?? 0)) / most}%` }}></i></span></td>
          </tr>`,
        )}
      </tbody>
    </table></div>
  </section>`;
}
