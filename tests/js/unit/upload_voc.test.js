import assert from "node:assert/strict";
import { test } from "node:test";

import { LabelError } from "../../../static/js/upload/labels.js";
import { readVoc } from "../../../static/js/upload/voc.js";

/** @param {string} corners @param {string} [more] */
const voc = (corners, more = "") => `<?xml version="1.0"?>\n<!-- by hand -->\n<annotation verified="yes"><object>
  <name>car &amp; van</name>${more}<bndbox>${["xmin", "ymin", "xmax", "ymax"].map((tag, i) => `<${tag}>${corners.split(" ")[i]}</${tag}>`).join("\n")}</bndbox>
</object><size><width>64</width><height>36</height><depth/></size></annotation>`;

test("whole corners are counted from 1 and inclusive; what else VOC says is kept", () => {
  assert.deepEqual(readVoc(voc("1 2 10 20", "<truncated>1</truncated><pose>Left</pose><occluded/>"), "a.xml"), {
    boxes: [{ class: "car & van", xyxy: [0, 1, 10, 20], pose: "Left", truncated: 1 }],
    camera: { width: 64, height: 36 },
  });
});

test("a fraction means pixel coordinates as they are", () => {
  assert.deepEqual(readVoc(voc("1 2 10.5 20"), "a.xml").boxes, [{ class: "car & van", xyxy: [1, 2, 10.5, 20] }]);
});

for (const [text, why] of [
  ["<a>\n<b></a>", "a.xml, line 2: not XML: </a> where <b> is open"],
  ["<a>\n", "a.xml, line 2: not XML: <a> is not closed"],
  ["not xml", "a.xml, line 1: not XML: expected one element around everything"],
  ["<a b=c></a>", "a.xml, line 1: not XML: a tag is broken"],
  ["<!DOCTYPE a [<!ENTITY x 'y'>]><a>&x;</a>", "a.xml: XML with a DTD or entities is refused"],
  ["<a/>", "a.xml, line 1: expected <annotation>, found <a>"],
  ["<annotation>\n<object><name>car</name></object></annotation>", "a.xml, line 2: expected <bndbox> in the object, found none"],
  [voc("1 x 3 4"), "a.xml, line 5: expected a finite number in <ymin>, found 'x'"],
]) {
  test(`refused: ${why}`, () => assert.throws(() => readVoc(String(text), "a.xml"), new LabelError(String(why))));
}
