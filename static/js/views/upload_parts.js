// @ts-check
// Tables and lists of the upload: what goes, and what does not.

import { html } from "../html.js";
import { baseOf } from "../upload/matching.js";
import { countText } from "../wording.js";

const MOST_ROWS = 4;
const MOST_LISTED = 200;

/** The first frames, as they will be sent. @param {{plan: import("../upload/layouts.js").Plan}} props */
export function PlanTable({ plan }) {
  const rest = plan.frames.length - MOST_ROWS;
  return html`<div class="upload__table"><table>
    <thead><tr><th scope="col">Frame</th><th scope="col">Image</th><th scope="col">Segmentation</th><th scope="col" class="is-number">Boxes</th></tr></thead>
    <tbody>
      ${plan.frames.slice(0, MOST_ROWS).map(
        ({ key, files, annotation }) => html`<tr key=${key}>
          <td title=${key}>${key}</td><${Cell} entry=${files.image} /><${Cell} entry=${files.segmentation} />
          <td class="is-number">${/** @type {unknown[]} */ (annotation.boxes)?.length ?? 0}</td>
        </tr>`,
      )}
      ${rest > 0 && html`<tr><td class="faint" colspan="4">and ${countText(rest)} more</td></tr>`}
    </tbody>
  </table></div>`;
}

/** @param {{entry: import("../upload/matching.js").Entry | undefined}} props */
const Cell = ({ entry }) => (entry ? html`<td title=${entry.path}>${baseOf(entry.path)}</td>` : html`<td class="faint">none</td>`);

/** @param {{title: string, items: readonly {name: string, why: string, more?: readonly string[]}[], isOpen?: boolean}} props */
export function FileList({ title, items, isOpen = false }) {
  if (items.length === 0) return null;
  return html`<details class="filelist" open=${isOpen}>
    <summary>${title} <span class="num">${countText(items.length)}</span></summary>
    <ul tabindex="0" aria-label=${title}>
      ${items.slice(0, MOST_LISTED).map(
        ({ name, why, more = [] }) => html`<li><b>${name}</b> <span>${why}</span>${more.length > 0 && html`<ul>${more.map((line) => html`<li>${line}</li>`)}</ul>`}</li>`,
      )}
      ${items.length > MOST_LISTED && html`<li class="faint">and ${countText(items.length - MOST_LISTED)} more</li>`}
    </ul>
  </details>`;
}
