import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";

import { archiveOf, pack, sampleOf } from "../../../static/js/upload/archive.js";
import { contentOf } from "../../../static/js/upload/uploader.js";
import { entriesOf } from "../../support/page/builders.js";

const never = new AbortController().signal;
const silent = () => {};

/** Unpack an archive with the system's tar; gives a function that reads one of its files. @param {Blob} archive */
async function unpacked(archive) {
  const folder = mkdtempSync(join(tmpdir(), "folder-"));
  execFileSync("tar", ["-x", "-C", folder], { input: new Uint8Array(await archive.arrayBuffer()) });
  return (/** @type {string} */ name) => readFileSync(join(folder, name), "utf8");
}

/** So many images of a kind: `rgb/000.png`, `rgb/001.png`. @param {string} before @param {number} count @param {string} [after] @returns {Record<string, string>} */
const numbered = (before, count, after = ".png") => Object.fromEntries(Array.from({ length: count }, (_, i) => [`${before}${String(i).padStart(3, "0")}${after}`, "pixels"]));

test("the archive holds texts and a sample of the images whole, other images empty, and of KITTI's the part with their size", async () => {
  const long = `street/${"straße/".repeat(14)}labels/1.txt`;
  const kitti = { "k/image_2/001x.png": "x".repeat(500), "k/image_2/001y.JPG": "y".repeat(70_000) };
  const files = { [long]: "0 .5 .5 .1 .2\n", "street/data.yaml": "names: [car]", "a.bin": "b", ...numbered("street/images/", 100), ...numbered("k/image_2/", 50, "x.png"), ...numbered("k/image_2/", 50, "y.JPG"), ...kitti };

  const read = await unpacked(archiveOf(await pack(entriesOf(files), "", never, silent), "", null));

  assert.equal(read(long), files[long]);
  assert.equal(read("street/data.yaml"), "names: [car]");
  assert.deepEqual(["street/images/000.png", "street/images/099.png", "street/images/050.png", "a.bin"].map(read), ["pixels", "pixels", "", ""]);
  assert.deepEqual(["k/image_2/001x.png", "k/image_2/001y.JPG"].map((name) => read(name).length), [24, 65_536]);
});

test("a corrected description takes the place of the dropped one, and leaves it as it is otherwise", async () => {
  const packed = await pack(entriesOf({ "t/recording.yaml": "layout: yolo", "t/labels/recording.yaml": "x", "t/1.png": "" }), "t", never, silent);

  const read = await Promise.all([null, { layout: "voc" }].map((description) => unpacked(archiveOf(packed, "t", description))));

  assert.deepEqual(read.map((of) => of("t/recording.yaml")), ["layout: yolo", '{"layout":"voc"}']);
  assert.deepEqual(read.map((of) => of("t/labels/recording.yaml")), ["x", "x"]);
});

test("the sample has the same frames of each kind, evenly spread, and words of folders are not looked at", async () => {
  const files = { ...numbered("t/depth_16/", 100), ...numbered("t/rgb", 100, ".jpg"), ...numbered("t/7_", 60, "_semseg.png"), "t/map.png": "", "t/rf/beefcafe0123.png": "", "t/rf/0123456789ab.png": "" };

  const sample = [...(await sampleOf(entriesOf(files)))].map(({ path }) => path);

  const frames = (/** @type {RegExp} */ kind) => sample.flatMap((path) => kind.exec(path)?.[1] ?? []);
  const spread = ["000", "014", "028", "042", "057", "071", "085", "099"];
  assert.deepEqual([frames(/depth_16.(\d+)/), frames(/rgb(\d+)/)], [spread, spread]);
  assert.deepEqual(frames(/7_(\d+)_semseg/).length, 8);
  assert.deepEqual(sample.filter((path) => !/depth|rgb|semseg/.test(path)), ["t/rf/0123456789ab.png", "t/rf/beefcafe0123.png", "t/map.png"]);
});

test("a sample of large images has fewer of them, and one of images without a common name is bounded", async () => {
  const ofMiB = (/** @type {number} */ size) => entriesOf(numbered("t/", 20)).map(({ path }) => ({ path, open: async () => new Blob([new Uint8Array(size * 1024 * 1024)]) }));
  const words = entriesOf(Object.fromEntries(Array.from({ length: 200 }, (_, i) => [`t/${"x".repeat(i + 1)}.png`, ""])));

  const samples = await Promise.all([ofMiB(10), words, ofMiB(40)].map(sampleOf));

  assert.deepEqual(samples.map(({ size }) => size), [2, 8, 0]);
});

test("collecting labels reports how many are done, and can be aborted", async () => {
  const files = Object.fromEntries(Array.from({ length: 250 }, (_, i) => [`${i}.txt`, "x"]));
  const stop = new AbortController();
  /** @type {number[][]} */
  const told = [];

  await pack(entriesOf({ ...files, "a.bin": "" }), "", never, (...counts) => told.push(counts));
  stop.abort();

  assert.deepEqual([told.length, told.at(-1)], [4, [250, 250]]);
  await assert.rejects(pack(entriesOf(files), "", stop.signal, silent), { name: "AbortError" });
});

test("an error names a label file that can no longer be read", async () => {
  const blob = Object.assign(new Blob(["x"]), { arrayBuffer: () => Promise.reject(new Error("NotFound")) });

  await assert.rejects(pack([{ path: "labels/1.txt", open: () => Promise.reject(new Error("NotFound")) }], "", never, silent), /labels\/1.txt can no longer be read/);
  await assert.rejects(contentOf({ path: "labels/1.txt", open: async () => blob }), /labels\/1.txt can no longer be read/);
});
