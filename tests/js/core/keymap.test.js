import assert from "node:assert/strict";
import { test } from "node:test";

import { DEFAULT_SETTINGS, KEYMAP, actionOf, keyText, keysIn, loadKeys, lossText, nameOf, rebind, saveKeys } from "../../../static/js/core/keymap.js";
import { memoryStorage } from "../../support/page/builders.js";

/** @param {string} key @param {object} [some] */
const press = (key, some = {}) => ({ key, shiftKey: false, ctrlKey: false, metaKey: false, altKey: false, ...some });

test("in every view, each key belongs to one action", () => {
  for (const view of ["frame", "queue", "grid"]) {
    const keys = keysIn(DEFAULT_SETTINGS, view).flatMap((row) => row.keys);
    assert.equal(new Set(keys).size, keys.length, view);
  }
  assert.deepEqual([...new Set(KEYMAP.map(({ where }) => where))], [undefined, "grid"]);
});

test("a key with a special meaning in the grid keeps its usual meaning in other views", () => {
  const actions = (/** @type {string} */ view) => [" ", "ArrowLeft", "PageDown", "Delete", "u"].map((key) => actionOf(press(key), DEFAULT_SETTINGS, view));
  assert.deepEqual(actions("frame"), ["unsure", "previous", "nextFrame", null, "unsure"]);
  assert.deepEqual(actions("grid"), ["select", "left", "pageDown", "clear", "unsure"]);
  assert.equal(actionOf(press("a", { ctrlKey: true }), DEFAULT_SETTINGS, "grid"), "selectAll");
  assert.deepEqual(keysIn(DEFAULT_SETTINGS, "grid").find(({ action }) => action === "unsure")?.keys, ["U"]);
});

test("a key that is given to an action of the grid keeps its action in other views", () => {
  const settings = rebind(DEFAULT_SETTINGS, "select", "K");
  assert.deepEqual([actionOf(press("k"), settings, "grid"), actionOf(press("k"), settings, "frame")], ["select", "keep"]);
});

test("the documented keys have their actions by default", () => {
  const promised = { a: "keep", k: "keep", x: "reject", r: "reject", " ": "unsure", z: "undo", Backspace: "undo", j: "next", ArrowRight: "next", ArrowLeft: "previous", m: "mask", "[": "opacityDown", "]": "opacityUp", v: "cycleVerdict", c: "crop", f: "fit", g: "grid", e: "comment", "?": "help", Escape: "escape" };
  for (const [key, action] of Object.entries(promised)) assert.equal(actionOf(press(key), DEFAULT_SETTINGS), action, key);
  assert.equal(actionOf(press("J", { shiftKey: true }), DEFAULT_SETTINGS), "nextUnanswered");
});

test("Shift matters for letters only", () => {
  assert.equal(nameOf(press("?", { shiftKey: true })), "?");
  assert.equal(actionOf(press("E", { shiftKey: true }), DEFAULT_SETTINGS), null);
});

test("browser shortcuts are never taken", () => {
  for (const modifier of ["ctrlKey", "metaKey", "altKey"]) assert.equal(actionOf(press("r", { [modifier]: true }), DEFAULT_SETTINGS), null);
});

test("with single-key shortcuts switched off, only keys that type no character work", () => {
  const off = { ...DEFAULT_SETTINGS, off: true };
  for (const key of ["a", " ", "?", "["]) assert.equal(actionOf(press(key), off), null, key);
  assert.equal(actionOf(press(" "), off, "grid"), "select");
  assert.equal(actionOf(press("ArrowRight"), off), "next");
  assert.equal(actionOf(press("Escape"), off), "escape");
});

test("with single-key shortcuts switched off, a letter does not work in the grid either", () => {
  const settings = { ...rebind(DEFAULT_SETTINGS, "select", "S"), off: true };
  assert.equal(actionOf(press("s"), settings, "grid"), null);
  assert.equal(actionOf(press("c"), settings, "grid"), null);
});

test("the key of an action is the first that works in the view, as it is shown", () => {
  const texts = (/** @type {import("../../../static/js/core/keymap.js").KeySettings} */ settings) => [keyText("unsure", settings, "frame"), keyText("unsure", settings, "grid"), keyText("select", settings, "grid"), keyText("escape", settings, "grid"), keyText("select", settings, "frame")];
  assert.deepEqual(texts(DEFAULT_SETTINGS), ["Space", "U", "Space", "Esc", ""]);
  assert.deepEqual(texts(rebind(DEFAULT_SETTINGS, "unsure", "Q")), ["Q", "Q", "Space", "Esc", ""]);
  assert.deepEqual(texts({ ...DEFAULT_SETTINGS, off: true }), ["", "", "Space", "Esc", ""]);
});

test("a key that is given to another action is taken from its former one", () => {
  const settings = rebind(DEFAULT_SETTINGS, "reject", "A");
  assert.equal(actionOf(press("a"), settings), "reject");
  assert.equal(actionOf(press("k"), settings), "keep");
  assert.equal(actionOf(press("x"), settings), null);
  const keys = keysIn(settings, "frame").flatMap((row) => row.keys);
  assert.equal(new Set(keys).size, keys.length);
});

test("changed keys survive a reload, and an unreadable entry of the storage is ignored", () => {
  const storage = memoryStorage();
  saveKeys(storage, rebind(DEFAULT_SETTINGS, "fit", "Q"));
  assert.equal(actionOf(press("q"), loadKeys(storage)), "fit");
  storage.setItem("unghost.keys.v1", "not json");
  assert.deepEqual(loadKeys(storage), DEFAULT_SETTINGS);
});

test("a letter that was chosen for an action works in the grid, too, and the person is told who loses it", () => {
  const settings = rebind(DEFAULT_SETTINGS, "keep", "C");
  assert.equal(actionOf(press("c"), settings, "grid"), "keep");
  assert.equal(
    lossText(DEFAULT_SETTINGS, settings, "C"),
    "C is no longer a key for: Open the box in its frame, which has no key now. " +
      "C is no longer a key for: Zoom to the box, and back, which has no key now",
  );
  assert.equal(lossText(DEFAULT_SETTINGS, rebind(DEFAULT_SETTINGS, "keep", "X"), "X"), "X is no longer a key for: Reject the box");
});

test("a key that was chosen for an action stays with it, if a later version has it as the default of another one", () => {
  const settings = { off: false, keys: { clear: ["C"] } };
  assert.equal(actionOf(press("c"), settings, "grid"), "clear");
  const keys = keysIn(settings, "grid").flatMap((row) => row.keys);
  assert.equal(new Set(keys).size, keys.length);
});
