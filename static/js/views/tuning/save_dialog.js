// @ts-check
// Before a version is stored: what differs from the active one, and its name, the digest.

import { html, useEffect, useRef, useState } from "../../html.js";
import { jobs } from "../../calls/jobs.js";
import { differences, valueText } from "../../tuning.js";
import { countText } from "../../wording.js";
import { Icon } from "../icons.js";

/** @typedef {import("./state.js").Tuning} Tuning */
/** @typedef {import("../../types_jobs.js").Run} Run */

/**
 * @param {{app: import("../../app.js").App, dataset: string, tuning: Tuning, onClose: () => void, onSaved: (digest: string) => void, onRun: (run: Run) => void}} props
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

/** @param {{rows: readonly import("../../tuning.js").Difference[], names?: readonly string[]}} props */
export const DiffTable = ({ rows, names = ["Active", "New"] }) => html`<div class="tablewrap"><table class="table difftable">
  <thead><tr><th scope="col">Key</th><th scope="col">${names[0]}</th><th scope="col">${names[1]}</th></tr></thead>
  <tbody>
    ${rows.map((row) => html`<tr key=${row.path}><th scope="row"><code>${row.path}</code></th><td><del>${valueText(row.before)}</del></td><td><ins>${valueText(row.after)}</ins></td></tr>`)}
  </tbody>
</table></div>`;
