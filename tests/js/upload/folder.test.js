import assert from "node:assert/strict";
import { test } from "node:test";

import { sizesOf } from "../../../static/js/upload/archive.js";
import { linesOf, planOf, topOf, visibleEntries, withSizes } from "../../../static/js/upload/folder.js";
import { entriesOf } from "../../support/page/builders.js";

const silent = () => {};

const HEAD = { layout: "voc", layouts: ["voc", "yolo"], titles: { voc: "Pascal VOC", yolo: "YOLO" }, classes: null, count: 2 };
const END = { end: true, frames: 2, faulty: 1, unmatched: 1, notes: [], inspection: { looked_at: 2 } };

/** @param {unknown[]} lines */
const answering = (lines) => linesOf(new Response(lines.map((line) => `${JSON.stringify(line)}\n`).join("")));

test("the server's lines become frames with their files, problems, and files that belong to no frame", async () => {
  const entries = entriesOf({ "t/ä.png": "x", "t/ä.xml": "", "t/b.md": "" });
  const frame = { key: "ä", annotation: { boxes: [] }, annotation_text: "{}", files: { image: "t/ä.png" }, fault: null };
  const faulty = { key: "b", annotation: null, files: {}, fault: { pointer: "", code: "bad_layout", detail: "b.xml, line 1: not XML" } };
  const lost = { ...frame, key: "c", files: { image: "t/c.png" } };
  const stray = { path: "b.md", why: "neither an image nor a label" };

  const plan = await planOf(answering([HEAD, frame, faulty, lost, stray, END]), entries, silent);

  assert.deepEqual([plan.layout, plan.layouts, plan.titles], ["voc", ["voc", "yolo"], HEAD.titles]);
  assert.deepEqual(plan.frames, [{ key: "ä", annotation: { boxes: [] }, text: "{}", files: { image: entries[0] } }]);
  assert.deepEqual(plan.problems, [{ key: "b", why: "b.xml, line 1: not XML" }, { key: "c", why: "t/c.png is not among these files" }]);
  assert.deepEqual([plan.unmatched, plan.inspection], [[stray], END.inspection]);
});

test("a frame with an empty file becomes a problem once the sizes are known", async () => {
  const entries = entriesOf({ "a.png": "x", "b.png": "" });
  const lines = ["a", "b"].map((key) => ({ key, annotation: { boxes: [] }, annotation_text: null, files: { image: `${key}.png` }, fault: null }));
  const plan = await planOf(answering([HEAD, ...lines, END]), entries, silent);

  const sized = withSizes(plan, await sizesOf(entries, new AbortController().signal));

  assert.deepEqual(sized.frames.map(({ key }) => key), ["a"]);
  assert.deepEqual(sized.problems, [{ key: "b", why: "b.png has 0 bytes" }]);
});

test("a response that was cut off is an error", async () => {
  await assert.rejects(planOf(answering([HEAD]), [], silent), /cut off/);
});

test("hidden files are left out, and the one folder around all files gives its name", () => {
  const entries = visibleEntries(entriesOf({ "town/a.png": "", "town/.git/x.txt": "", "town/b/c.png": "", "__MACOSX/town/._a.png": "" }));

  assert.deepEqual(entries.map(({ path }) => path), ["town/a.png", "town/b/c.png"]);
  assert.equal(topOf(entries), "town");
  assert.deepEqual([topOf(entriesOf({ "images/a.png": "", "seg/a.png": "" })), topOf(entriesOf({ "a.png": "" })), topOf([])], ["", "", ""]);
});
