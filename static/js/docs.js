// @ts-check
// The documentation of the API as a page. The server makes its content, for people who are signed in.

import { ApiError, send, setSession } from "./core/api.js";
import { createSession } from "./core/connection.js";

/** @param {string} words @param {string} [href] */
function say(words, href) {
  const text = document.createElement("p");
  text.textContent = words;
  const link = document.createElement("a");
  link.href = href ?? "/";
  link.textContent = "Unghost";
  document.body.replaceChildren(text, link);
}

/**
 * Text that the server made, as the content security policy wants markup to be named.
 * @param {string} text
 * @returns {string}
 */
function asMarkup(text) {
  const { trustedTypes } = /** @type {any} */ (globalThis);
  const policy = trustedTypes?.createPolicy("api-docs", { createHTML: String });
  return policy ? policy.createHTML(text) : text;
}

async function show() {
  const answer = await send("/docs/content");
  const page = new DOMParser().parseFromString(asMarkup(await answer.text()), "text/html");
  document.title = page.title;
  document.body.replaceChildren(...page.body.childNodes);
  // A link sends no session either: it gets the document itself as a blob.
  const machine = document.querySelector('a[href="/openapi.json"]');
  if (machine instanceof HTMLAnchorElement) {
    const text = JSON.stringify(await (await send("/openapi.json")).json(), null, 1);
    machine.href = URL.createObjectURL(new Blob([text], { type: "application/json" }));
    machine.download = "openapi.json";
  }
}

setSession(createSession(localStorage).current.get()?.session ?? "");

show().catch((error) => say(error instanceof ApiError && error.status === 401 ? "Sign in first, then open this page again." : error.message));
