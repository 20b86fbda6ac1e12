// @ts-check
// What label files say: YOLO lines, carlasimu's centres in pixels, Pascal VOC, lists of class
// names. A fault is a LabelError that names file and line. No DOM.

/** @typedef {Record<string, unknown>} Box  as an annotation has it */

/** The text cannot be read as what it should be. */
export class LabelError extends Error {}

/**
 * @param {string} text  per line `class cx cy w h [confidence]` in shares of the image, or `cx cy w h` in pixels
 * @param {string} name  of the file
 * @param {readonly string[]} classes  by number
 * @returns {Box[]}
 */
export function readLabelLines(text, name, classes) {
  return text.replace(/^\ufeff/, "").split(/\r\n|\n|\r/).flatMap((line, i) => {
    const columns = line.split(/\s+/).filter(Boolean);
    return columns.length ? [readLine(columns, `${name}, line ${i + 1}`, classes)] : [];
  });
}

/** @param {string[]} columns @param {string} at @param {readonly string[]} classes @returns {Box} */
function readLine(columns, at, classes) {
  if (columns.length === 4) return { class: "unknown", cxcywh: numbers(columns, at) };
  if (columns.length !== 5 && columns.length !== 6) {
    throw new LabelError(`${at}: expected 'class cx cy w h' (5 columns) or 'cx cy w h' in pixels (4 columns), found ${columns.length} columns`);
  }
  const [word = "", ...rest] = columns;
  const [cx, cy, w, h, confidence] = numbers(rest, at);
  const box = { class: className(word, at, classes), cxcywhn: [cx, cy, w, h] };
  return confidence === undefined ? box : { ...box, confidence };
}

/** @param {string} word @param {string} at @param {readonly string[]} classes */
function className(word, at, classes) {
  const name = /^\d{1,9}$/.test(word) ? classes[Number(word)] : undefined;
  if (name === undefined) throw new LabelError(`${at}: expected a class from 0 to ${classes.length - 1}, found '${word.slice(0, 40)}'`);
  return name;
}

/** @param {readonly string[]} words @param {string} at */
function numbers(words, at) {
  return words.map((word) => {
    if (!/^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i.test(word)) throw new LabelError(`${at}: expected a finite number, found '${word.slice(0, 40)}'`);
    return Number(word);
  });
}

/** One name per line. @param {string} text */
export const readNames = (text) => text.replace(/^\ufeff/, "").split(/\r\n|\n|\r/).map((line) => line.trim()).filter(Boolean);

/**
 * The `names` of a data.yaml, in the three forms that tools write: `[a, b]`, lines with a
 * dash, lines with a number. Anything else is left to the command line, which reads all of YAML.
 * @param {string} text @param {string} name @returns {string[]}
 */
export function readYamlNames(text, name) {
  const lines = text.replace(/^\ufeff/, "").split(/\r\n|\n|\r/).map((line) => line.replace(/(^|\s)#.*$/, ""));
  const at = lines.findIndex((line) => /^names\s*:/.test(line));
  if (at < 0) throw new LabelError(`${name}: expected a list of class names under 'names'`);
  const inline = flowText(lines, at);
  const found = inline ? flowNames(inline) : blockNames(lines.slice(at + 1));
  if (!found || found.length === 0 || found.some((word) => !word)) {
    throw new LabelError(`${name}, names: expected [a, b], or one name per line with a dash or with numbers from 0 up`);
  }
  return found;
}

/** What follows `names:`, on as many lines as its brackets need. @param {readonly string[]} lines @param {number} at */
function flowText(lines, at) {
  let text = (lines[at] ?? "").replace(/^names\s*:/, "").trim();
  for (let i = at + 1; text && !/[\]}]$/.test(text) && i < lines.length; i++) text += ` ${(lines[i] ?? "").trim()}`;
  return text.trim();
}

/** @param {string} text @returns {string[] | null} */
function flowNames(text) {
  const list = /^\[(.*?),?\s*\]$/.exec(text)?.[1];
  if (list !== undefined) return list.split(",").map(unquoted);
  const pairs = /^\{(.*?),?\s*\}$/.exec(text)?.[1];
  return pairs === undefined ? null : inOrder(pairs.split(","));
}

/** @param {readonly string[]} lines @returns {string[] | null} */
function blockNames(lines) {
  const end = lines.findIndex((line) => line.trim() && !/^(\s|-)/.test(line));
  const own = (end < 0 ? lines : lines.slice(0, end)).map((line) => line.trim()).filter(Boolean);
  if (own.every((line) => line.startsWith("-"))) return own.map((line) => unquoted(line.slice(1)));
  return inOrder(own);
}

/** "0: car" and so on, which must be 0, 1, 2 ... @param {readonly string[]} pairs @returns {string[] | null} */
function inOrder(pairs) {
  const rows = pairs.map((pair) => /^\s*(\d+)\s*:\s*(.+?)\s*$/.exec(pair));
  /** @type {string[]} */
  const names = [];
  for (const row of rows) {
    if (!row) return null;
    names[Number(row[1])] = unquoted(row[2] ?? "");
  }
  return names.length === rows.length && Object.keys(names).length === rows.length ? names : null;
}

/** @param {string} word */
const unquoted = (word) => word.trim().replace(/^(["'])(.*)\1$/, "$2");

const CARLASIMU_CLASSES = ["car", "bus", "truck", "van", "walker", "street_light"];

/** From carlasimu's Readme.txt, which is JSON; else in the order of its code. @param {string} text @returns {string[]} */
export function readCarlasimuNames(text) {
  try {
    const { classes } = JSON.parse(text);
    const names = inOrder(Object.entries(classes).map(([word, number]) => `${number}: ${word}`));
    if (names) return names;
  } catch {
    // People put other readmes into folders.
  }
  return CARLASIMU_CLASSES;
}
