import assert from "node:assert/strict";
import { test } from "node:test";

import { optionsOf } from "../../../static/js/core/form.js";
import { countLinesOf, exportForm, fieldsFor, formatText, optionsText } from "../../../static/js/runs/exports.js";

const API = {
  components: {
    schemas: {
      ExportIn: { properties: { format: { type: "string", enum: ["yolo", "brand-new"], "x-titles": { yolo: "YOLO" }, "x-briefs": { yolo: "with data.yaml" }, "x-options": { yolo: ["split", "include"] } } } },
      ExportOptions: {
        properties: {
          include: { type: "string", enum: ["effective", "all"], "x-default": "effective", description: "Which boxes." },
          include_unmeasured: { type: "boolean", "x-default": true },
          split: { type: "array", items: { type: "number" }, "x-default": [] },
          bands: { type: "array", items: { type: "integer" }, "x-default": [] },
          brand_new: { type: "string", enum: ["a", "b"], "x-default": "a" },
          unheard_of: { type: "object", "x-default": {} },
        },
      },
    },
  },
};

test("every format of the API is offered under its title, or else under its name", () => {
  const form = exportForm(API);

  assert.deepEqual(form.formats.map(({ value, text, help }) => [value, text, help]), [["yolo", "YOLO", "with data.yaml"], ["brand-new", "brand-new", ""]]);
  assert.deepEqual(["yolo", "brand-new", "gone"].map((format) => formatText(format, form)), ["YOLO", "brand-new", "gone"]);
  assert.equal(formatText("yolo", null), "yolo");
  assert.deepEqual(exportForm({}), { formats: [], fields: [] });
});

test("every option becomes a field by its type; options of unknown types are left out", () => {
  const fields = exportForm(API).fields;

  assert.deepEqual(fields.map(({ key, kind }) => [key, kind]), [
    ["include", "choice"],
    ["include_unmeasured", "switch"],
    ["split", "numbers"],
    ["bands", "numbers"],
    ["brand_new", "choice"],
  ]);
  assert.deepEqual(fields.find(({ key }) => key === "brand_new")?.choices.map(({ text }) => text), ["a", "b"]);
  assert.equal(fields.find(({ key }) => key === "brand_new")?.text, "Brand new");
});

test("a format has the fields of its own options only", () => {
  const form = exportForm(API);
  const keys = (/** @type {string | undefined} */ format) => fieldsFor(format, form).map(({ key }) => key);

  assert.deepEqual([keys("yolo"), keys("brand-new"), keys(undefined)], [["include", "split"], [], []]);
});

test("an option that was not changed is sent with the API's default", () => {
  const { fields } = exportForm(API);
  assert.deepEqual(optionsOf(fields, { split: [1] }), { include: "effective", include_unmeasured: true, split: [1], bands: [], brand_new: "a" });
});

test("an export names its options that differ from the defaults", () => {
  const { fields } = exportForm(API);
  /** @param {Record<string, unknown>} some */
  const text = (some) => optionsText({ ...optionsOf(fields, {}), ...some }, fields);

  assert.equal(text({}), "");
  assert.equal(text({ split: [0.8, 0.1, 0.1] }), "split 80/10/10");
  assert.equal(text({ include: "all", bands: [50, 100] }), "boxes that go in: all, rejected ones too · labels per distance, metres: 50, 100");
  assert.equal(optionsText(optionsOf(fields, {}), fields.filter(({ key }) => key !== "split")), "");
  assert.equal(text({ split: [0.8, 0.2], include_unmeasured: false }), "not: unmeasured boxes, with their frames · split 80/20");
});

test("an export shows the counts of its manifest that are not zero", () => {
  const counts = countLinesOf({ frames: { in: 48, train: 35, val: 13 }, sequences: { val: 2 }, boxes: { out: 7, dropped: 2, clipped: 0 }, classes: { car: { in: 9, out: 7, dropped: 2, clipped: 0 } } });

  assert.deepEqual(counts.lines.map(({ text, count }) => `${count} ${text}`), ["48 frames", "35 in train (73 %)", "13 in val (27 %, 2 sequences)", "7 boxes written", "2 dropped"]);
  assert.deepEqual(counts.classes, [{ name: "car", counts: [9, 7, 2, 0] }]);
  const left = countLinesOf({ frames: { in: 3 }, unmeasured: { frames_left_out: 1, left_out: 4 } });
  assert.deepEqual(left.lines.map(({ text, count }) => `${count} ${text}`), ["3 frames", "1 frames left out", "4 unmeasured, left out with them"]);
  assert.deepEqual(countLinesOf({}), { lines: [], classes: [] });
});
