// @ts-check
// Reads dropped files: their names and labels are sent to the server, which responds with the frames it found. No DOM.

import { ask } from "../core/api.js";
import { contentOf } from "./uploader.js";

/** @typedef {import("../core/openapi.js").FolderHead} FolderHead */
/** @typedef {import("../core/openapi.js").FolderFrame} FolderFrame */
/** @typedef {import("../core/openapi.js").UnmatchedFile} UnmatchedFile */
/** @typedef {import("../core/openapi.js").FolderEnd} FolderEnd */
/** @typedef {NonNullable<NonNullable<import("../core/api.js").Operation<"post", "/api/v1/folders">["parameters"]["query"]>["layout"]>} Layout  "auto": the likeliest */
/** @typedef {FolderHead | FolderFrame | UnmatchedFile | FolderEnd} FolderLine */

/**
 * @typedef {object} Entry  a file that was dropped
 * @property {string} path  relative to what was dropped, with "/"
 * @property {number} size
 * @property {Blob} blob
 */

/**
 * @typedef {object} ReadFrame  a frame to be sent
 * @property {string} key
 * @property {Record<string, unknown>} annotation
 * @property {string | null} text  the annotation as JSON, where JavaScript would lose digits of its numbers
 * @property {Record<string, Entry>} files
 */

/**
 * @typedef {object} Plan
 * @property {FolderHead["layout"]} layout
 * @property {readonly FolderHead["layout"][]} layouts  that these files may have, the likeliest first
 * @property {FolderHead["titles"]} titles  their names for people
 * @property {ReadFrame[]} frames
 * @property {{key: string, why: string}[]} problems  frames that cannot be read
 * @property {UnmatchedFile[]} unmatched  files that belong to no frame
 * @property {string[] | null} classes  the layout's own list
 * @property {FolderHead["settings"]} settings  of a new dataset, as recording.yaml says
 * @property {FolderHead["config"]} config  keys of a configuration that recording.yaml gives
 * @property {readonly string[]} notes  how the files were read
 */

/** @typedef {{step: "labels" | "waiting" | "frames", done: number, of: number | null}} Reading  labels read here, then frames read by the server */

/** Files whose content the server needs; of all others but those in `SIZED` it needs only the names. */
const TEXT = /\.(txt|xml|jsonl?|ya?ml|names|csv|tsv|npz|gz)$/i;

/** For KITTI the server needs the size of each picture, which is in its first bytes. */
const SIZED = /(^|\/)image_2\/[^/]*$/;
const PNG_SIZE_BYTES = 24;
const JPEG_SIZE_BYTES = 64 * 1024;

const IMAGE = /\.(png|jpe?g)$/i;

/** @param {readonly Entry[]} entries */
export const hasImages = (entries) => entries.some(({ path }) => IMAGE.test(path));

/** Without files that readers ignore: hidden ones, and those that macOS adds to archives. @param {readonly Entry[]} entries */
export const visibleEntries = (entries) => entries.filter(({ path }) => !path.split("/").some((part) => part.startsWith(".") || part === "__MACOSX"));

/** The name of the one folder that holds everything, or "". @param {readonly Entry[]} entries */
export function topOf(entries) {
  const [top = "", ...rest] = (entries[0]?.path ?? "").split("/");
  return rest.length > 0 && entries.every(({ path }) => path.startsWith(`${top}/`)) ? top : "";
}

/**
 * Ask the server which frames these files make up. The server stores nothing.
 * @param {readonly Entry[]} entries @param {Layout} layout
 * @param {AbortSignal} signal @param {(reading: Reading) => void} tell  called with the progress
 * @returns {Promise<Plan>}
 */
export async function readFolder(entries, layout, signal, tell) {
  const body = await archiveOf(entries, signal, (done, of) => tell({ step: "labels", done, of }));
  tell({ step: "waiting", done: 0, of: null });
  const response = await ask("post", "/api/v1/folders", { query: { layout }, body, signal });
  return planOf(linesOf(response), entries, (done, of) => tell({ step: "frames", done, of }));
}

const TELL_EVERY = 100;

/**
 * @param {AsyncIterable<FolderLine>} lines @param {readonly Entry[]} entries @param {(done: number, of: number | null) => void} tell
 * @returns {Promise<Plan>}
 */
export async function planOf(lines, entries, tell) {
  /** @type {Map<string, Entry>} */
  const byPath = new Map();
  for (const entry of entries) if (!byPath.has(entry.path)) byPath.set(entry.path, entry);
  /** @type {Pick<Plan, "frames" | "problems" | "unmatched">} */
  const found = { frames: [], problems: [], unmatched: [] };
  let head = /** @type {FolderHead | null} */ (null);
  /** @type {readonly string[]} */
  let notes = [];
  let isWhole = false;
  for await (const line of lines) {
    if ("end" in line) {
      isWhole = true;
      notes = line.notes;
    }
    else if ("why" in line) found.unmatched.push(line);
    else if ("key" in line) {
      addFrame(found, line, byPath);
      const done = found.frames.length + found.problems.length;
      if (done % TELL_EVERY === 0) tell(done, head?.count ?? null);
    } else head = line;
  }
  if (!head || !isWhole) throw new Error("The server's response was cut off. Try again.");
  const { layout, layouts, titles, classes, settings, config } = head;
  return { layout, layouts, titles, classes, settings, config, notes, ...found };
}

