// @ts-check
// A number that is typed. What is wrong stays in the field and changes nothing.

import { html, useState } from "../../html.js";

/**
 * @param {{label: string, value: number | null, unit: string, step?: number, isEmptyAllowed?: boolean, isSet?: boolean,
 *   parse: (text: string) => number | null, onChange: (value: number | null) => void}} props
 */
export function NumberField({ label, value, unit, step = 0.5, isEmptyAllowed = false, isSet = false, parse, onChange }) {
  const [typed, setTyped] = useState(/** @type {string | null} */ (null));
  const shown = typed ?? (value === null ? "" : String(value));
  const isWrong = typed !== null && parse(typed) === null && !(isEmptyAllowed && typed.trim() === "");
  /** @param {{currentTarget: HTMLInputElement}} event */
  const onInput = ({ currentTarget }) => {
    const text = currentTarget.value;
    setTyped(text);
    const number = parse(text);
    if (number !== null) onChange(number);
    else if (isEmptyAllowed && text.trim() === "") onChange(null);
  };
  return html`<span class="amount ${isSet ? "is-set" : ""} ${isWrong ? "is-wrong" : ""}">
    <input class="num" type="number" inputmode="decimal" step=${step} min="0" aria-label=${label} aria-invalid=${isWrong}
      value=${shown} placeholder=${isEmptyAllowed ? "none" : ""} onInput=${onInput} onBlur=${() => setTyped(null)} />
    <span class="amount__unit" aria-hidden="true">${unit}</span>
  </span>`;
}
