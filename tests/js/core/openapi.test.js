// The page has words for the values of the API's enumerations, and offers no others. They are read from the
// stored OpenAPI document, which a test of the service compares with that of a running service.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import { REVIEW_CHOICES } from "../../../static/js/boxes/filter_bar.js";
import { BOX_FILTER_KEYS, SORTS, VERDICT_CYCLE } from "../../../static/js/boxes/filters.js";
import { ANSWER_TEXT, EVIDENCE, REASONS, VERDICT_SIGN } from "../../../static/js/boxes/wording.js";
import { ORDERS } from "../../../static/js/queue/session.js";
import { exportForm } from "../../../static/js/runs/exports.js";
import { DATASET_NAME } from "../../../static/js/upload/dialog.js";
import { FILE_KINDS } from "../../../static/js/upload/uploader.js";

const OPENAPI = JSON.parse(readFileSync(new URL("../../pins/stored/openapi.json", import.meta.url), "utf8"));

/**
 * The values that a key of one of the API's models may have.
 * @param {string} model @param {string} key @returns {string[]}
 */
function wordsOf(model, key) {
  const schema = OPENAPI.components.schemas[model].properties[key];
  return [schema, ...(schema.anyOf ?? [])].find((each) => each.enum).enum;
}

/** @param {string} name @returns {string[]} */
const wordsOfListParameter = (name) =>
  OPENAPI.paths["/api/v1/boxes"].get.parameters.find((/** @type {{name: string}} */ each) => each.name === name).schema.enum;

/** @param {Iterable<string>} words */
const sorted = (words) => [...words].sort();

/** @type {[string, Iterable<string>, Iterable<string>][]} */
const TABLES = [
  ["reasons", Object.keys(REASONS), wordsOf("Decision", "reason")],
  ["kinds of evidence", Object.keys(EVIDENCE), wordsOf("FilterConfigIn", "evidence")],
  ["verdicts, and that of a box whose verdict is not shown", Object.keys(VERDICT_SIGN), [...wordsOf("Decision", "verdict"), "withheld"]],
  ["answers", Object.keys(ANSWER_TEXT), wordsOf("ReviewIn", "verdict")],
  ["orders of the queue", ORDERS.map(({ value }) => value), wordsOf("QueueIn", "order")],
];

for (const [what, shown, known] of TABLES) {
  test(`the page has words for all ${what}`, () => assert.deepEqual(sorted(shown), sorted(known)));
}

/** @type {[string, Iterable<string>, Iterable<string>][]} */
const CHOICES = [
  ["answers to filter by", REVIEW_CHOICES.map(({ value }) => value), wordsOf("BoxSelection", "review")],
  ["verdicts to filter by", VERDICT_CYCLE.filter(Boolean), wordsOf("BoxSelection", "verdict")],
  ["orders of a list", SORTS.map(({ value }) => value), wordsOfListParameter("sort")],
  ["filters", BOX_FILTER_KEYS.map((key) => (key === "by_filter" ? "verdict" : key)), Object.keys(OPENAPI.components.schemas.BoxSelection.properties)],
];

for (const [what, shown, known] of CHOICES) {
  test(`the API knows the page's ${what}`, () => assert.deepEqual([...shown].filter((word) => ![...known].includes(word)), []));
}

test("the page sends every kind of file that the API takes", () => {
  const operation = OPENAPI.paths["/api/v1/datasets/{dataset}/frames/{key}"].put;
  const parts = Object.keys(operation.requestBody.content["multipart/form-data"].schema.properties);

  assert.deepEqual(sorted([...FILE_KINDS, "annotation"]), sorted(parts));
});

test("the page allows a dataset the names that the API allows", () => {
  assert.equal(DATASET_NAME.source, OPENAPI.components.schemas.DatasetIn.properties.name.pattern);
});

test("each export format and each choice of its options has a text of its own", () => {
  const { formats, fields } = exportForm(OPENAPI);
  const choices = fields.flatMap(({ choices = [] }) => choices);

  assert.deepEqual(formats.map(({ value }) => value), wordsOf("ExportIn", "format"));
  assert.deepEqual(formats.filter(({ value, text, help }) => text === value || !help), []);
  assert.deepEqual(choices.filter(({ value, text }) => text === value), []);
  assert.ok(choices.length > 0);
});
