// @ts-check
// Puts the page together: app, boxes, answers, uploads, shell.

import { createBoxes } from "./boxes/store.js";
import { createApp } from "./core/app.js";
import { h, render } from "./core/html.js";
import { watchKeys } from "./core/keymap.js";
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
 * The code of a login link. It is removed from the address and the history before anything else happens.
 * @param {string} [before]  the address before, to which the page returns
 */
function takeLogin(before = "") {
  const login = loginOf(location.hash);
  if (login) history.replaceState(null, "", login.to || (before.startsWith("#/") ? before : "#/datasets"));
  return login?.code ?? "";
}

/** @param {string} code @returns {Promise<string>} why it does not sign in */
const signIn = (code) =>
  app.signInByLink({ code }).then(
    () => "",
    (error) => error.message,
  );

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
  const code = takeLogin(new URL(oldURL).hash);
  if (!code) return;
  app.router.read();
  const error = await signIn(code);
  if (error) app.refuse(error);
});
