// @ts-check
// The way in for whoever came without the login link.

import { html, useState } from "../html.js";
import { loginOf } from "../router.js";
import { NO_TOKEN_LINKS, countOf } from "../wording.js";
import { useTitle, useValue } from "./hooks.js";
import { Mark } from "./icons.js";

/** @param {{app: import("../app.js").App, linkError: string}} props */
export function SignIn({ app, linkError }) {
  useTitle("Sign in");
  const kept = [...app.kept()];
  const ended = useValue(app.ended);
  const [error, setError] = useState(linkError);
  const [isBusy, setBusy] = useState(false);

  /** @param {SubmitEvent & {currentTarget: HTMLFormElement}} event */
  const submit = async (event) => {
    event.preventDefault();
    const text = String(new FormData(event.currentTarget).get("token") ?? "").trim();
    if (!text) return setError("Paste the token or the link first.");
    const credential = credentialIn(text);
    if (!credential) return setError(NO_TOKEN_LINKS);
    setBusy(true);
    setError("");
    await app.signIn(credential).catch((refusal) => setError(refusal.message));
    setBusy(false);
  };

  return html`<main id="main" class="signin" tabindex="-1">
    <form class="signin__card" onSubmit=${submit} novalidate>
      <${Mark} />
      <h1>Sign in to Unghost</h1>
      ${ended && html`<p class="signin__note" role="status">${ended}</p>`}
      <p>Open a login link, or paste it or a token here. <code>unghost login</code> prints a link; so does the server when it starts.</p>
      ${kept.map(([name, count]) => html`<p key=${name} class="signin__note" role="status">${countOf(count, "answer")} of ${name} kept in this browser will be saved once ${name} is in.</p>`)}
      <label class="field">
        <span>Token or login link</span>
        <input name="token" type="password" autocomplete="current-password" spellcheck=${false} aria-invalid=${error !== ""} aria-describedby="token-error" autofocus />
      </label>
      <p id="token-error" class="field__error" role="alert">${error}</p>
      <button class="button button--primary" disabled=${isBusy}>${isBusy ? "Signing in…" : "Sign in"}</button>
      <p class="faint">A link works once, within ten minutes.</p>
    </form>
  </main>`;
}

/** People paste the whole link, too; null: one of those that are no longer used. @param {string} text @returns {import("../types.js").Credential | null} */
function credentialIn(text) {
  const login = loginOf(text.slice(Math.max(0, text.indexOf("#"))));
  if (login?.kind === "token") return null;
  if (login) return { code: login.secret };
  return text.startsWith("uc_") ? { code: text } : { token: text };
}
