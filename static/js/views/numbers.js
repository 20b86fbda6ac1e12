// @ts-check
// The evidence of a box as a table.

import { html } from "../html.js";
import { countText, metresText, percentText } from "../wording.js";

/** @typedef {import("../types.js").Decision} Decision */

/** @param {Decision} box @returns {readonly (readonly [string, string | null])[]} */
function rowsOf(box) {
  const { xyxy } = box;
  return [
    ["Matched pixels", box.box_pixels ? `${countText(box.matched_pixels ?? 0)} of ${countText(box.box_pixels)}` : null],
    ["Margin", box.margin === null ? null : signed(box.margin)],
    ["Share of the image", percentText(box.area_percent)],
    ["Crowding", box.crowding === null ? null : percentText(box.crowding)],
    ["Distance", box.distance === null ? null : metresText(box.distance)],
    ["Evidence", box.evidence],
    ["Explained by", box.explained_by ? `box ${box.explained_by}` : null],
    ["Rectangle", xyxy ? xyxy.map((value) => Math.round(value * 10) / 10).join(", ") : "outside the image"],
    ["Segmentation", box.lossy ? "lossy" : null],
    ["Run, config", `${box.run}, ${String(box.config ?? "").slice(0, 8)}`],
  ];
}

/** @param {number} percent */
const signed = (percent) => `${percent < 0 ? "−" : "+"}${percentText(Math.abs(percent))}`;

/** @param {{box: Decision}} props */
export function Numbers({ box }) {
  return html`<section class="numbers">
    <h3>Numbers</h3>
    <dl class="facts">
      ${rowsOf(box).map(([name, value]) => value !== null && html`<div><dt>${name}</dt><dd class="num">${value}</dd></div>`)}
    </dl>
  </section>`;
}
