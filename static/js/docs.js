// @ts-check
// The documentation of the API as a page. The server makes its content, for people who are signed in.

import { ApiError, json, send } from "./core/api.js";
import { createLogin } from "./core/login.js";

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

/** A link sends no session, so the page fetches the document, and the link leads to that. @param {MouseEvent} event */
async function download(event) {
  const link = /** @type {HTMLAnchorElement} */ (event.currentTarget);
  if (link.download) return;
  event.preventDefault();
  try {
    const text = JSON.stringify(await json("/openapi.json"), null, 1);
    link.href = URL.createObjectURL(new Blob([text], { type: "application/json" }));
    link.download = "openapi.json";
    link.click();
  } catch (error) {
    failed(/** @type {Error} */ (error));
  }
}

/** @param {Error} error */
const failed = (error) => say(error instanceof ApiError && error.status === 401 ? "Sign in first, then open this page again." : error.message);

async function show() {
  const answer = await send("/docs/content");
  const page = new DOMParser().parseFromString(asMarkup(await answer.text()), "text/html");
  document.title = page.title;
  document.body.replaceChildren(...page.body.childNodes);
  const link = document.querySelector('a[href="/openapi.json"]');
  if (link instanceof HTMLAnchorElement) link.addEventListener("click", download);
}

// From here on, requests carry the session of this browser.
createLogin(localStorage);

show().catch(failed);
