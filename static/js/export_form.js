// @ts-check
// What an export can be asked for, read from the API's own description, so that a format the
// server has learnt is offered at once. Words for people come from the tables here. Pure.

/** @typedef {{value: string, text: string, help: string}} Choice */
/** @typedef {{key: string, kind: "choice" | "switch" | "number" | "numbers", text: string, help: string, initial: unknown, choices: Choice[], min?: number, max?: number}} Field */
/** @typedef {{formats: Choice[], fields: Field[]}} ExportForm */
/** @typedef {Record<string, any>} Schema */

/** @type {Record<string, [string, string]>} */
const FORMAT_WORDS = {
  yolo: ["YOLO", "Ultralytics-ready: images, labels and data.yaml"],
  coco: ["COCO", "one JSON per part of the split"],
  kitti: ["KITTI", "label_2 with truncation and occlusion"],
  voc: ["Pascal VOC", "one XML per frame"],
  cvat: ["CVAT", "XML for CVAT's images task"],
  "label-studio": ["Label Studio", "tasks with predictions"],
  manifest: ["As it came in", "the same files, minus the rejected boxes"],
  "decisions-jsonl": ["Decisions, JSONL", "every number of every box, one per line"],
  "decisions-csv": ["Decisions, CSV", "for spreadsheets"],
  "decisions-parquet": ["Decisions, Parquet", "for dataframes"],
};

/** @type {Record<string, string>} */
const FIELD_WORDS = {
  include: "Boxes that go in",
  include_unmeasured: "Unmeasured boxes, too",
  rejected: "Rejected boxes",
  boxes: "Rectangle",
  images: "Images",
  split: "Share for training",
  bands: "Labels per distance, metres",
};

/** @type {Record<string, Record<string, string>>} */
const CHOICE_WORDS = {
  include: { effective: "kept, people's answers first", kept: "kept by the filter", all: "all, rejected ones too" },
  rejected: { drop: "left out", dontcare: "marked as to be ignored" },
  boxes: { visible: "what is inside the image", amodal: "whole, beyond the image", tight: "tight around the pixels" },
  images: { copy: "copied into the archive", none: "left out, labels alone" },
};

/** @param {Schema} openapi @returns {ExportForm} */
export function exportForm(openapi) {
  const schemas = openapi.components?.schemas ?? {};
  const formats = valuesOf(schemas.ExportIn?.properties?.format ?? {});
  const options = Object.entries(schemas.ExportOptions?.properties ?? {});
  return {
    formats: formats.map((value) => ({ value, text: FORMAT_WORDS[value]?.[0] ?? value, help: FORMAT_WORDS[value]?.[1] ?? "" })),
    fields: options.flatMap(([key, schema]) => fieldOf(key, schema) ?? []),
  };
}

/** @param {Schema} schema @returns {string[]} */
const valuesOf = (schema) => schema.enum ?? (schema.const === undefined ? [] : [schema.const]);

/** @param {string} key @param {Schema} schema @returns {Field | null} null: nothing that the page could ask for */
function fieldOf(key, schema) {
  const words = { key, text: FIELD_WORDS[key] ?? key.replaceAll("_", " "), help: schema.description ?? "", initial: schema.default };
  const values = valuesOf(schema);
  if (values.length > 0) {
    return { ...words, kind: "choice", choices: values.map((value) => ({ value, text: CHOICE_WORDS[key]?.[value] ?? value, help: "" })) };
  }
  const limits = { min: schema.minimum, max: schema.maximum, choices: [] };
  if (schema.type === "boolean") return { ...words, ...limits, kind: "switch" };
  if (schema.type === "number" || schema.type === "integer") return { ...words, ...limits, kind: "number" };
  const isNumbers = schema.type === "array" && ["number", "integer"].includes(schema.items?.type);
  return isNumbers ? { ...words, ...limits, kind: "numbers" } : null;
}

/** What is sent: every option as it stands. @param {readonly Field[]} fields @param {Record<string, unknown>} chosen */
export const optionsOf = (fields, chosen) => Object.fromEntries(fields.map(({ key, initial }) => [key, key in chosen ? chosen[key] : initial]));

/** "50, 100" as numbers; null when it is something else. @param {string} text */
export function parseNumbers(text) {
  const parts = text.split(/[\s,;]+/).filter(Boolean);
  const numbers = parts.map(Number);
  return numbers.every((number) => Number.isFinite(number)) ? numbers : null;
}

/** @param {string} format */
export const formatText = (format) => FORMAT_WORDS[format]?.[0] ?? format;

/** What an export was asked for, without what is as always. @param {Record<string, unknown>} options @param {readonly Field[]} fields */
export function optionsText(options, fields) {
  const special = fields.filter(({ key, initial }) => key in options && JSON.stringify(options[key]) !== JSON.stringify(initial));
  const words = special.map((field) => wordsOf(field, options[field.key]));
  const split = Number(options.split);
  return [...(split > 0 && split < 1 && !special.some(({ key }) => key === "split") ? [`split ${splitText(split)}`] : []), ...words].join(" · ");
}

/** @param {Field} field @param {unknown} value */
function wordsOf({ key, text, choices }, value) {
  if (key === "split") return value === 1 ? "no split" : `split ${splitText(Number(value))}`;
  const chosen = choices.find((choice) => choice.value === value);
  if (chosen) return `${text.toLowerCase()}: ${chosen.text}`;
  if (typeof value === "boolean") return value ? text.toLowerCase() : `not: ${text.toLowerCase()}`;
  return `${text.toLowerCase()}: ${Array.isArray(value) ? value.join(", ") : String(value)}`;
}

/** 0.8 as "80/20". @param {number} share */
export const splitText = (share) => `${Math.round(100 * share)}/${Math.round(100 * (1 - share))}`;

/** "3 min 20 s". @param {string | null} from @param {string | null} to */
export function tookText(from, to) {
  if (!from || !to) return "";
  const seconds = Math.max(0, (Date.parse(to) - Date.parse(from)) / 1000);
  if (seconds < 0.1) return "under 0.1 s";
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 60) return `${Math.round(seconds)} s`;
  return `${Math.floor(seconds / 60)} min ${Math.round(seconds % 60)} s`;
}

/** @type {readonly (readonly [string, string, string])[]} part of the manifest, its key, how it is said */
const BOOKS = [
  ["frames", "in", "frames"],
  ["frames", "train", "to train"],
  ["frames", "val", "to validate"],
  ["boxes", "out", "boxes written"],
  ["boxes", "dontcare", "to be ignored"],
  ["boxes", "dropped", "dropped"],
  ["boxes", "clipped", "clipped"],
];

/** What an archive's manifest counts, for people. @param {Schema} counts */
export function booksOf(counts) {
  const lines = BOOKS.map(([part, key, text]) => ({ text, count: Number(counts[part]?.[key] ?? 0) }));
  const classes = Object.entries(counts.classes ?? {}).map(([name, row]) => ({
    name,
    counts: ["in", "out", "dropped", "clipped"].map((key) => Number(/** @type {Schema} */ (row)[key] ?? 0)),
  }));
  return { lines: lines.filter(({ count }) => count > 0), classes };
}
