import assert from "node:assert/strict";
import { test } from "node:test";

import { LabelError, readCarlasimuNames, readLabelLines, readYamlNames } from "../../../static/js/upload/labels.js";
import { joined } from "../../../static/js/upload/manifest.js";

test("a sixth column is the confidence, and empty lines are none", () => {
  assert.deepEqual(readLabelLines("\ufeff1 .5 .5 1e-1 .2 0.9\r\n\r\n", "1.txt", ["car", "van"]), [{ class: "van", cxcywhn: [0.5, 0.5, 0.1, 0.2], confidence: 0.9 }]);
});

for (const [line, why] of [
  ["0 1 2", "a.txt, line 1: expected 'class cx cy w h' (5 columns) or 'cx cy w h' in pixels (4 columns), found 3 columns"],
  ["car 1 2 3 4", "a.txt, line 1: expected a class from 0 to 0, found 'car'"],
  ["0 1 nan 3 4", "a.txt, line 1: expected a finite number, found 'nan'"],
]) {
  test(`${line} is refused, with its place`, () => {
    assert.throws(() => readLabelLines(line, "a.txt", ["car"]), new LabelError(why));
  });
}

for (const text of [
  "train: x\nnames: [car, 'street light']  # two\nnc: 2",
  "names:\n  - car\n  - street light\nnc: 2",
  "names:\n  0: car\n  1: \"street light\"\n\npath: .",
  "names: {0: car, 1: street light}",
  "names: [\n  car,\n  street light,\n]",
]) {
  test(`class names of ${JSON.stringify(text)}`, () => assert.deepEqual(readYamlNames(text, "data.yaml"), ["car", "street light"]));
}

test("numbers with a gap, and a document without names, are refused", () => {
  assert.throws(() => readYamlNames("names:\n  0: car\n  2: van", "data.yaml"), LabelError);
  assert.throws(() => readYamlNames("nc: 2", "data.yaml"), new LabelError("data.yaml: expected a list of class names under 'names'"));
});

test("carlasimu's readme gives its classes; any other readme is one", () => {
  assert.deepEqual(readCarlasimuNames('{"classes": {"van": 1, "car": 0}}'), ["car", "van"]);
  assert.equal(readCarlasimuNames("# My data")[4], "walker");
});

for (const [folder, path, found] of [
  ["", "rgb/./a.png", "rgb/a.png"],
  ["d/", "../rgb\\a.png", "rgb/a.png"],
  ["", "../a.png", null],
  ["", "C:/a.png", null],
]) {
  test(`${path} from "${folder}" is ${found}`, () => assert.equal(joined(String(folder), String(path)), found));
}
