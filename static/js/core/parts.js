// @ts-check
// General controls: Notice, Failure, FailureLine, WideTable, Command, RecordingDownload, Dialog, Segments, Select,
// useFault, NumberField, FileList.

import { ApiError } from "./api.js";
import { useRetryOnline } from "./hooks.js";
import { html, useEffect, useId, useLayoutEffect, useRef, useState } from "./html.js";
import { Icon } from "./icons.js";
import { countText } from "./numbers.js";
import { linkTo } from "./router.js";

/** @param {{title: string, children?: unknown, icon?: string, actions?: unknown}} props */
export function Notice({ title, children, icon = "image", actions }) {
  return html`<section class="notice">
    <div class="notice__icon"><${Icon} name=${icon} /></div>
    <h2 class="notice__title">${title}</h2>
    <div class="notice__text">${children}</div>
    ${actions && html`<div class="notice__actions">${actions}</div>`}
  </section>`;
}

/**
 * In place of a view or a list that could not be loaded: why, in the server's words, and a button to try again.
 * @param {{error: Error, onRetry: () => void}} props
 */
export function Failure({ error, onRetry }) {
  useRetryOnline(error instanceof ApiError ? null : error, onRetry);
  const { problem = null, status = 0 } = error instanceof ApiError ? error : {};
  return html`<${Notice} icon="warn" title=${problem?.title ?? "This could not be loaded"} actions=${html`${
    status === 404 && html`<a class="button button--primary" href=${linkTo("datasets")}>All datasets</a>`
  }
    <button class="button" onClick=${onRetry}>Try again</button>`}>
    <p role="alert">${error.message}</p>
    ${problem?.request_id && html`<p class="faint">Request ${problem.request_id}</p>`}
  <//>`;
}

/**
 * A part of a view that could not be loaded, or something that was asked for and not done, in one line: why, in the
 * server's words.
 * @param {{what?: string, error: {message: string}, onRetry?: () => void}} props `what`: the part, where its place does
 *   not say it; `onRetry`: with a button to try again; without one, the button that was pressed is still there
 */
export function FailureLine({ what, error, onRetry }) {
  useRetryOnline(error instanceof ApiError ? null : error, onRetry);
  return html`<p class="failure" role="alert">
    <${Icon} name="warn" /><span class="failure__text">${what && `${what}: `}${error.message}</span>
    ${onRetry && html`<button type="button" class="button button--small" onClick=${onRetry}>Try again</button>`}
  </p>`;
}

/** @typedef {{text: unknown, title?: string, kind?: string}} Head  over a column */

/** Over a column of numbers. @param {string} text @param {string} [title] @returns {Head} */
export const numeric = (text, title) => ({ text, title, kind: "is-num" });

/** Over a column of bars, which are drawings of the numbers beside them. @type {Head} */
export const BAR = { text: "", kind: "table__bar" };

/**
 * A table that scrolls sideways where it is too wide: keys can scroll it, too.
 * @param {{label: string, kind?: string, caption?: string, heads: readonly (string | Head)[], isBusy?: boolean,
 *   children?: unknown}} props  `children`: its rows
 */
export function WideTable({ label, kind = "", caption, heads, isBusy, children }) {
  const root = useRef(/** @type {HTMLDivElement | null} */ (null));
  const [isWide, setWide] = useState(false);
  useLayoutEffect(() => {
    const wrap = /** @type {HTMLDivElement} */ (root.current);
    const sizes = new ResizeObserver(() => setWide(wrap.scrollWidth > wrap.clientWidth));
    for (const element of [wrap, ...wrap.children]) sizes.observe(element);
    return () => sizes.disconnect();
  }, []);
  const scrolled = isWide ? { role: "group", "aria-label": label, tabindex: 0 } : {};
  return html`<div class="tablewrap" ref=${root} ...${scrolled}>
    <table class=${`table ${kind}`.trim()} aria-busy=${isBusy}>
      ${caption && html`<caption class="sr-only">${caption}</caption>`}
      <thead><tr>${heads.map((head) => {
        const { text, title, kind } = typeof head === "string" ? { text: head } : /** @type {Head} */ (head);
        return kind === BAR.kind
          ? html`<th class=${kind} aria-hidden="true"></th>`
          : html`<th class=${kind} scope="col" title=${title}>${text}</th>`;
      })}</tr></thead>
      <tbody>${children}</tbody>
    </table>
  </div>`;
}

/** Shows the older items of a list, see `useNewest`. @param {{what: string, onShow: (() => void) | null}} props */
export const Older = ({ what, onShow }) =>
  onShow && html`<p class="more"><button class="button" onClick=${onShow}>${`Older ${what}`}</button></p>`;

