// @ts-check
// Puts the page together. Nothing else reaches into the document by an id.

import { api } from "./api.js";
import { createApp } from "./app.js";
import { h, render } from "./html.js";
import { tokenOf } from "./router.js";
import { watchKeys } from "./keys.js";
import { watchTheme } from "./theme.js";
import { Shell } from "./views/shell.js";

/** @param {string} id */
function element(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`index.html has no #${id}`);
  return found;
}

/** Use a login link's token, once, and never leave it in the address or the history. */
async function signInByLink() {
  const token = tokenOf(location.hash);
  if (!token) return "";
  history.replaceState(null, "", "#/datasets");
  try {
    await api.signIn(token);
    return "";
  } catch (error) {
    return error instanceof Error ? error.message : String(error);
  }
}

const linkError = await signInByLink();
const app = await createApp(api, localStorage);
if (linkError) app.isSignedIn.set(false);
watchTheme(app.prefs);
watchKeys(app);
render(h(Shell, { app, linkError }), element("app"));
if (!linkError) void app.greet();
void app.saver.resume();
app.bulk.resume();
// A login link opened over the running page: start again with it.
addEventListener("hashchange", () => tokenOf(location.hash) && location.reload());
