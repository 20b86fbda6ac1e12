// @ts-check
// What the filter is compared with, and how each of them is spoken of.

import { linkTo } from "../../router.js";
import { cellQuery } from "../../measures.js";
import { countOf } from "../../wording.js";

/** @typedef {import("../../types_quality.js").Truth} Truth */
/** @typedef {typeof import("../../measures.js").CELLS[number]} CellAbout */

/**
 * @typedef {object} Words
 * @property {(n: number) => string} head  after "the filter against"
 * @property {string} all  heading of the comparison as a whole
 * @property {(n: number) => string} counted  what was counted for it
 * @property {(n: number) => string} some  so many, in few words
 * @property {string} column  heading of their number
 * @property {string} keep  the truth's own words
 * @property {string} reject
 * @property {string} said  what the columns are, spoken
 * @property {string} precision  what it is a part of
 * @property {string} recall
 * @property {Record<string, string>} goals  what is suggested, by target
 * @property {string} both  without which nothing is suggested
 */

export const TRUTHS = [
  { value: "people", text: "People" },
  { value: "instances", text: "Instances" },
];

/** @type {Record<Truth, Words>} */
export const WORDS = {
  people: {
    head: (n) => `${countOf(n, "answer")} of people`,
    all: "All boxes that were answered",
    counted: (n) => `${countOf(n, "answer")}, the latest of each box`,
    some: (n) => countOf(n, "answer"),
    column: "Answers",
    keep: "people keep",
    reject: "people reject",
    said: "what people said",
    precision: "of the boxes that the filter keeps, people keep",
    recall: "of the boxes that people keep, the filter keeps",
    goals: { f1: "the ones that agree best with the answers of people", recall: "the highest ones that keep what people keep" },
    both: "Answers on both sides are needed before a threshold can be suggested: some boxes to keep and some to reject, of the same class.",
  },
  instances: {
    head: (n) => `instance images, ${countOf(n, "box", "boxes")}`,
    all: "All boxes with an instance image",
    counted: (n) => `${countOf(n, "box", "boxes")}; visible is what has a pixel of its own`,
    some: (n) => countOf(n, "box", "boxes"),
    column: "Boxes",
    keep: "is visible",
    reject: "is not visible",
    said: "what instances show",
    precision: "of the boxes that the filter keeps, are visible",
    recall: "of the boxes that are visible, the filter keeps",
    goals: { f1: "the ones that agree best with what is visible", recall: "the highest ones that keep what is visible" },
    both: "Boxes on both sides are needed before a threshold can be suggested: some visible and some not, of the same class.",
  },
};

/**
 * The boxes that a field counts. The grid knows what people said; what instances show it does not.
 * @param {string} dataset @param {Truth} truth @param {CellAbout} cell @param {Record<string, string>} [more]
 */
export const boxesOf = (dataset, truth, { filter, person }, more = {}) =>
  truth === "people" ? linkTo("grid", { dataset }, { ...more, ...cellQuery(filter, person) }) : null;
