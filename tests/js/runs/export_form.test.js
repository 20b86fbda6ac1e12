import assert from "node:assert/strict";
import { test } from "node:test";

import { countLinesOf, exportForm, formatText, optionsText } from "../../../static/js/runs/exports.js";
import { optionsOf, parseNumbers } from "../../../static/js/core/form.js";
import { splitText, tookText } from "../../../static/js/core/numbers.js";
import { sizeText } from "../../../static/js/core/numbers.js";

const API = {
  components: {
    schemas: {
      ExportIn: { properties: { format: { type: "string", enum: ["yolo", "brand-new"], "x-titles": { yolo: "YOLO" }, "x-briefs": { yolo: "with data.yaml" } } } },
      ExportOptions: {
        properties: {
          include: { type: "string", enum: ["effective", "all"], default: "effective", description: "Which boxes." },
          include_unmeasured: { type: "boolean", default: false },
          split: { type: "number", minimum: 0, maximum: 1, default: 0.8 },
          bands: { type: "array", items: { type: "integer" }, default: [] },
          brand_new: { type: "string", enum: ["a", "b"], default: "a" },
          unheard_of: { type: "object", default: {} },
        },
      },
    },
  },
};

test("every format that the API names is offered under its title there, or by its name", () => {
  const form = exportForm(API);

  assert.deepEqual(form.formats.map(({ value, text, help }) => [value, text, help]), [["yolo", "YOLO", "with data.yaml"], ["brand-new", "brand-new", ""]]);
  assert.deepEqual(["yolo", "brand-new", "gone"].map((format) => formatText(format, form)), ["YOLO", "brand-new", "gone"]);
  assert.equal(formatText("yolo", null), "yolo");
  assert.deepEqual(exportForm({}), { formats: [], fields: [] });
});

test("every option is a field of its kind; what the page cannot ask for is left alone", () => {
  const fields = exportForm(API).fields;

  assert.deepEqual(fields.map(({ key, kind }) => [key, kind]), [
    ["include", "choice"],
    ["include_unmeasured", "switch"],
    ["split", "number"],
    ["bands", "numbers"],
    ["brand_new", "choice"],
  ]);
  assert.deepEqual(fields.find(({ key }) => key === "brand_new")?.choices.map(({ text }) => text), ["a", "b"]);
  assert.equal(fields.find(({ key }) => key === "brand_new")?.text, "Brand new");
});

test("what was not touched is sent as the API proposes it", () => {
  const { fields } = exportForm(API);
  assert.deepEqual(optionsOf(fields, { split: 1 }), { include: "effective", include_unmeasured: false, split: 1, bands: [], brand_new: "a" });
});

test("an export says how it differs from the usual one", () => {
  const { fields } = exportForm(API);
  /** @param {Record<string, unknown>} some */
  const text = (some) => optionsText({ ...optionsOf(fields, {}), ...some }, fields);

  assert.equal(text({}), "split 80/20");
  assert.equal(text({ include: "all", bands: [50, 100] }), "split 80/20 · boxes that go in: all, rejected ones too · labels per distance, metres: 50, 100");
  assert.equal(text({ split: 1, include_unmeasured: true }), "unmeasured boxes, too · no split");
});

test("distances are numbers between commas, or not taken", () => {
  assert.deepEqual(parseNumbers("50, 100;200"), [50, 100, 200]);
  assert.deepEqual(parseNumbers(" "), []);
  assert.equal(parseNumbers("50, far"), null);
});

test("sizes, shares and times are short", () => {
  assert.deepEqual([null, 999, 1200, 62092203, 4.2e9].map(sizeText), ["–", "999 B", "1.2 kB", "62 MB", "4.2 GB"]);
  assert.equal(splitText(0.8), "80/20");
  const at = (/** @type {number} */ seconds) => tookText("2026-01-01T00:00:00Z", new Date(Date.UTC(2026, 0, 1, 0, 0, seconds)).toISOString());
  assert.deepEqual([0, 3, 42, 200].map(at), ["under 0.1 s", "3.0 s", "42 s", "3 min 20 s"]);
  assert.equal(tookText("2026-01-01T00:00:00Z", null), "");
});

test("the counts of an export are those of its manifest, and not what there is none of", () => {
  const counts = countLinesOf({ frames: { in: 48, train: 35, val: 13 }, boxes: { out: 7, dropped: 2, clipped: 0 }, classes: { car: { in: 9, out: 7, dropped: 2, clipped: 0 } } });

  assert.deepEqual(counts.lines.map(({ text, count }) => `${count} ${text}`), ["48 frames", "35 to train", "13 to validate", "7 boxes written", "2 dropped"]);
  assert.deepEqual(counts.classes, [{ name: "car", counts: [9, 7, 2, 0] }]);
  assert.deepEqual(countLinesOf({}), { lines: [], classes: [] });
});
