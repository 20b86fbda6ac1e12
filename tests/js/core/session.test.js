import assert from "node:assert/strict";
import { test } from "node:test";

import { own, unowned } from "../../../static/js/review/outbox.js";
import { SESSION_KEY, createSession } from "../../../static/js/core/connection.js";
import { memoryStorage } from "../builders.js";

/** @param {string} name @param {string} [session] */
const of = (name, session = `us_${name}`) => ({ session, name, role: "reviewer", expires_at: null });

test("a session outlives its page and is one for all tabs", () => {
  const storage = memoryStorage();
  const one = createSession(storage);
  assert.deepEqual([one.current.get(), one.owner()], [null, ""]);

  assert.equal(one.keep(of("ada")), true);

  assert.deepEqual(createSession(storage).current.get(), of("ada"));
  assert.equal(one.owner(), "ada");
});

test("a page never turns into another person's", () => {
  const storage = memoryStorage();
  const tab = createSession(storage);
  tab.keep(of("ada"));

  createSession(memoryStorage());
  storage.setItem(SESSION_KEY, JSON.stringify(of("bo")));

  assert.equal(tab.follow(), false);
  assert.deepEqual([tab.current.get()?.name, tab.owner()], ["ada", "ada"]);
});

test("signed out in one tab is signed out in the other, who may come back", () => {
  const storage = memoryStorage();
  const one = createSession(storage);
  one.keep(of("ada"));
  const other = createSession(storage);

  one.end();
  assert.equal(other.follow(), true);
  assert.deepEqual([other.current.get(), other.owner()], [null, "ada"]);

  assert.equal(other.keep(of("ada", "us_new")), true);
  assert.equal(one.follow(), true);
  assert.equal(one.current.get()?.session, "us_new");
});

test("a session that has ended does not take the next one with it", () => {
  const storage = memoryStorage();
  const late = createSession(storage);
  late.keep(of("ada", "us_old"));
  storage.setItem(SESSION_KEY, JSON.stringify(of("ada", "us_new")));

  assert.equal(late.end(), true);

  assert.equal(late.current.get()?.session, "us_new");
});

test("rubbish in the storage is no session", () => {
  for (const text of ["{", "7", "null", "{}", '{"session": 7, "name": "ada"}']) {
    const storage = memoryStorage();
    storage.setItem(SESSION_KEY, text);
    assert.equal(createSession(storage).current.get(), null, text);
  }
});

test("answers without a name wait until somebody says that they are theirs", () => {
  const storage = memoryStorage();
  storage.setItem("unghost.outbox.v1.a", JSON.stringify({ boxId: 1 }));
  storage.setItem("unghost.bulk.v1.b", JSON.stringify({ key: "b", person: "bo" }));
  storage.setItem("unghost.prefs", JSON.stringify({}));

  assert.deepEqual(unowned(storage).map(({ name }) => name), ["unghost.outbox.v1.a"]);
  own(storage, "ada");

  assert.deepEqual(unowned(storage), []);
  assert.equal(JSON.parse(storage.getItem("unghost.outbox.v1.a") ?? "").person, "ada");
  assert.equal(JSON.parse(storage.getItem("unghost.bulk.v1.b") ?? "").person, "bo");
});
