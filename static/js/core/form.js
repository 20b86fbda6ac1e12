// @ts-check
// A form out of the description that the API gives of itself: export options, configuration keys, dataset settings.

import { html, useState } from "./html.js";
import { splitText } from "./numbers.js";

/** @typedef {{value: string, text: string, help: string}} Choice */
/** @typedef {{key: string, kind: "choice" | "switch" | "number" | "numbers", text: string, help: string, initial: unknown, choices: Choice[], min?: number, max?: number}} Field */
/** @typedef {{formats: Choice[], fields: Field[]}} ExportForm */
/** @typedef {Record<string, any>} Schema */

/** @param {Schema} schema @returns {string[]} */
export const valuesOf = (schema) => schema.enum ?? (schema.const === undefined ? [] : [schema.const]);

/** @typedef {{fields: Record<string, string>, choices: Record<string, Record<string, string>>}} Words  for people, where there are better ones than the keys and values */

/** @param {string} key @param {Schema} schema @param {Words} known @returns {Field | null} null: nothing that the page could ask for */
export function fieldOf(key, schema, known) {
  const words = { key, text: known.fields[key] ?? key.replaceAll("_", " "), help: schema.description ?? "", initial: schema.default };
  const values = valuesOf(schema);
  if (values.length > 0) {
    return { ...words, kind: "choice", choices: values.map((value) => ({ value, text: known.choices[key]?.[value] ?? value, help: "" })) };
  }
  const limits = { min: schema.minimum, max: schema.maximum, choices: [] };
  if (schema.type === "boolean") return { ...words, ...limits, kind: "switch" };
  if (schema.type === "number" || schema.type === "integer") return { ...words, ...limits, kind: "number" };
  const isNumbers = schema.type === "array" && ["number", "integer"].includes(schema.items?.type);
  return isNumbers ? { ...words, ...limits, kind: "numbers" } : null;
}

/** What is sent: every option as it stands. @param {readonly Field[]} fields @param {Record<string, unknown>} chosen */
export const optionsOf = (fields, chosen) => Object.fromEntries(fields.map(({ key, initial }) => [key, key in chosen ? chosen[key] : initial]));

/** "50, 100" as numbers; null when it is something else. @param {string} text */
export function parseNumbers(text) {
  const parts = text.split(/[\s,;]+/).filter(Boolean);
  const numbers = parts.map(Number);
  return numbers.every((number) => Number.isFinite(number)) ? numbers : null;
}

/** @param {{field: Field, value: unknown, onChange: (value: unknown) => void}} props */
export function AskField({ field, value, onChange }) {
  const { kind, text, help, choices } = field;
  if (kind === "switch") {
    return html`<label class="switch" title=${help}><input type="checkbox" checked=${value === true} onChange=${(/** @type {{currentTarget: HTMLInputElement}} */ event) => onChange(event.currentTarget.checked)} /><span>${text}</span></label>`;
  }
  if (kind === "choice") {
    return html`<label class="ask__row" title=${help}><span>${text}</span><span class="select"><select value=${String(value)} onChange=${(/** @type {{currentTarget: HTMLSelectElement}} */ event) => onChange(event.currentTarget.value)}>
      ${choices.map((choice) => html`<option value=${choice.value}>${choice.text}</option>`)}
    </select></span></label>`;
  }
  return kind === "numbers" ? html`<${Numbers} field=${field} value=${value} onChange=${onChange} />` : html`<${Share} field=${field} value=${Number(value)} onChange=${onChange} />`;
}

/** @param {{field: Field, value: number, onChange: (value: unknown) => void}} props */
function Share({ field, value, onChange }) {
  const { key, text, help, min, max } = field;
  const isShare = key === "split";
  return html`<label class="ask__row" title=${help}><span>${text}</span>
    <span class="ask__number"><input type=${isShare ? "range" : "number"} class=${isShare ? "slider" : "num"} min=${min} max=${max} step=${isShare ? 0.05 : "any"} value=${value} onInput=${(/** @type {{currentTarget: HTMLInputElement}} */ event) => onChange(Number(event.currentTarget.value))} />
      ${isShare && html`<output class="num">${value >= 1 ? "no split" : splitText(value)}</output>`}</span></label>`;
}

/** @param {{field: Field, value: unknown, onChange: (value: unknown) => void}} props */
function Numbers({ field, value, onChange }) {
  const [text, setText] = useState(Array.isArray(value) ? value.join(", ") : "");
  /** @param {{currentTarget: HTMLInputElement}} event */
  const onInput = ({ currentTarget }) => {
    setText(currentTarget.value);
    const numbers = parseNumbers(currentTarget.value);
    if (numbers) onChange(numbers);
  };
  return html`<label class="ask__row" title=${field.help}><span>${field.text}</span>
    <span class="search"><input class="num" type="text" inputmode="numeric" value=${text} placeholder="none, or 50, 100, 200" aria-invalid=${parseNumbers(text) === null} onInput=${onInput} /></span></label>`;
}
