// @ts-check
// Every key of the configuration, the stored versions, what differs, the dialog that saves.

import { get, post, put } from "../core/api.js";
import { Control, Listed, useMeasuredClasses } from "../core/form.js";
import { useNewest, useTask } from "../core/hooks.js";
import { html, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { agoText, countOf, countText } from "../core/numbers.js";
import { Dialog, FailureLine, Older, WideTable, Words, useCopy, useDialog } from "../core/parts.js";
import {
  classPath,
  differences,
  editsBetween,
  isReading,
  keyValue,
  ownSetting,
  toYaml,
  valueOf,
  valueText,
} from "./config.js";

/** @import { Field } from "../core/form.js" */
/** @import { Loaded } from "../core/hooks.js" */
/** @import { ConfigVersion, Dataset, Run } from "../core/openapi.js" */
/** @import { ConfigValue } from "./config.js" */
/** @import { Tuning } from "./preview.js" */

/** How many versions are shown at first. */
const NEWEST = 50;

/** Make a version the active one, through a run. @param {string} dataset @param {string} digest */
const activate = (dataset, digest) => put("/api/v1/datasets/{dataset}/config", { path: { dataset }, body: { digest } });

/**
 * Fail if another version has become active: one that is made from the former would lack what the other person changed.
 * @param {string} dataset @param {string} digest @param {() => void} onOutdated
 * @param {string} [more] the end of the message
 */
export async function requireActive(dataset, digest, onOutdated, more = "The page shows now what it says.") {
  const active = await get("/api/v1/datasets/{dataset}/config", { path: { dataset } });
  if (active.digest === digest) return;
  onOutdated();
  throw new Error(`Nothing was saved: somebody has applied another version since. ${more}`);
}

/** @param {{dataset: string, tuning: Tuning, saved: number, isRunning: boolean, onRun: (run: Run) => void}} props */
export function Versions({ dataset, tuning, saved, isRunning, onRun }) {
  const { active } = tuning;
  const loaded = useNewest(
    NEWEST,
    (query, signal) => get("/api/v1/datasets/{dataset}/configs", { path: { dataset }, query, signal }),
    [dataset, active.digest, saved],
  );
  const [asked, setAsked] = useState(/** @type {ConfigVersion | null} */ (null));
  return html`<section class="panelbox" aria-labelledby="versions-title">
    <header class="panelbox__head"><h2 id="versions-title">Versions</h2>
      <span class="faint">
        ${
          loaded.value ? `${loaded.showOlder ? "the newest " : ""}${countOf(loaded.value.items.length, "version")}` : ""
        }</span></header>
    ${loaded.error && html`<${FailureLine} error=${loaded.error} onRetry=${loaded.reload} />`}
    <ul class="versions">
      ${loaded.value?.items.map(
        (
          version,
        ) => html`<li key=${version.digest} class="version ${version.digest === active.digest ? "is-active" : ""}">
          <span class="version__name"><code title=${version.digest}>${version.digest.slice(0, 8)}</code>
            ${version.digest === active.digest && html`<span class="tagword">active</span>`}</span>
          <span class="version__text">${differenceText(active, version)}</span>
          <span class="version__who faint">${version.created_by}, ${agoText(version.created_at)}</span>
          ${
            version.digest !== active.digest &&
            html`<span class="version__actions">
              <button class="button button--small"
                onClick=${() => tuning.setEdits(editsBetween(active.config, version.config))}>Try</button>
              <button class="button button--small" disabled=${isRunning}
                onClick=${() => setAsked(version)}>Apply…</button>
            </span>`
          }
        </li>`,
      )}
    </ul>
    <${Older} what="versions" onShow=${loaded.showOlder} />
    ${
      asked &&
      html`<${ApplyDialog} dataset=${dataset} active=${active} version=${asked} onClose=${() => setAsked(null)}
        onRun=${onRun} />`
    }
  </section>`;
}

/**
 * Asks before a stored version is applied.
 * @param {{dataset: string, active: ConfigVersion, version: ConfigVersion, onClose: () => void, onRun: (run: Run) =>
 *   void}} props
 */
function ApplyDialog({ dataset, active, version, onClose, onRun }) {
  const dialog = useDialog();
  const rows = differences(active.config, version.config);
  const {
    run: apply,
    isBusy,
    error,
  } = useTask(async () => {
    onRun(await activate(dataset, version.digest));
    dialog.close();
  });
  return html`<${Dialog} dialog=${dialog} id="apply-title"
    title=${`Apply version ${version.digest.slice(0, 8)} to ${dataset}?`} isLight=${true} onClose=${onClose}>
    <p class="savedialog__digest">Version <code title=${version.digest}>${version.digest.slice(0, 16)}</code> <span
        class="faint">
        ${rows.length > 0 ? "differs from" : "has the same values as"} the active <code>${active.digest.slice(0, 8)}
        </code>${rows.length > 0 ? " in:" : "."}</span></p>
    ${error && html`<${FailureLine} error=${error} />`}
    ${rows.length > 0 && html`<${DiffTable} rows=${rows} names=${["Active", "This version"]} />`}
    <p class="savedialog__what">A run decides all boxes of ${dataset} by this version. People's answers are not changed.
    </p>
    <footer class="dialog__foot">
      <button class="button" onClick=${dialog.close}>Cancel</button>
      <button class="button button--primary" disabled=${isBusy} onClick=${apply}>Apply</button>
    </footer>
  <//>`;
}

/** @param {ConfigVersion} active @param {ConfigVersion} version */
function differenceText(active, version) {
  if (version.digest === active.digest) return "in use";
  const rows = differences(active.config, version.config);
  const [first] = rows;
  if (!first) return "same values as the active version";
  const words = `${first.path.replace("classes.", "")}: ${valueText(first.after)}`;
  return rows.length > 1 ? `${words}, and ${countOf(rows.length - 1, "more key")}` : words;
}

/** @param {{tuning: Tuning, keys: Loaded<Field[]>, settings: Dataset}} props */
export function ConfigPanel({ tuning, keys, settings }) {
  const { tried, active } = tuning;
  const ofClasses = differences({ ...tried, classes: {} }, tried);
  return html`<section class="panelbox" aria-labelledby="config-title">
    <header class="panelbox__head">
      <h2 id="config-title">Configuration</h2>
      <span class="faint">all keys; how segmentations are read is changed in the dataset's settings</span>
    </header>
    ${keys.error && html`<${FailureLine} error=${keys.error} onRetry=${keys.reload} />`}
    <${WideTable} label="Configuration" kind="table--keys" isBusy=${keys.state === "loading"}
      heads=${["Key", "Value", "Active", { text: "Meaning", kind: "table__text" }]}>
          ${keys.value?.map(
            (field) => html`<tr key=${field.key}><th scope="row"><code><${Words} text=${field.key} /></code></th>
              <td><${Value} tuning=${tuning} field=${field} /></td>
              <td class="num faint">${valueText(keyValue(active.config, field))}</td>
              <td class="table__text faint">${field.help}<${OwnSetting} value=${ownSetting(settings, tried, field)} />
              </td>
            </tr>`,
          )}
          ${ofClasses.map(
            (row) => html`<tr key=${row.path}><th scope="row"><code><${Words} text=${row.path} /></code></th>
              <td class="num">${valueText(row.after)}</td>
              <td class="num faint">${valueText(valueOf(active.config, row.path))}</td>
              <td class="table__text faint">for this class only</td></tr>`,
          )}
    <//>
    <${ClassKeys} tuning=${tuning} classes=${settings.classes} />
    <${Yaml} text=${toYaml(tried)} />
  </section>`;
}

/** @param {{value: string}} props */
const OwnSetting = ({ value }) => value && html` <strong>The dataset's own setting is used: ${value}.</strong>`;

/** @param {{tuning: Tuning, field: Field}} props */
function Value({ tuning, field }) {
  const { key, kind, unit } = field;
  const value = keyValue(tuning.tried, field);
  if (isReading(key) || kind === "text")
    return html`<span class="num">${valueText(value)}${unit && `\u00a0${unit}`}</span>`;
  return html`<${Control} field=${field} label=${key} value=${value} isSet=${key in tuning.edits}
    onChange=${(/** @type {ConfigValue} */ given) => tuning.change({ [key]: given })} />`;
}

/** @typedef {{currentTarget: HTMLSelectElement}} Chosen */

/**
 * What a class is measured as, or the tags that count for it.
 * @param {{tuning: Tuning, classes: readonly string[]}} props
 */
function ClassKeys({ tuning: { tried, change }, classes }) {
  const [name = "", setName] = useState(classes[0]);
  const measured = useMeasuredClasses();
  const [as, tags] = [classPath(name, "measures_as"), classPath(name, "accept")];
  const accepted = valueOf(tried, tags);
  const listed = Array.isArray(accepted) ? accepted.join(", ") : "";
  /** @param {Chosen} event */
  const onName = ({ currentTarget: { value } }) => setName(value);
  /** @param {Chosen} event */
  const onAs = ({ currentTarget: { value } }) =>
    change({ [as]: value || undefined, ...(value && { [tags]: undefined }) });
  /** @param {(string | number)[]} values */
  const onTags = (values) => change(values.length > 0 ? { [tags]: values, [as]: undefined } : { [tags]: undefined });
  return html`<fieldset class="classkeys">
    <legend>What a class is measured as</legend>
    <label><span>Class</span><span class="select"><select value=${name} onChange=${onName}>
          ${classes.map((each) => html`<option value=${each}>${each}</option>`)}
        </select></span></label>
    <label><span>Measured as</span><span class="select"><select value=${valueOf(tried, as) ?? ""} onChange=${onAs}>
          <option value="">what its name means</option>
          ${measured.map((each) => html`<option value=${each}>${each}</option>`)}
        </select></span></label>
    <label><span>or by these tags</span><${Listed} key=${`${name}: ${listed}`} name=${name} initial=${listed}
        parse=${tagsIn} hint="Car, Truck" onDone=${onTags} /></label>
  </fieldset>`;
}

/** "Car, 12" as tags: names, and numbers. @param {string} text */
const tagsIn = (text) =>
  text.split(/[,;]+/).flatMap((word) => (/^\s*\d+\s*$/.test(word) ? Number(word) : word.trim() || []));

/** @param {{text: string}} props */
function Yaml({ text }) {
  const { isCopied, copy } = useCopy(text);
  return html`<details class="yaml">
    <summary>As YAML</summary>
    <div class="yaml__body">
      <pre tabindex="0" aria-label="Configuration as YAML"><code>${text}</code></pre>
      <button class="button button--small"
        onClick=${copy}><${Icon} name=${isCopied ? "check" : "copy"} />${isCopied ? "Copied" : "Copy YAML"}</button>
    </div>
  </details>`;
}

/**
 * @param {{dataset: string, tuning: Tuning, onClose: () => void, onSaved: (digest: string) => void, onRun: (run: Run)
 *   => void, onOutdated: () => void}} props `onOutdated`: another version has become active
 */
export function SaveDialog({ dataset, tuning, onClose, onSaved, onRun, onOutdated }) {
  const dialog = useDialog();
  const digest = tuning.counted === tuning.tried ? (tuning.preview?.config ?? "") : "";

  const {
    run: save,
    isBusy,
    error,
  } = useTask(async (/** @type {boolean} */ isApplied) => {
    await requireActive(dataset, tuning.active.digest, onOutdated, "What follows is how yours differs from it now.");
    const version = await post("/api/v1/datasets/{dataset}/configs", { path: { dataset }, body: tuning.tried });
    onSaved(version.digest);
    if (isApplied) onRun(await activate(dataset, version.digest));
    dialog.close();
  });

  return html`<${Dialog} dialog=${dialog} id="save-title" title="Save as new config version" isLight=${true}
    onClose=${onClose}>
    <p class="savedialog__digest">Version <code title=${digest}>${digest ? digest.slice(0, 16) : "…"}</code> <span
        class="faint">differs from the active <code>${tuning.active.digest.slice(0, 8)}</code> in:</span></p>
    ${error && html`<${FailureLine} error=${error} />`}
    <${DiffTable} rows=${differences(tuning.active.config, tuning.tried)} />
    <p class="savedialog__what">${whatText(tuning)}</p>
    <footer class="dialog__foot">
      <span class="faint">Versions are never changed.</span>
      <span class="savedialog__buttons">
        <button class="button" disabled=${isBusy} onClick=${() => save(false)}>Save only</button>
        <button class="button button--primary" disabled=${isBusy} onClick=${() => save(true)}>Save and apply</button>
      </span>
    </footer>
  <//>`;
}

/** @param {Tuning} tuning */
function whatText({ preview, counted, tried }) {
  if (counted !== tried) return "";
  if (preview?.needs_pixels)
    return "Applying it measures all frames again, in the background. Nothing changes until that is done.";
  const flips = preview?.flips;
  if (!flips) return "";
  return `Applying it flips ${countOf(flips.total, "box", "boxes")}: ${countText(flips.kept_to_rejected)} from kept to rejected, ${countText(flips.rejected_to_kept)} from rejected to kept. People's answers are not changed.`;
}

/** @param {{rows: readonly import("./config.js").Difference[], names?: readonly string[]}} props */
export const DiffTable = ({
  rows,
  names = ["Active", "New"],
}) => html`<${WideTable} label="Differences" kind="difftable" heads=${["Key", ...names]}>
    ${rows.map(
      (row) => html`<tr key=${row.path}><th scope="row"><code><${Words} text=${row.path} /></code></th>
        <td><del>${valueText(row.before)}</del></td><td><ins>${valueText(row.after)}</ins></td></tr>`,
    )}
  <//>`;
