import assert from "node:assert/strict";
import { test } from "node:test";

import { fieldsOf, parseNumber, parseNumbers, parsePairs, rangeText } from "../../../static/js/core/form.js";

/** @param {Record<string, unknown>} properties */
const described = (properties) => fieldsOf({ components: { schemas: { Thing: { properties } } } }, "Thing");

test("a field takes its range, unit, default and help from the API's description", () => {
  const [field] = described({
    min_points: { type: ["integer", "null"], minimum: 0, maximum: 9, "x-unit": "points", "x-needs-pixels": true, "x-evidence": ["lidar"], "x-default": 5, description: "Fewest points." },
  });

  assert.deepEqual(
    field,
    {
      key: "min_points", kind: "number", text: "Min points", help: "Fewest points.", initial: 5, choices: [], min: 0, max: 9, unit: "points",
      isWhole: true, isEmptyAllowed: true, isShare: false, hint: "", needsPixels: true, evidence: ["lidar"],
    },
  );
});

test("units are abbreviated where that is usual", () => {
  const units = described(Object.fromEntries(["percent", "pixels", "metres", "points"].map((unit) => [unit, { type: "number", "x-unit": unit }])));
  assert.deepEqual(units.map(({ unit }) => unit), ["%", "px", "m", "points"]);
});

test("choices, switches, texts, lists of numbers and pairs become fields; more complex types do not", () => {
  const fields = described({
    a: { type: "string", enum: ["x", "y"] },
    b: { type: "boolean" },
    c: { type: "string", maxLength: 20 },
    d: { type: "array", items: { type: "integer" } },
    e: { anyOf: [{ $ref: "#" }, { type: "null" }] },
    f: { type: ["object", "null"] },
    g: { type: "object", additionalProperties: { type: "string" } },
  });
  assert.deepEqual(fields.map(({ key, kind }) => key + kind), ["achoice", "bswitch", "ctext", "dnumbers", "gpairs"]);
  assert.equal(fields[2]?.max, 20);
});

test("a number is accepted only if it is in the field's range and of its kind", () => {
  const share = { min: 0, max: 100, isWhole: false };
  assert.deepEqual(["0", " 70.5 ", "100", "100.5", "-1", "", "x"].map((text) => parseNumber(share, text)), [0, 70.5, 100, null, null, null, null]);
  assert.deepEqual(["2", "2.5"].map((text) => parseNumber({ ...share, isWhole: true }, text)), [2, null]);
});

test("the numbers that a field allows are said in words", () => {
  assert.equal(rangeText({ min: 0, max: 9, isWhole: true }), "a whole number from 0 to 9");
  assert.equal(rangeText({ min: 0, max: Infinity, isWhole: false }), "a number of at least 0");
  assert.equal(rangeText({ min: -Infinity, max: 9, isWhole: false }), "a number of at most 9");
  assert.equal(rangeText({ min: -Infinity, max: Infinity, isWhole: false }), "a number");
});

test("a list of numbers or pairs is separated by commas or semicolons; anything else is refused", () => {
  assert.deepEqual(parseNumbers("50, 100;200"), [50, 100, 200]);
  assert.deepEqual(parseNumbers(" "), []);
  assert.equal(parseNumbers("50, far"), null);
  assert.deepEqual([parsePairs("40: Pedestrian, #ff0000: Car;"), parsePairs(" ")], [{ 40: "Pedestrian", "#ff0000": "Car" }, {}]);
  assert.deepEqual([parsePairs("40 Pedestrian"), parsePairs("40:")], [null, null]);
});
