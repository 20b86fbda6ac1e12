// @ts-check
// Asking for an export: a format, and what the API says can be chosen about it.

import { html, useState } from "../../html.js";
import { jobs } from "../../calls/jobs.js";
import { optionsOf, parseNumbers, splitText } from "../../export_form.js";

/** @typedef {import("../../export_form.js").Field} Field */

/** @param {{app: import("../../app.js").App, dataset: string, form: import("../../export_form.js").ExportForm, onMade: () => void, onClose: () => void}} props */
export function ExportAsk({ app, dataset, form, onMade, onClose }) {
  const [format, setFormat] = useState(form.formats[0]?.value ?? "");
  const [chosen, setChosen] = useState(/** @type {Record<string, unknown>} */ ({}));
  const [error, setError] = useState(/** @type {Error | null} */ (null));
  const [isBusy, setBusy] = useState(false);
  /** @param {Event} event */
  const onSubmit = async (event) => {
    event.preventDefault();
    setBusy(true);
    setError(null);
    try {
      await jobs.createExport(dataset, { format, options: optionsOf(form.fields, chosen) });
      onMade();
    } catch (failure) {
      app.notice(failure);
      setError(failure instanceof Error ? failure : new Error(String(failure)));
      setBusy(false);
    }
  };
  return html`<form class="ask" onSubmit=${onSubmit}>
    <fieldset class="ask__formats">
      <legend>Format</legend>
      ${form.formats.map(
        ({ value, text, help }) => html`<label class="formatcard ${value === format ? "is-chosen" : ""}">
          <input type="radio" name="format" value=${value} checked=${value === format} onChange=${() => setFormat(value)} />
          <span class="formatcard__name">${text}</span><span class="formatcard__help">${help}</span>
        </label>`,
      )}
    </fieldset>
    <div class="ask__fields">
      ${form.fields.map((field) => html`<${AskField} key=${field.key} field=${field} value=${field.key in chosen ? chosen[field.key] : field.initial} onChange=${(/** @type {unknown} */ value) => setChosen({ ...chosen, [field.key]: value })} />`)}
    </div>
    ${error && html`<p class="problem" role="alert">${error.message}</p>`}
    <p class="ask__foot"><span class="faint">The order of the classes is fixed from the first export on.</span>
      <button type="button" class="button" onClick=${onClose}>Cancel</button>
      <button class="button button--primary" disabled=${isBusy || !format}>Make export</button></p>
  </form>`;
}

/** @param {{field: Field, value: unknown, onChange: (value: unknown) => void}} props */
function AskField({ field, value, onChange }) {
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
