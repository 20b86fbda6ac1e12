import assert from "node:assert/strict";
import { test } from "node:test";

import { SESSION_KEY, createLogin, endedText } from "../../../static/js/core/login.js";
import { memoryStorage } from "../../support/page/builders.js";

/** @param {string} name @param {string} [session] */
const of = (name, session = `us_${name}`) => ({ session, name, role: "reviewer", expires_at: null });

test("a session is stored for all tabs, and for the page after a reload", () => {
  const storage = memoryStorage();
  const one = createLogin(storage);
  assert.deepEqual([one.current.get(), one.owner()], [null, ""]);

  assert.equal(one.keep(of("ada")), true);

  const { pictures, ...kept } = createLogin(storage).current.get() ?? {};
  assert.deepEqual([kept, pictures], [of("ada"), one.current.get()?.pictures]);
  assert.match(pictures ?? "", /^[a-z0-9]+$/);
  assert.equal(one.owner(), "ada");
});

test("a page does not take over another person's session", () => {
  const storage = memoryStorage();
  const tab = createLogin(storage);
  tab.keep(of("ada"));

  createLogin(memoryStorage());
  storage.setItem(SESSION_KEY, JSON.stringify(of("bo")));

  assert.equal(tab.follow(), false);
  assert.deepEqual([tab.current.get()?.name, tab.owner()], ["ada", "ada"]);
});

test("signing out in one tab signs out the others, where the same person may sign in again", () => {
  const storage = memoryStorage();
  const one = createLogin(storage);
  one.keep(of("ada"));
  const other = createLogin(storage);

  one.end();
  assert.equal(other.follow(), true);
  assert.deepEqual([other.current.get(), other.owner()], [null, "ada"]);

  assert.equal(other.keep(of("ada", "us_new")), true);
  assert.equal(one.follow(), true);
  assert.equal(one.current.get()?.session, "us_new");
});

test("the end of an old session keeps a newer one that another tab has stored", () => {
  const storage = memoryStorage();
  const late = createLogin(storage);
  late.keep(of("ada", "us_old"));
  storage.setItem(SESSION_KEY, JSON.stringify(of("ada", "us_new")));

  assert.equal(late.end(), true);

  assert.equal(late.current.get()?.session, "us_new");
});

test("a stored text that is not a session is ignored", () => {
  for (const text of ["{", "7", "null", "{}", '{"session": 7, "name": "ada"}']) {
    const storage = memoryStorage();
    storage.setItem(SESSION_KEY, text);
    assert.equal(createLogin(storage).current.get(), null, text);
  }
});

test("the reason why a session ended is shown if it is known", () => {
  assert.match(endedText("token_expired"), /has expired/);
  assert.match(endedText("token_revoked"), /revoked/);
  assert.match(endedText("session_expired"), /has ended/);
  assert.equal(endedText("unauthorised"), "");
  assert.equal(endedText(undefined), "");
});
