import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";

import { archiveOf, linesOf, planOf, topOf, visibleEntries } from "../../../static/js/upload/folder.js";
import { entriesOf } from "../../support/page/builders.js";

const never = new AbortController().signal;
const silent = () => {};

/** Unpack an archive with the system's tar; gives a function that reads one of its files. @param {Blob} archive */
async function unpacked(archive) {
  const folder = mkdtempSync(join(tmpdir(), "folder-"));
  execFileSync("tar", ["-x", "-C", folder], { input: new Uint8Array(await archive.arrayBuffer()) });
  return (/** @type {string} */ name) => readFileSync(join(folder, name), "utf8");
}

test("the archive holds texts whole, pictures empty, and of KITTI's pictures the part with their size", async () => {
  const long = `street/${"straße/".repeat(14)}labels/1.txt`;
  const files = { [long]: "0 .5 .5 .1 .2\n", "street/images/1.png": "pixels", "street/data.yaml": "names: [car]", "k/image_2/0.png": "x".repeat(500), "k/image_2/0.JPG": "y".repeat(70_000), "a.bin": "b" };

  const read = await unpacked(await archiveOf(entriesOf(files), never, silent));

  assert.equal(read(long), files[long]);
  assert.equal(read("street/data.yaml"), "names: [car]");
  assert.deepEqual(["street/images/1.png", "a.bin"].map(read), ["", ""]);
  assert.deepEqual(["k/image_2/0.png", "k/image_2/0.JPG"].map((name) => read(name).length), [24, 65_536]);
});

test("collecting labels reports how many are done, and can be aborted", async () => {
  const files = Object.fromEntries(Array.from({ length: 250 }, (_, i) => [`${i}.txt`, "x"]));
  const stop = new AbortController();
  /** @type {number[][]} */
  const told = [];

  await archiveOf(entriesOf({ ...files, "a.png": "" }), never, (...counts) => told.push(counts));
  stop.abort();

  assert.deepEqual(told, [[100, 250], [200, 250]]);
  await assert.rejects(archiveOf(entriesOf(files), stop.signal, silent), { name: "AbortError" });
});

test("an error names a label file that can no longer be read", async () => {
  const gone = Object.assign(new Blob(["x"]), { arrayBuffer: () => Promise.reject(new Error("NotFound")) });
  const entry = { path: "labels/1.txt", size: 1, blob: Object.assign(new Blob(), { slice: () => gone }) };

  await assert.rejects(archiveOf([entry], never, silent), /labels\/1.txt can no longer be read/);
});

const HEAD = { layout: "voc", layouts: ["voc", "yolo"], titles: { voc: "Pascal VOC", yolo: "YOLO" }, classes: null, count: 2 };
const END = { end: true, frames: 2, faulty: 1, unmatched: 1, notes: [] };

/** @param {unknown[]} lines */
const answering = (lines) => linesOf(new Response(lines.map((line) => `${JSON.stringify(line)}\n`).join("")));

test("the server's lines become frames with their files, problems, and files that belong to no frame", async () => {
  const entries = entriesOf({ "t/ä.png": "", "t/ä.xml": "", "t/b.md": "" });
  const frame = { key: "ä", annotation: { boxes: [] }, annotation_text: "{}", files: { image: "t/ä.png" }, fault: null };
  const faulty = { key: "b", annotation: null, files: {}, fault: { pointer: "", code: "bad_layout", detail: "b.xml, line 1: not XML" } };
  const lost = { ...frame, key: "c", files: { image: "t/c.png" } };
  const stray = { path: "b.md", why: "neither an image nor a label" };

  const plan = await planOf(answering([HEAD, frame, faulty, lost, stray, END]), entries, silent);

  assert.deepEqual([plan.layout, plan.layouts, plan.titles], ["voc", ["voc", "yolo"], HEAD.titles]);
  assert.deepEqual(plan.frames, [{ key: "ä", annotation: { boxes: [] }, text: "{}", files: { image: entries[0] } }]);
  assert.deepEqual(plan.problems, [{ key: "b", why: "b.xml, line 1: not XML" }, { key: "c", why: "t/c.png is not among these files" }]);
  assert.deepEqual(plan.unmatched, [stray]);
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
