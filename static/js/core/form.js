// @ts-check
// Forms made of the OpenAPI document: export options, configuration keys, dataset settings.

import { json } from "./api.js";
import { useLoaded } from "./hooks.js";
import { html, useState } from "./html.js";
import { NumberField, faultText, useFault } from "./parts.js";

/** @typedef {Record<string, any>} Schema */
/** @typedef {{value: string, text: string}} Choice */

/**
 * @typedef {object} Field
 * @property {string} key
 * @property {"choice" | "switch" | "number" | "numbers" | "pairs" | "text"} kind
 * @property {string} text  its name for people
 * @property {string} help  a sentence
 * @property {unknown} initial  the default
 * @property {readonly Choice[]} choices
 * @property {number} min
 * @property {number} max  of a text: characters
 * @property {string} unit  shown after the number
 * @property {boolean} isWhole
 * @property {boolean} isEmptyAllowed  the field may be left empty (null)
 * @property {boolean} isShare  a number from 0 to 1
 * @property {string} hint  of numbers: what an empty field shows
 * @property {boolean} needsPixels  of a configuration key: a change of it requires measuring the images again
 * @property {readonly string[]} evidence of a configuration key: the kinds of evidence whose rules read it; empty: all
 *   of them
 */

/** @typedef {Record<string, string>} Texts */
/**
 * Texts to be shown in place of keys and values of the API.
 * @typedef {{fields?: Texts, choices?: Record<string, Texts>, hints?: Texts}} Words
 */

/** @type {Promise<Schema> | null} */
let description = null;

/** The OpenAPI document, fetched once. @returns {Promise<Schema>} */
export function describeApi() {
  description ??= json("/openapi.json");
  description.catch(() => (description = null));
  return description;
}

/**
 * What a class can be measured as: the filter's classes, and `pass`.
 * @returns {readonly string[]} empty until they are loaded
 */
export const useMeasuredClasses = () =>
  useLoaded(async () => {
    const { classes } = (await describeApi()).components.schemas.FilterConfigIn.properties;
    return classes.additionalProperties.anyOf[0].examples;
  }, []).value ?? [];

/** The properties of an API object, as fields of a form. @param {string} name  of the object @param {Words} [words] */
export const useFields = (name, words) => useLoaded(async () => fieldsOf(await describeApi(), name, words), [name]);

/**
 * Those properties of an API object for which there is a control.
 * @param {Schema} openapi @param {string} name @param {Words} [words] @returns {Field[]}
 */
export const fieldsOf = (openapi, name, words = {}) =>
  Object.entries(openapi.components?.schemas?.[name]?.properties ?? {}).flatMap(
    ([key, schema]) => fieldOf(key, schema, words) ?? [],
  );

/** @type {Record<string, string>} */
const UNITS = { percent: "%", pixels: "px", metres: "m" };

/** @param {number} share */
const percentOf = (share) => `${Math.round(100 * share)} %`;

/** @param {string} key @param {Schema} schema @param {Words} words @returns {Field | null} */
function fieldOf(key, schema, { fields = {}, choices = {}, hints = {} }) {
  // What requires measuring again is only shown, so that it needs no control of its own.
  const kind = kindOf(schema) ?? (schema["x-needs-pixels"] === true ? "text" : null);
  if (kind === null) return null;
  const { minimum: min = -Infinity, maximum: max = schema.maxLength ?? Infinity, "x-unit": unit = "" } = schema;
  /** @type {string[]} */
  const values = schema.enum ?? (schema.const === undefined ? [] : [schema.const]);
  const name = key.replaceAll("_", " ");
  return {
    key,
    kind,
    text: fields[key] ?? `${name[0]?.toUpperCase()}${name.slice(1)}`,
    help: schema.description ?? "",
    initial: schema["x-default"],
    choices: values.map((value) => ({ value, text: choices[key]?.[value] ?? value })),
    min,
    max,
    unit: UNITS[unit] ?? unit,
    isWhole: typesOf(schema).includes("integer"),
    isEmptyAllowed: typesOf(schema).includes("null"),
    isShare: kind === "number" && min === 0 && max === 1,
    hint: hints[key] ?? "",
    needsPixels: schema["x-needs-pixels"] === true,
    evidence: schema["x-evidence"] ?? [],
  };
}

/** @param {Schema} schema @returns {string[]} */
const typesOf = (schema) => [schema.type ?? []].flat();

/** @param {Schema} schema @returns {Field["kind"] | null} null: there is no control for it */
function kindOf(schema) {
  if (schema.enum || schema.const !== undefined) return "choice";
  const types = typesOf(schema);
  if (types.includes("boolean")) return "switch";
  if (isNumeric(types)) return "number";
  if (types.includes("array")) return isNumeric(typesOf(schema.items ?? {})) ? "numbers" : null;
  if (types.includes("object")) return schema.additionalProperties?.type === "string" ? "pairs" : null;
  return types.includes("string") ? "text" : null;
}

/** @param {readonly string[]} types */
const isNumeric = (types) => types.includes("number") || types.includes("integer");

/**
 * The options to be sent: what was chosen, else the default.
 * @param {readonly Field[]} fields @param {Record<string, unknown>} chosen
 */
export const optionsOf = (fields, chosen) =>
  Object.fromEntries(fields.map(({ key, initial }) => [key, key in chosen ? chosen[key] : initial]));

/**
 * The typed text as a number; null if it is not one that the field allows.
 * @param {Pick<Field, "min" | "max" | "isWhole">} field @param {string} text
 */
export function parseNumber({ min, max, isWhole }, text) {
  const number = Number(text.trim() || NaN);
  return number >= min && number <= max && (!isWhole || Number.isInteger(number)) ? number : null;
}