/** A name that may break behind its dots and underscores, and nowhere else. @param {{text: string}} props */
export const Words = ({ text }) => text.split(/(?<=[._])/).map((part, i) => (i ? html`<wbr />${part}` : part));

/** Of a text that is shortened, so many characters at its end are always shown. */
const TAIL = 10;

/**
 * One line. Where there is no room for all of it, characters in its middle are left out.
 * @param {{text: string}} props
 */
export function MiddleCut({ text }) {
  const characters = [...text];
  return html`<span class="middlecut"><span class="middlecut__head">${characters.slice(0, -TAIL).join("")}</span>
    <span class="middlecut__tail">${characters.slice(-TAIL).join("")}</span></span>`;
}

/** Copy a text; `isCopied` is true for a moment afterwards. @param {string} text */
export function useCopy(text) {
  const [isCopied, setCopied] = useState(false);
  const copy = async () => {
    setCopied(await isInClipboard(text));
    setTimeout(() => setCopied(false), 1500);
  };
  return { isCopied, copy };
}

/** Copy a text. @param {string} text @returns {Promise<boolean>} false: the browser does not allow it */
export async function isInClipboard(text) {
  if (navigator.clipboard)
    return navigator.clipboard.writeText(text).then(
      () => true,
      () => false,
    );
  // On a page that is not served securely there is only the older way: to copy what is selected.
  const field = Object.assign(document.createElement("textarea"), { value: text });
  (document.querySelector("dialog[open]") ?? document.body).append(field);
  field.select();
  const isCopied = document.execCommand("copy");
  field.remove();
  return isCopied;
}

/** A button that saves a recording.yaml. @param {{text: string, about: string}} props */
export function RecordingDownload({ text, about }) {
  const save = () => {
    const href = URL.createObjectURL(new Blob([text], { type: "application/yaml" }));
    Object.assign(document.createElement("a"), { href, download: "recording.yaml" }).click();
    // Not at once: the browser reads it after the click.
    setTimeout(() => URL.revokeObjectURL(href), 1000);
  };
  return html`<p class="understood__save">
    <button type="button" class="button" onClick=${save}><${Icon} name="download" />Download recording.yaml</button>
    <span class="faint">${about}</span>
  </p>`;
}

/** A dialog that opens as soon as it is drawn. */
export function useDialog() {
  const ref = useRef(/** @type {HTMLDialogElement | null} */ (null));
  useEffect(() => ref.current?.showModal(), []);
  return { ref, close: () => ref.current?.close() };
}

/**
 * A window over the page, with a title and a cross.
 * @param {{dialog: ReturnType<typeof useDialog>, id: string, title: string, kind?: string, isLight?: boolean,
 *   children?: unknown, onClose: () => void, onKeyDown?: (event: KeyboardEvent) => void}} props `isLight`: a click
 *   outside closes it, because no input would be lost
 */
export function Dialog({
  dialog: { ref, close },
  id,
  title,
  kind = "",
  isLight = false,
  children,
  onClose,
  onKeyDown,
}) {
  return html`<dialog class="dialog ${kind && `dialog--${kind}`}" ref=${ref} aria-labelledby=${id} onClose=${onClose}
    onKeyDown=${onKeyDown}
    onClick=${(/** @type {MouseEvent} */ event) => isLight && event.target === ref.current && close()}>
    <div class="dialog__body">
      <header class="dialog__head">
        <h2 id=${id}>${title}</h2>
        <button class="button button--quiet button--icon" aria-label="Close"
          onClick=${close}><${Icon} name="cross" /></button>
      </header>
      ${children}
    </div>
  </dialog>`;
}

/** A command to copy. @param {{text: string}} props */
export function Command({ text }) {
  const { isCopied, copy } = useCopy(text);
  return html`<div class="command">
    <code>${text}</code>
    <button class="button button--quiet button--icon" onClick=${copy} aria-label=${`Copy: ${text}`} title="Copy">
      <${Icon} name=${isCopied ? "check" : "copy"} />
    </button>
    <span class="sr-only" role="status">${isCopied ? "Copied" : ""}</span>
  </div>`;
}

/**
 * A choice among a few values, as a row of buttons.
 * @param {{label: string, value: string, choices: readonly {value: string, text: string, title?: string}[], onChange:
 *   (value: string) => void}} props
 */
export function Segments({ label, value, choices, onChange }) {
  return html`<div class="segments" role="group" aria-label=${label}>
    ${choices.map(
      (choice) => html`<button type="button" class="segments__item" title=${choice.title}
        aria-pressed=${choice.value === value} onClick=${() => onChange(choice.value)}>
        ${choice.text}
      </button>`,
    )}
  </div>`;
}

