// @ts-check
// One Pascal VOC file as an annotation. No DOM.

import { LabelError } from "./labels.js";
import { allBelow, childOf, parseXml } from "./xml.js";

/** @typedef {import("./xml.js").XmlElement} XmlElement */

const CORNERS = ["xmin", "ymin", "xmax", "ymax"];

const KEPT = ["pose", "truncated", "difficult", "occluded"];

/**
 * Corners that are whole numbers throughout the file are VOC's own, counted from 1 and
 * inclusive, and become half-open; a fraction anywhere means pixel coordinates as they are.
 * @param {string} text @param {string} name of the file
 * @returns {Record<string, unknown>}
 */
export function readVoc(text, name) {
  const root = parseXml(text, name);
  if (root.tag !== "annotation") throw fault(root, name, "<annotation>", `<${root.tag}>`);
  const objects = allBelow(root, "object");
  const corners = objects.map((one) => cornersOf(one, name));
  const shift = corners.flat().every(Number.isInteger) ? 1 : 0;
  const boxes = objects.map((one, i) => {
    const [x0 = 0, y0 = 0, x1 = 0, y1 = 0] = corners[i] ?? [];
    return { class: textOf(one, "name", name), xyxy: [x0 - shift, y0 - shift, x1, y1], ...kept(one) };
  });
  const size = childOf(root, "size");
  const [width = 0, height = 0] = size ? ["width", "height"].map((key) => numberOf(size, key, name)) : [];
  // Some tools write zeros where they do not know; that is no size.
  return width && height ? { boxes, camera: { width, height } } : { boxes };
}

/** @param {XmlElement} at @param {string} name @param {string} expected @param {string} found */
const fault = (at, name, expected, found) => new LabelError(`${name}, line ${at.line}: expected ${expected}, found ${found}`);

/** @param {XmlElement} one @param {string} name */
function cornersOf(one, name) {
  const rectangle = childOf(one, "bndbox");
  if (!rectangle) throw fault(one, name, "<bndbox> in the object", "none");
  return CORNERS.map((key) => numberOf(rectangle, key, name));
}

/** @param {XmlElement} parent @param {string} key @param {string} name */
function numberOf(parent, key, name) {
  const text = textOf(parent, key, name);
  if (!Number.isFinite(Number(text))) throw fault(childOf(parent, key) ?? parent, name, `a finite number in <${key}>`, `'${text.slice(0, 40)}'`);
  return Number(text);
}

/** @param {XmlElement} parent @param {string} tag @param {string} name */
function textOf(parent, tag, name) {
  const text = childOf(parent, tag)?.text.trim();
  if (!text) throw fault(parent, name, `<${tag}> in <${parent.tag}>`, "nothing");
  return text;
}

/** What VOC says beside the rectangle. @param {XmlElement} one */
function kept(one) {
  const rows = KEPT.map((key) => [key, childOf(one, key)?.text.trim() ?? ""]).filter(([, text]) => text);
  return Object.fromEntries(rows.map(([key, text]) => [key, text === "0" || text === "1" ? Number(text) : text]));
}