/** Which numbers a field allows: "a whole number from 0 to 9". @param {Pick<Field, "min" | "max" | "isWhole">} field */
export function rangeText({ min, max, isWhole }) {
  const what = isWhole ? "a whole number" : "a number";
  if (Number.isFinite(min) && Number.isFinite(max)) return `${what} from ${min} to ${max}`;
  if (Number.isFinite(min)) return `${what} of at least ${min}`;
  return Number.isFinite(max) ? `${what} of at most ${max}` : what;
}

/** "50, 100" as numbers; null when it is something else. @param {string} text */
export function parseNumbers(text) {
  const parts = text.split(/[\s,;]+/).filter(Boolean);
  const numbers = parts.map(Number);
  return numbers.every((number) => Number.isFinite(number)) ? numbers : null;
}

/** "40: Pedestrian, 100: Car" as an object; null when it is something else. @param {string} text */
export function parsePairs(text) {
  const parts = text.split(/[,;]+/).filter((part) => part.trim() !== "");
  const pairs = parts.map((part) => part.split(":").map((word) => word.trim()));
  if (!pairs.every((words) => words.length === 2 && words.every(Boolean))) return null;
  return /** @type {Record<string, string>} */ (Object.fromEntries(pairs));
}

/** @typedef {{field: Field, value: unknown, onChange: (value: unknown) => void}} Asked */

/** A control with its name. @param {Asked} props */
export function AskField({ field, value, onChange }) {
  const { kind, text, help } = field;
  const control = html`<${Control} field=${field} value=${value} onChange=${onChange} />`;
  if (kind === "switch") return html`<label class="switch" title=${help}>${control}<span>${text}</span></label>`;
  return html`<label class="ask__row" title=${help}><span>${text}</span>${control}</label>`;
}

/** @typedef {{currentTarget: HTMLInputElement | HTMLSelectElement | HTMLTextAreaElement}} Given */

/**
 * The control of a field.
 * @param {Asked & {label?: string, isSet?: boolean}} props `label`: its accessible name, where no visible label names
 *   it; `isSet`: it was changed
 */
export function Control({ field, value, onChange, label = field.text, isSet = false }) {
  const { key, kind, choices, min, max, unit, isWhole, isEmptyAllowed, isShare, hint } = field;
  const onGiven = (/** @type {Given} */ { currentTarget }) => onChange(currentTarget.value);
  switch (kind) {
    case "switch":
      return html`<input type="checkbox" name=${key} checked=${value === true}
        onChange=${() => onChange(value !== true)} />`;
    case "choice":
      return html`<span
        class="select"><select name=${key} aria-label=${label} value=${String(value)} onChange=${onGiven}>
          ${choices.map((choice) => html`<option value=${choice.value}>${choice.text}</option>`)}
        </select></span>`;
    case "text":
      return html`<textarea name=${key} aria-label=${label} rows="2" maxlength=${max} value=${String(value ?? "")}
        onInput=${onGiven}></textarea>`;
    case "numbers":
      return html`<${Listed} label=${label} initial=${Array.isArray(value) ? value.join(", ") : ""}
        parse=${parseNumbers} expected="numbers, separated by commas" hint=${hint} onEach=${onChange} />`;
    case "pairs":
      return html`<${Listed} key=${JSON.stringify(value)} label=${label} parse=${parsePairs}
        initial=${Object.entries(value ?? {})
          .map((pair) => pair.join(": "))
          .join(", ")}
        expected="pairs, separated by commas" hint="none, or 40: Pedestrian" onDone=${onChange} />`;
    default:
      if (isShare) {
        return html`<span class="ask__number">
          <input type="range" class="slider" aria-label=${label} min=${min} max=${max} step="0.05"
            value=${Number(value)}
            onInput=${(/** @type {Given} */ { currentTarget }) => onChange(Number(currentTarget.value))} />
          <output class="num">${percentOf(Number(value))}</output></span>`;
      }
      return html`<${NumberField} label=${label} unit=${unit} step=${isWhole || unit !== "%" ? 1 : 0.5}
        isEmptyAllowed=${isEmptyAllowed} isSet=${isSet} expected=${rangeText(field)}
        value=${typeof value === "number" ? value : null}
        parse=${(/** @type {string} */ text) => parseNumber(field, text)} onChange=${onChange} />`;
  }
}

/**
 * A field for several values. It keeps what is being typed, and while that is not allowed, says why.
 * @template {object} T
 * @param {{label?: string, name?: string, initial: string, parse: (text: string) => T | null, expected?: string,
 *   hint: string, onEach?: (values: T) => void, onDone?: (values: T) => void}} props
 *   `label`: where no visible label names it; `onEach`: called with each change; `onDone`: when the field is left
 */
export function Listed({ label, name, initial, parse, expected = "", hint, onEach, onDone }) {
  const [text, setText] = useState(initial);
  const fault = parse(text) === null ? faultText(expected, { text, isBad: false }) : "";
  const { attributes, line } = useFault(fault);
  /** @param {{currentTarget: HTMLInputElement}} event */
  const onInput = ({ currentTarget }) => {
    setText(currentTarget.value);
    const values = parse(currentTarget.value);
    // A form is not sent while one of its fields is not valid.
    currentTarget.setCustomValidity(values ? "" : expected);
    if (values) onEach?.(values);
  };
  /** What was typed last may not have been rendered yet. @param {{currentTarget: HTMLInputElement}} event */
  const onChange = ({ currentTarget: { value } }) => {
    const values = parse(value);
    if (values) onDone?.(values);
  };
  return html`<span class="numberfield">
    <span class="search"><input class="num" type="text" name=${name} aria-label=${label} value=${text}
        placeholder=${hint} ...${attributes} onInput=${onInput} onChange=${onChange} /></span>
    ${line}
  </span>`;
}