/** @param {Pick<Plan, "frames" | "problems">} plan @param {FolderFrame} line @param {ReadonlyMap<string, Entry>} byPath */
function addFrame(plan, { key, annotation, annotation_text: text, files, fault }, byPath) {
  const found = Object.entries(files).map(([kind, name]) => ({ kind, name, entry: byPath.get(name) }));
  const missing = found.find(({ entry }) => !entry);
  const why = fault?.detail ?? (missing ? `${missing.name} is not among these files` : "");
  if (why || !annotation) plan.problems.push({ key, why });
  else {
    const there = found.flatMap(({ kind, entry }) => (entry ? [[kind, entry]] : []));
    plan.frames.push({ key, annotation, text, files: Object.fromEntries(there) });
  }
}

/** The lines of a response, each as soon as it has come. @param {Response} response @returns {AsyncGenerator<FolderLine>} */
export async function* linesOf(response) {
  const reader = response.body?.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (let piece = await reader?.read(); piece && !piece.done; piece = await reader?.read()) {
    const lines = (rest + piece.value).split("\n");
    rest = lines.pop() ?? "";
    for (const line of lines) yield JSON.parse(line);
  }
}

const BLOCK = 512;
const AT_ONCE = 8;

/**
 * A tar of these files, of each what the server needs: see `bytesOf`.
 * @param {readonly Entry[]} entries @param {AbortSignal} signal @param {(done: number, of: number) => void} tell
 */
export async function archiveOf(entries, signal, tell) {
  const wanted = entries.map((entry) => ({ entry, size: bytesOf(entry) }));
  /** @type {Uint8Array<ArrayBuffer>[][]} */
  const members = [];
  const of = wanted.filter(({ size }) => size > 0).length;
  let next = 0;
  let done = 0;
  const work = async () => {
    for (let at = next++; at < wanted.length; at = next++) {
      const { entry, size } = /** @type {{entry: Entry, size: number}} */ (wanted[at]);
      signal.throwIfAborted();
      const head = headersOf(entry.path, size);
      members[at] = head;
      if (size === 0) continue;
      members[at] = [...head, await contentOf({ ...entry, blob: entry.blob.slice(0, size) }), new Uint8Array(padding(size))];
      if (++done % TELL_EVERY === 0) tell(done, of);
    }
  };
  await Promise.all(Array.from({ length: AT_ONCE }, work));
  return new Blob([...inPieces(members.flat()), new Uint8Array(2 * BLOCK)], { type: "application/x-tar" });
}

const PIECE_BYTES = 4 * 1024 * 1024;

/** Join small parts into larger ones: a browser is slow at sending a body of tens of thousands of parts. @param {readonly Uint8Array<ArrayBuffer>[]} parts */
function* inPieces(parts) {
  for (let first = 0; first < parts.length; ) {
    let end = first;
    let size = 0;
    do size += parts[end++]?.length ?? 0;
    while (end < parts.length && size + (parts[end]?.length ?? 0) <= PIECE_BYTES);
    const piece = new Uint8Array(size);
    let at = 0;
    for (const part of parts.slice(first, end)) {
      piece.set(part, at);
      at += part.length;
    }
    yield piece;
    first = end;
  }
}

/** How much of a file the server needs. @param {Entry} entry */
function bytesOf({ path, size }) {
  if (TEXT.test(path)) return size;
  if (!SIZED.test(path)) return 0;
  return Math.min(size, path.toLowerCase().endsWith(".png") ? PNG_SIZE_BYTES : JPEG_SIZE_BYTES);
}

/** @param {number} size */
const padding = (size) => (BLOCK - (size % BLOCK)) % BLOCK;

const NAME_BYTES = 100;

/** What stands before a file in a tar; a long name has an entry of its own. @param {string} path @param {number} size */
function headersOf(path, size) {
  const name = new TextEncoder().encode(path);
  if (name.length <= NAME_BYTES) return [header(name, size, "0")];
  const long = new Uint8Array(name.length + 1 + padding(name.length + 1));
  long.set(name);
  return [header(new TextEncoder().encode("././@LongLink"), name.length + 1, "L"), long, header(name.subarray(0, NAME_BYTES), size, "0")];
}

const CHECKSUM_AT = 148;

/** @param {Uint8Array} name @param {number} size @param {string} type */
function header(name, size, type) {
  const block = new Uint8Array(BLOCK);
  const write = (/** @type {number} */ at, /** @type {string} */ text) => block.set(new TextEncoder().encode(text), at);
  let sum = 0;
  const octal = (/** @type {number} */ number, /** @type {number} */ digits) => number.toString(8).padStart(digits, "0");
  block.set(name);
  // Mode, owner, group, size, time, an empty checksum, type; then what marks a POSIX tar.
  write(NAME_BYTES, `0000644\0${"0000000\0".repeat(2)}${octal(size, 11)}\0${"0".repeat(11)}\0        ${type}`);
  write(257, "ustar\x0000");
  for (const byte of block) sum += byte;
  write(CHECKSUM_AT, `${octal(sum, 6)}\0 `);
  return block;
}