/**
 * @param {{label: string, value: string, choices: readonly {value: string, text: string}[], any: string, onChange:
 *   (value: string) => void}} props
 */
export function Select({ label, value, choices, any, onChange }) {
  const known = value === "" || choices.some((choice) => choice.value === value);
  return html`<span class="select ${value ? "is-set" : ""}">
    <select aria-label=${label} value=${value}
      onChange=${(/** @type {{currentTarget: HTMLSelectElement}} */ event) => onChange(event.currentTarget.value)}>
      <option value="">${any}</option>
      ${choices.map((choice) => html`<option value=${choice.value}>${choice.text}</option>`)}
      ${!known && html`<option value=${value}>${value}</option>`}
    </select>
  </span>`;
}

/**
 * What is wrong with a typed number: "Expected 0 to 100, found 131."
 * @param {string} expected
 * @param {{text: string, isBad: boolean}} typed `isBad`: it is no number; then browsers give no text
 */
export const faultText = (expected, { text, isBad }) =>
  `Expected ${expected}, found ${isBad ? "no number" : text.trim() || "nothing"}.`;

/**
 * How a control says what is wrong with what was typed: attributes of the control, and a line below it.
 * @param {string} fault  empty: nothing is wrong
 */
export function useFault(fault) {
  const id = useId();
  return {
    attributes: { "aria-invalid": fault !== "", "aria-describedby": fault ? id : undefined },
    line: fault && html`<span id=${id} class="numberfield__fault" role="alert">${fault}</span>`,
  };
}

/**
 * A field for a number. While what is typed is not allowed, it says why.
 * @param {{label: string, value: number | null, unit: string, expected: string, step?: number, isEmptyAllowed?:
 *   boolean, isSet?: boolean, parse: (text: string) => number | null, onChange: (value: number | null) => void}} props
 *   `expected`: which numbers `parse` allows
 */
export function NumberField({
  label,
  value,
  unit,
  expected,
  step = 0.5,
  isEmptyAllowed = false,
  isSet = false,
  parse,
  onChange,
}) {
  const [typed, setTyped] = useState(/** @type {{text: string, isBad: boolean} | null} */ (null));
  const shown = typed?.text ?? (value === null ? "" : String(value));
  /** @param {{text: string, isBad: boolean}} given */
  const isNone = ({ text, isBad }) => isEmptyAllowed && !isBad && text.trim() === "";
  const fault = typed !== null && parse(typed.text) === null && !isNone(typed) ? faultText(expected, typed) : "";
  const { attributes, line } = useFault(fault);
  /** @param {{currentTarget: HTMLInputElement}} event */
  const onInput = ({ currentTarget }) => {
    const given = { text: currentTarget.value, isBad: currentTarget.validity.badInput };
    setTyped(given);
    const number = parse(given.text);
    if (number !== null) onChange(number);
    else if (isNone(given)) onChange(null);
  };
  return html`<span class="numberfield">
    <span class="amount ${isSet ? "is-set" : ""} ${fault ? "is-wrong" : ""}">
      <input class="num" type="number" inputmode="decimal" step=${step} min="0" aria-label=${label} ...${attributes}
        value=${shown} placeholder=${isEmptyAllowed ? "none" : ""} onInput=${onInput} onBlur=${() => setTyped(null)} />
      <span class="amount__unit" aria-hidden="true">${unit}</span>
    </span>
    ${line}
  </span>`;
}

const MOST_LISTED = 200;

/**
 * Files or frames, each with its reason.
 * @param {{title: string, items: readonly {name: string, why: string, more?: readonly string[]}[], total?: number,
 *   isOpen?: boolean}} props  `total`: how many there are, if `items` are only the first of them
 */
export function FileList({ title, items, total = items.length, isOpen = false }) {
  if (items.length === 0) return null;
  const listed = items.slice(0, MOST_LISTED);
  return html`<details class="filelist" open=${isOpen}>
    <summary>${title} <span class="num">${countText(total)}</span></summary>
    <ul tabindex="0" aria-label=${title}>
      ${listed.map(
        ({ name, why, more = [] }) =>
          html`<li><b>${name}</b> <span>${why}</span>
            ${more.length > 0 && html`<ul>${more.map((line) => html`<li>${line}</li>`)}</ul>`}</li>`,
      )}
      ${total > listed.length && html`<li class="faint">and ${countText(total - listed.length)} more</li>`}
    </ul>
  </details>`;
}
