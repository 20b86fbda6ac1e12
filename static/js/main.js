// @ts-check
// Puts the page together. Nothing else reaches into the document by an id.

import { api } from "./api.js";
import { createApp } from "./app.js";
import { h, render } from "./html.js";
import { loginOf } from "./router.js";
import { watchKeys } from "./keys.js";
import { watchTheme } from "./theme.js";
import { NO_TOKEN_LINKS } from "./wording.js";
import { Shell } from "./views/shell.js";

/** @param {string} id */
function element(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`index.html has no #${id}`);
  return found;
}

/** What a login link carries, taken out of the address and the history before anything else. */
function takeLogin() {
  const login = loginOf(location.hash);
  if (login) history.replaceState(null, "", "#/datasets");
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
const app = await createApp(api, localStorage);
const linkError = first ? await signIn(first) : "";
watchTheme(app.prefs);
watchKeys(app);
render(h(Shell, { app, linkError }), element("app"));
if (app.isSignedIn.get()) {
  if (linkError) app.toasts.show(linkError, { kind: "error" });
  void app.greet();
  app.offerUnowned();
  void app.saver.resume();
  app.bulk.resume();
}
// A login link opened over the running page.
addEventListener("hashchange", async () => {
  const login = takeLogin();
  if (!login) return;
  app.router.read();
  const error = await signIn(login);
  if (error) app.refuse(error);
});
