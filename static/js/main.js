// @ts-check
// Puts the page together: app, boxes, answers, uploads, shell.

import { createBoxes } from "./boxes/store.js";
import { createApp } from "./core/app.js";
import { h, render } from "./core/html.js";
import { watchKeys } from "./core/keymap.js";
import { NO_TOKEN_LINKS } from "./core/login.js";
import { watchTheme } from "./core/prefs.js";
import { loginOf } from "./core/router.js";
import { nameThisTab } from "./core/tab.js";
import { createAnswers } from "./review/answers.js";
import { Shell } from "./shell/shell.js";
import { createUploads, uploadCalls } from "./upload/uploader.js";

/** @param {string} id */
function element(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`index.html has no #${id}`);
  return found;
}

/**
 * The credential of a login link. It is removed from the address and the history before anything else happens.
 * @param {string} [before]  the address before, to which the page returns
 */
function takeLogin(before = "") {
  const login = loginOf(location.hash);
  if (login) history.replaceState(null, "", login.to || (before.startsWith("#/") ? before : "#/datasets"));
  return login;
}

/** @param {NonNullable<ReturnType<typeof loginOf>>} login @returns {Promise<string>} why it does not sign in */
async function signIn({ kind, secret }) {
  if (kind === "token") return NO_TOKEN_LINKS;
  return app.signInByLink({ code: secret }).then(
    () => "",
    (error) => error.message,
  );
}

const first = takeLogin();

const core = createApp(localStorage);
const answers = createAnswers(core, createBoxes(), localStorage, await nameThisTab());
const app = { ...core, ...answers, uploads: createUploads(uploadCalls, core.isSignedIn) };

const linkError = first ? await signIn(first) : "";

watchTheme(app.prefs);

watchKeys(app);

render(h(Shell, { app, linkError }), element("app"));

if (app.isSignedIn.get()) {
  if (linkError) app.refuse(linkError);
  // Who has just signed in is known.
  if (!first || linkError || app.newcomer.get()) void app.greet();
  void app.resume();
}

// A login link opened over the running page.
addEventListener("hashchange", async ({ oldURL }) => {
  const login = takeLogin(new URL(oldURL).hash);
  if (!login) return;
  app.router.read();
  const error = await signIn(login);
  if (error) app.refuse(error);
});
