// @ts-check
// The way in for whoever came without the login link.

import { html, useState } from "../html.js";
import { tokenOf } from "../router.js";
import { countOf } from "../wording.js";
import { useTitle, useValue } from "./hooks.js";
import { Mark } from "./icons.js";

/** @param {{app: import("../app.js").App, linkError: string}} props */
export function SignIn({ app, linkError }) {
  useTitle("Sign in");
  const { waiting } = useValue(app.saver.state);
  const ended = useValue(app.ended);
  const [error, setError] = useState(linkError);
  const [isBusy, setBusy] = useState(false);

  /** @param {SubmitEvent & {currentTarget: HTMLFormElement}} event */
  const submit = async (event) => {
    event.preventDefault();
    const text = String(new FormData(event.currentTarget).get("token") ?? "").trim();
    if (!text) return setError("Paste the token first.");
    setBusy(true);
    setError("");
    await app.signIn(tokenIn(text)).catch((refusal) => setError(refusal.message));
    setBusy(false);
  };

  return html`<main id="main" class="signin" tabindex="-1">
    <form class="signin__card" onSubmit=${submit} novalidate>
      <${Mark} />
      <h1>Sign in to Unghost</h1>
      ${ended && html`<p class="signin__note" role="status">${ended}</p>`}
      <p>Open the login link that the server printed when it started, or paste its token here.</p>
      ${waiting.size > 0 && html`<p class="signin__note" role="status">${countOf(waiting.size, "answer")} kept in this browser will be saved once you are in.</p>`}
      <label class="field">
        <span>Token</span>
        <input name="token" type="password" autocomplete="current-password" spellcheck=${false} aria-invalid=${error !== ""} aria-describedby="token-error" autofocus />
      </label>
      <p id="token-error" class="field__error" role="alert">${error}</p>
      <button class="button button--primary" disabled=${isBusy}>${isBusy ? "Signing in…" : "Sign in"}</button>
      <p class="faint">Lost the link? <code>unghost serve</code> prints it; the token lies in the file <code>token</code> of its data folder.</p>
    </form>
  </main>`;
}

/** People paste the whole link, too. @param {string} text */
function tokenIn(text) {
  const at = text.indexOf("#token=");
  return at < 0 ? text : (tokenOf(text.slice(at)) ?? text);
}
