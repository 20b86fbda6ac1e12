// @ts-check
// The versions that are stored: each can be tried, and made the active one.

import { html, useState } from "../../html.js";
import { jobs } from "../../calls/jobs.js";
import { differences, editsBetween, valueText } from "../../tuning.js";
import { agoText, countOf } from "../../wording.js";
import { useLoaded } from "../hooks.js";

/** @typedef {import("./state.js").Tuning} Tuning */
/** @typedef {import("../../types_jobs.js").ConfigVersion} ConfigVersion */

const SHOWN = 50;

/**
 * @param {{app: import("../../app.js").App, dataset: string, tuning: Tuning, saved: number, isRunning: boolean,
 *   onRun: (run: import("../../types_jobs.js").Run) => void}} props
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
