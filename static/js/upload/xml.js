// @ts-check
// As much XML as annotation files have: elements and text. Attributes are skipped, a DTD is
// refused. The browser's own parser reports faults as a page whose styles the policy forbids.

import { LabelError } from "./labels.js";

/** @typedef {{tag: string, line: number, children: XmlElement[], text: string}} XmlElement */

const TOKEN = /<!--[\s\S]*?-->|<\?[\s\S]*?\?>|<!\[CDATA\[([\s\S]*?)\]\]>|<\/([^\s<>/]+)\s*>|<([^\s<>/!?]+)((?:\s+[^\s=<>]+\s*=\s*(?:"[^"<]*"|'[^'<]*'))*)\s*(\/?)>|([^<]+)/y;

/** @type {Record<string, string>} */
const ENTITIES = { amp: "&", lt: "<", gt: ">", quot: '"', apos: "'" };

/** @param {string} source @param {string} name of the file @returns {XmlElement} the root */
export function parseXml(source, name) {
  const text = source.replace(/^\ufeff/, "");
  if (/<!(DOCTYPE|ENTITY)/i.test(text)) throw new LabelError(`${name}: XML with a DTD or entities is refused`);
  /** @type {XmlElement} */
  const top = { tag: "", line: 1, children: [], text: "" };
  const open = [top];
  const place = createPlace(text, name);
  TOKEN.lastIndex = 0;
  for (let at = 0; at < text.length; at = TOKEN.lastIndex) {
    const found = TOKEN.exec(text);
    const parent = open.at(-1) ?? top;
    if (!found) throw place.error(at, "a tag is broken");
    const [, cdata, closed, opened, , isEmpty, plain] = found;
    if (opened) {
      const element = { tag: opened, line: place.lineOf(at), children: [], text: "" };
      parent.children.push(element);
      if (!isEmpty) open.push(element);
    } else if (closed) {
      if (closed !== parent.tag) throw place.error(at, `</${closed}> where <${parent.tag || "nothing"}> is open`);
      open.pop();
    } else parent.text += cdata ?? unescaped(plain ?? "");
  }
  const [root] = top.children;
  if (open.length > 1) throw place.error(text.length, `<${open.at(-1)?.tag}> is not closed`);
  if (!root || top.children.length > 1 || top.text.trim()) throw place.error(0, "expected one element around everything");
  return root;
}

/** @param {string} text @param {string} name */
function createPlace(text, name) {
  let counted = 0;
  let line = 1;
  /** Counts on from where it was: places come in order. @param {number} at */
  const lineOf = (at) => {
    for (; counted < at; counted++) if (text[counted] === "\n") line++;
    return line;
  };
  return { lineOf, error: (/** @type {number} */ at, /** @type {string} */ why) => new LabelError(`${name}, line ${at ? lineOf(at) : 1}: not XML: ${why}`) };
}

/** @param {string} text */
const unescaped = (text) =>
  text.replace(/&(?:#x([\da-f]{1,6})|#(\d{1,7})|(\w+));/gi, (whole, hex, decimal, word) => {
    const code = hex ? parseInt(hex, 16) : decimal ? Number(decimal) : -1;
    return code >= 0 && code <= 0x10ffff ? String.fromCodePoint(code) : (ENTITIES[word] ?? whole);
  });

/** @param {XmlElement} parent @param {string} tag */
export const childOf = (parent, tag) => parent.children.find((one) => one.tag === tag) ?? null;

/** All elements of this name below this one. @param {XmlElement} parent @param {string} tag @returns {XmlElement[]} */
export const allBelow = (parent, tag) => parent.children.flatMap((one) => [...(one.tag === tag ? [one] : []), ...allBelow(one, tag)]);
