// @ts-check
// Every key of the configuration, the stored versions, what differs, the dialog that saves.

import { jobs } from "../core/api.js";
import { useLoaded } from "../core/hooks.js";
import { html, useEffect, useRef, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { agoText, countOf, countText } from "../core/numbers.js";
import { NumberField, Words } from "../core/parts.js";
import { differences, editsBetween, toYaml, valueOf, valueText } from "./config.js";

/** @typedef {import("../core/types.js").ConfigVersion} ConfigVersion */
/** @typedef {import("../core/types.js").Run} Run */
/** @typedef {import("./preview.js").Tuning} Tuning */

const SHOWN = 50;

/**
 * @param {{app: import("../core/app.js").App, dataset: string, tuning: Tuning, saved: number, isRunning: boolean,
 *   onRun: (run: import("../core/types.js").Run) => void}} props
 */
export function Versions({ app, dataset, tuning, saved, isRunning, onRun }) {
  const { active } = tuning;
  const loaded = useLoaded(app, (signal) => jobs.configs(dataset, { limit: SHOWN }, signal), [dataset, active.digest, saved]);
  const [asked, setAsked] = useState("");
  /** @param {string} digest */
  const apply = async (digest) => {
    setAsked(digest);
    try {
      onRun(await jobs.activate(dataset, digest));
    } catch (error) {
      app.notice(error);
      app.toasts.show(error instanceof Error ? error.message : String(error), { kind: "error" });
    }
    setAsked("");
  };
  return html`<section class="panelbox" aria-labelledby="versions-title">
    <header class="panelbox__head"><h2 id="versions-title">Versions</h2><span class="faint">${loaded.value ? countOf(loaded.value.items.length, "version") : ""}</span></header>
    ${loaded.state === "error" && html`<p class="panelbox__empty" role="alert">${loaded.error.message} <button class="button button--small" onClick=${loaded.reload}>Try again</button></p>`}
    <ul class="versions">
      ${loaded.value?.items.map(
        (version) => html`<li key=${version.digest} class="version ${version.digest === active.digest ? "is-active" : ""}">
          <span class="version__name"><code title=${version.digest}>${version.digest.slice(0, 8)}</code>${version.digest === active.digest && html`<span class="tagword">active</span>`}</span>
          <span class="version__text">${differenceText(active, version)}</span>
          <span class="version__who faint">${version.created_by}, ${agoText(version.created_at)}</span>
          ${version.digest !== active.digest &&
          html`<span class="version__actions">
            <button class="button button--small" onClick=${() => tuning.setEdits(editsBetween(active.config, version.config))}>Try</button>
            <button class="button button--small" disabled=${isRunning || asked !== ""} onClick=${() => apply(version.digest)}>Apply</button>
          </span>`}
        </li>`,
      )}
    </ul>
  </section>`;
}

/** @param {ConfigVersion} active @param {ConfigVersion} version */
function differenceText(active, version) {
  if (version.digest === active.digest) return "decides now";
  const rows = differences(active.config, version.config);
  const [first] = rows;
  if (!first) return "the same values";
  const words = `${first.path.replace("classes.", "")}: ${valueText(first.after)}`;
  return rows.length > 1 ? `${words}, and ${countOf(rows.length - 1, "more key")}` : words;
}

/** @type {Record<string, {text: string, unit?: string, step?: number, most?: number, isEmptyAllowed?: boolean, isWhole?: boolean}>} */
const KEYS = {
  threshold_small_box: { text: "share of pixels that must match", unit: "%", most: 100 },
  size_big_box: { text: "share of the image above which a box is large", unit: "%", most: 100 },
  threshold_big_box: { text: "share that must match in a large box", unit: "%", most: 100 },
  min_visible_pixels: { text: "fewest matching pixels that must be seen of a box", unit: "px", step: 1, isWhole: true },
  min_distance: { text: "nearest distance that is kept", unit: "m", step: 1, isEmptyAllowed: true },
  max_distance: { text: "farthest distance that is kept", unit: "m", step: 1, isEmptyAllowed: true },
  profile: { text: "how pixels of a box are counted" },
  evidence: { text: "what is compared with the threshold" },
  projection: { text: "how 3D boxes become rectangles" },
  depth_tolerance: { text: "slack in front of and behind a box, metres" },
  ordered_min_pixels: { text: "pixels that nearer boxes must leave over", unit: "px", step: 1, isWhole: true },
  lidar_min_points: { text: "LiDAR points that must hit a box", unit: "points", step: 1, isWhole: true },
  palette: { text: "colours of the segmentation" },
  encoding: { text: "colours or raw tags" },
  channel_order: { text: "order of the colour channels" },
  lossy_segmentation: { text: "what to do with JPEG segmentations" },
};

/** @param {{tuning: Tuning}} props */
export function ConfigPanel({ tuning }) {
  const { tried, active } = tuning;
  const keys = Object.keys(tried).filter((key) => key !== "classes");
  const ofClasses = differences({ ...tried, classes: {} }, tried);
  return html`<section class="panelbox" aria-labelledby="config-title">
    <header class="panelbox__head"><h2 id="config-title">Configuration</h2><span class="faint">all keys; what can be answered from stored numbers can be changed here</span></header>
    <div class="tablewrap"><table class="table table--keys">
      <thead><tr><th scope="col">Key</th><th scope="col">Value</th><th scope="col">Active</th><th class="table__text" scope="col">Meaning</th></tr></thead>
      <tbody>
        ${keys.map((key) => html`<tr key=${key}><th scope="row"><code><${Words} text=${key} /></code></th><td><${Value} tuning=${tuning} name=${key} /></td><td class="num faint">${valueText(valueOf(active.config, key))}</td><td class="table__text faint">${KEYS[key]?.text ?? ""}</td></tr>`)}
        ${ofClasses.map((row) => html`<tr key=${row.path}><th scope="row"><code><${Words} text=${row.path} /></code></th><td class="num">${valueText(row.after)}</td><td class="num faint">${valueText(valueOf(active.config, row.path))}</td><td class="table__text faint">this class alone</td></tr>`)}
      </tbody>
    </table></div>
    <${Yaml} text=${toYaml(tried)} />
  </section>`;
}

/** @param {{tuning: Tuning, name: string}} props */
function Value({ tuning, name }) {
  const spec = KEYS[name];
  const value = valueOf(tuning.tried, name);
  if (!spec?.unit) return html`<span class="num">${valueText(value)}</span>`;
  /** @param {string} text */
  const parse = (text) => {
    const number = Number(text.trim() || NaN);
    const isRight = Number.isFinite(number) && number >= 0 && number <= (spec.most ?? Infinity) && (!spec.isWhole || Number.isInteger(number));
    return isRight ? number : null;
  };
  return html`<${NumberField} label=${name} unit=${spec.unit} step=${spec.step ?? 0.5} isEmptyAllowed=${spec.isEmptyAllowed} isSet=${name in tuning.edits}
    value=${value === null ? null : Number(value)} parse=${parse} onChange=${(/** @type {number | null} */ number) => tuning.change({ [name]: number })} />`;
}

/** @param {{text: string}} props */
function Yaml({ text }) {
  const [isCopied, setCopied] = useState(false);
  const copy = async () => {
    await navigator.clipboard?.writeText(text);
    setCopied(true);
    setTimeout(() => setCopied(false), 1500);
  };
  return html`<details class="yaml">
    <summary>As YAML</summary>
    <div class="yaml__body">
      <pre tabindex="0" aria-label="Configuration as YAML"><code>${text}</code></pre>
      <button class="button button--small" onClick=${copy}><${Icon} name=${isCopied ? "check" : "copy"} />${isCopied ? "Copied" : "Copy YAML"}</button>
    </div>
  </details>`;
}

/**
 * @param {{app: import("../core/app.js").App, dataset: string, tuning: Tuning, onClose: () => void, onSaved: (digest: string) => void, onRun: (run: Run) => void}} props
 */
export function SaveDialog({ app, dataset, tuning, onClose, onSaved, onRun }) {
  const dialog = useRef(/** @type {HTMLDialogElement | null} */ (null));
  const [isBusy, setBusy] = useState(false);
  const [error, setError] = useState(/** @type {Error | null} */ (null));
  useEffect(() => dialog.current?.showModal(), []);
  const digest = tuning.counted === tuning.tried ? (tuning.preview?.config ?? "") : "";

  /** @param {boolean} isApplied */
  const save = async (isApplied) => {
    setBusy(true);
    setError(null);
    try {
      const version = await jobs.saveConfig(dataset, tuning.tried);
      onSaved(version.digest);
      if (isApplied) onRun(await jobs.activate(dataset, version.digest));
      dialog.current?.close();
    } catch (failure) {
      app.notice(failure);
      setError(failure instanceof Error ? failure : new Error(String(failure)));
      setBusy(false);
    }
  };

  return html`<dialog class="dialog" ref=${dialog} aria-labelledby="save-title" onClose=${onClose}
    onClick=${(/** @type {MouseEvent} */ event) => event.target === dialog.current && dialog.current?.close()}>
    <div class="dialog__body">
      <header class="dialog__head">
        <h2 id="save-title">Save as new config version</h2>
        <button class="button button--quiet button--icon" aria-label="Close" onClick=${() => dialog.current?.close()}><${Icon} name="cross" /></button>
      </header>
      <p class="savedialog__digest">Version <code title=${digest}>${digest ? digest.slice(0, 16) : "…"}</code> <span class="faint">differs from the active <code>${tuning.active.digest.slice(0, 8)}</code> in:</span></p>
      <${DiffTable} rows=${differences(tuning.active.config, tuning.tried)} />
      <p class="savedialog__what">${whatText(tuning)}</p>
      ${error && html`<p class="problem" role="alert">${error.message}</p>`}
      <footer class="dialog__foot">
        <span class="faint">Versions are never changed or deleted.</span>
        <span class="savedialog__buttons">
          <button class="button" disabled=${isBusy} onClick=${() => save(false)}>Save only</button>
          <button class="button button--primary" disabled=${isBusy} onClick=${() => save(true)}>Save and apply</button>
        </span>
      </footer>
    </div>
  </dialog>`;
}

/** @param {Tuning} tuning */
function whatText({ preview }) {
  if (preview?.needs_pixels) return "Applying it measures every frame again, in the background. Until that is done nothing changes.";
  const flips = preview?.flips;
  if (!flips) return "";
  return `Applying it flips ${countText(flips.total)} boxes: ${countText(flips.kept_to_rejected)} from kept to rejected, ${countText(flips.rejected_to_kept)} from rejected to kept. Answers of people stay as they are.`;
}

/** @param {{rows: readonly import("./config.js").Difference[], names?: readonly string[]}} props */
export const DiffTable = ({ rows, names = ["Active", "New"] }) => html`<div class="tablewrap"><table class="table difftable">
  <thead><tr><th scope="col">Key</th><th scope="col">${names[0]}</th><th scope="col">${names[1]}</th></tr></thead>
  <tbody>
    ${rows.map((row) => html`<tr key=${row.path}><th scope="row"><code>${row.path}</code></th><td><del>${valueText(row.before)}</del></td><td><ins>${valueText(row.after)}</ins></td></tr>`)}
  </tbody>
</table></div>`;
