import assert from "node:assert/strict";
import { test } from "node:test";

import { layoutsOf, readLayout, visibleEntries } from "../../../static/js/upload/layouts.js";
import { entriesOf } from "./builders.js";

const LINE = "0 0.5 0.5 0.1 0.2\n";

/** @param {Record<string, string>} files */
async function plan(files) {
  const entries = visibleEntries(entriesOf(files));
  const [layout] = layoutsOf(entries);
  return layout ? readLayout(entries, layout) : null;
}

/** @param {any} frame */
const outline = ({ key, annotation, files }) => [key, annotation.boxes, files.image?.path, files.segmentation?.path];

test("a YOLO folder: labels, images, segmentations and the names of its classes", async () => {
  const found = await plan({ "d/data.yaml": "names: [car, van]", "d/images/1.png": "", "d/labels/1.txt": LINE, "d/seg/1.png": "", "d/README.md": "", "d/.DS_Store": "" });

  assert.equal(found?.layout, "yolo");
  assert.deepEqual(found.frames.map(outline), [["1", [{ class: "car", cxcywhn: [0.5, 0.5, 0.1, 0.2] }], "images/1.png", "1.png"]]);
  assert.deepEqual(found.unmatched, [{ path: "README.md", why: "neither an image nor a label" }]);
  assert.deepEqual(found.classes, ["car", "van"]);
});

test("a label that cannot be read is that frame's problem, and the others go", async () => {
  const found = await plan({ "classes.txt": "car\nvan", "1.txt": "7 0.5 0.5 0.1 0.2", "2.txt": LINE });

  assert.deepEqual(found?.frames.map(({ key }) => key), ["2"]);
  assert.deepEqual(found?.problems, [{ key: "1", why: "1.txt, line 1: expected a class from 0 to 1, found '7'" }]);
});

test("carlasimu: the widest band, its own classes, centres in pixels", async () => {
  const found = await plan({ "c/images/1.png": "", "c/labels/label50/1.txt": "", "c/labels/label200/1.txt": "4 .5 .5 .1 .2", "c/labels/label200/2.txt": "10 20 4 6", "c/seg/1.png": "" });

  assert.equal(found?.layout, "carlasimu");
  assert.deepEqual(found.frames.map(outline), [
    ["1", [{ class: "walker", cxcywhn: [0.5, 0.5, 0.1, 0.2] }], "1.png", "1.png"],
    ["2", [{ class: "unknown", cxcywh: [10, 20, 4, 6] }], undefined, undefined],
  ]);
});

test("a manifest: paths from its own folder; what is not there is named", async () => {
  const lines = [{ key: "a", image: "./rgb/a.png", boxes: [] }, { key: "b", image: "rgb/b.png" }, { key: "c", image: "/etc/c.png" }, { key: 5 }];
  const found = await plan({ "d/manifest.jsonl": `${lines.map((line) => JSON.stringify(line)).join("\n")}\n`, "d/rgb/a.png": "", "d/rgb/z.png": "" });

  assert.deepEqual(found?.frames.map(outline), [["a", [], "rgb/a.png", undefined]]);
  assert.deepEqual(found?.problems.map(({ why }) => why), [
    "manifest.jsonl, line 2, image: rgb/b.png is not among these files",
    "manifest.jsonl, line 3, image: /etc/c.png is not among these files",
    'manifest.jsonl, line 4: expected "key" of 1 to 512 characters, found 5',
  ]);
  assert.deepEqual(found?.unmatched, [{ path: "rgb/z.png", why: "no line of the manifest names it" }]);
});

test("pairs by stem: a folder or an ending says which is the segmentation; a .json has the boxes", async () => {
  const found = await plan({ "1.png": "", "1_seg.png": "", "1.json": '{"boxes": [{"class": "car"}]}', "2.png": "", "seg/2.png": "", "9_seg.png": "", "7.txt": LINE });

  assert.equal(found?.layout, "pairs");
  assert.deepEqual(found.frames.map(outline), [["1", [{ class: "car" }], "1.png", "1.png"], ["2", [], "2.png", "2.png"]]);
  assert.deepEqual(found.unmatched, [
    { path: "9.png", why: "no image for this segmentation" },
    { path: "7.txt", why: "labels need their class names: a data.yaml or classes.txt" },
  ]);
});

test("two layouts at once are both offered, and nothing is made of nothing", () => {
  assert.deepEqual(layoutsOf(entriesOf({ "a.xml": "", "a.txt": LINE, "classes.txt": "car" })), ["voc", "yolo"]);
  assert.deepEqual(layoutsOf(entriesOf({ "notes.md": "" })), []);
});

test("labels of KITTI and COCO are named, with the command that reads them", async () => {
  const kitti = "KITTI labels: use unghost push";
  const coco = "COCO labels: use unghost push";
  const found = await plan({ "k/image_2/0.png": "", "k/label_2/0.txt": "Car 0 0 0", "k/annotations/instances_val2017.json": "{}", "k/_annotations.coco.json": "{}" });

  assert.equal(found?.layout, "pairs");
  assert.deepEqual(new Map(found.unmatched.map(({ path, why }) => [path, why])), new Map([
    ["_annotations.coco.json", coco],
    ["annotations/instances_val2017.json", coco],
    ["label_2/0.txt", kitti],
  ]));
});
