// @ts-check
// The same comparison for each class and each band of distance.

import { html, useState } from "../../html.js";
import { CELLS, answersIn, bandQuery, bandText } from "../../measures.js";
import { linkTo } from "../../router.js";
import { countText } from "../../wording.js";
import { Segments } from "../parts.js";
import { WORDS, boxesOf } from "./truths.js";
import { MeasureCell } from "./whisker.js";

/** @typedef {import("../../types_quality.js").Confusion} Confusion */
/** @typedef {{key: string, text: string, confusion: Confusion, query: Record<string, string> | null}} Group */

const CHOICES = [
  { value: "class", text: "Class" },
  { value: "distance", text: "Distance" },
];

/** @param {{dataset: string, quality: import("../../types_quality.js").Quality}} props */
export function PerGroup({ dataset, quality }) {
  const [by, setBy] = useState("class");
  const groups = (by === "class" ? classGroups(quality) : bandGroups(quality)).filter(({ confusion }) => answersIn(confusion) > 0);
  return html`<section class="panelbox quality__wide" aria-labelledby="groups-title">
    <header class="panelbox__head"><h2 id="groups-title">${by === "class" ? "By class" : "By distance"}</h2>
      <span class="faint">dot: measured; line: 95 % interval; axis from 0 to 100 %</span>
      <span class="panelbox__tools"><${Segments} label="Compare by" value=${by} choices=${CHOICES} onChange=${setBy} /></span></header>
    <div class="tablewrap"><table class="table groups">
      <thead><tr><th scope="col">${by === "class" ? "Class" : "Distance"}</th><th class="is-num" scope="col">${WORDS[quality.truth].column}</th><th scope="col">Precision</th><th scope="col">Recall</th><th scope="col">F1</th><th class="is-num" scope="col">Kept ghosts</th><th class="is-num" scope="col">Lost boxes</th></tr></thead>
      <tbody>${groups.map((group) => html`<${Row} key=${group.key} dataset=${dataset} truth=${quality.truth} group=${group} />`)}</tbody>
    </table></div>
  </section>`;
}

/** @param {import("../../types_quality.js").Quality} quality @returns {Group[]} */
const classGroups = ({ by_class }) => Object.entries(by_class).map(([name, confusion]) => ({ key: name, text: name, confusion, query: { class: name } }));

/** @param {import("../../types_quality.js").Quality} quality @returns {Group[]} */
const bandGroups = ({ by_distance }) => by_distance.map((confusion) => ({ key: confusion.band, text: bandText(confusion.band), confusion, query: bandQuery(confusion.band) }));

/** @param {{dataset: string, truth: import("../../types_quality.js").Truth, group: Group}} props */
function Row({ dataset, truth, group }) {
  const { confusion, text, query } = group;
  /** @type {Record<string, string>} */
  const answered = truth === "people" ? { review: "decided" } : {};
  return html`<tr>
    <th scope="row">${query ? html`<a href=${linkTo("grid", { dataset }, { ...query, ...answered })}>${text}</a>` : text}</th>
    <td class="is-num num">${countText(answersIn(confusion))}</td>
    <td><${MeasureCell} measure=${confusion.precision} name="Precision" /></td>
    <td><${MeasureCell} measure=${confusion.recall} name="Recall" /></td>
    <td><${MeasureCell} measure=${confusion.f1} name="F1" /></td>
    ${CELLS.filter(({ isAgreed }) => !isAgreed).map((about) => {
      const count = countText(confusion[about.cell]);
      const href = confusion[about.cell] > 0 && query ? boxesOf(dataset, truth, about, query) : null;
      return html`<td class="is-num num" key=${about.cell}>${href ? html`<a title=${about.text} href=${href}>${count}</a>` : count}</td>`;
    })}
  </tr>`;
}
