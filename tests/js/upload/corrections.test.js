import assert from "node:assert/strict";
import { test } from "node:test";

import { columnsOf, corrected, correctionOf, descriptionOf, likelyFields, streamsWith, tableWith } from "../../../static/js/upload/corrections.js";

/** @param {string} role @param {string | null} pattern @returns {any} */
const stream = (role, pattern) => ({ role, pattern, images: 1, example: "", told_by: [] });

/** @param {string[]} place @param {string} value */
const correction = (place, value) => ({ place, value, text: "" });

const STREAMS = [stream("image", "{frame}.png"), stream("segmentation", "{frame}_a.png"), stream("other", "{frame}_flow.png"), stream("depth", null)];

test("corrections change their own keys of the description and leave all others", () => {
  const given = { boxes: { origin: "1", labels: "b" }, classes: { Misc: { accept: ["Car"] }, sign: "pole" }, key: "{frame}" };

  const description = descriptionOf(given, STREAMS, [correction(["boxes", "unit"], "shares"), correction(["classes", "Misc"], "car"), correction(["layout"], "voc")]);

  assert.deepEqual(description, { boxes: { origin: "1", labels: "b", unit: "shares" }, classes: { Misc: "car", sign: "pole" }, key: "{frame}", layout: "voc" });
  assert.equal(descriptionOf(given, STREAMS, []), given);
});

test("a role of a stream names all streams, those that are not used among them", () => {
  const asDepth = correction(["files", "{frame}_a.png"], "depth");
  const unused = correction(["files", "{frame}_flow.png"], "");
  const taken = correction(["files", "{frame}_flow.png"], "segmentation");
  const given = { files: { image: "{frame}.png", segmentation: "{frame}_a.png", labels: "{frame}.json", ignore: ["{frame}_flow.png"] } };

  assert.deepEqual(descriptionOf({}, STREAMS, [asDepth, unused]), { files: { image: "{frame}.png", depth: "{frame}_a.png", ignore: ["{frame}_flow.png"] } });
  assert.deepEqual(descriptionOf(given, STREAMS, [asDepth, taken]), {
    files: { image: "{frame}.png", labels: "{frame}.json", depth: "{frame}_a.png", segmentation: "{frame}_flow.png" },
  });
});

test("of two streams only one has a role, and those that are no longer named are not used", () => {
  const [image, tags, flow] = STREAMS;
  const asTags = correction(["files", flow.pattern], "segmentation");

  const all = corrected([correction(["files", tags.pattern], "segmentation"), correction(["files", image.pattern], "")], asTags);

  assert.deepEqual(all.map(({ place: [, pattern] }) => pattern), [image.pattern, flow.pattern]);
  const used = [{ ...flow, role: "segmentation" }];
  assert.deepEqual(streamsWith(STREAMS, used, all).map(({ role }) => role), ["", "", "segmentation", ""]);
  assert.equal(streamsWith(STREAMS, used, []), used);
});

test("a later correction of a key replaces the earlier one", () => {
  const [first, other, second] = [correction(["classes", "a"], "car"), correction(["layout"], "voc"), correction(["classes", "a"], "bus")];

  const all = corrected(corrected([first], other), second);

  assert.deepEqual(all, [other, second]);
  assert.deepEqual([correctionOf(all, ["classes", "a"]), correctionOf(all, ["classes", "b"])], ["bus", undefined]);
});

test("columns of a table are its first line's names, and a person's choice describes them", () => {
  const columns = columnsOf('\ufeff"Picture file";a0;b0;a1;b1;Kind of thing\n7.png;1;2;3;4;car\n');

  assert.deepEqual(columns, ["Picture file", "a0", "b0", "a1", "b1", "Kind of thing"]);
  assert.deepEqual(columnsOf("1,2,3,4\n5,6,7,8\n"), []);
  assert.deepEqual(columnsOf("a note, of one line"), []);
  assert.deepEqual(likelyFields(columns), { frame: "Picture file" });
  const fields = { x1: "a0", y1: "b0", x2: "a1", y2: "b1", frame: "Picture file" };
  assert.deepEqual(descriptionOf({ boxes: { unit: "pixels" } }, [], tableWith(fields)), { layout: "table", boxes: { unit: "pixels", fields } });
});
