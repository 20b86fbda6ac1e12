// @ts-check
// Reads dropped files: what `pack` takes of them is sent to the server, which responds with the frames, and how it
// understands them. No DOM.

import { ask } from "../core/api.js";
import { archiveOf } from "./archive.js";
import { createPauses } from "./uploader.js";

/** @typedef {import("../core/openapi.js").FolderHead} FolderHead */
/** @typedef {import("../core/openapi.js").FolderFrame} FolderFrame */
/** @typedef {import("../core/openapi.js").UnmatchedFile} UnmatchedFile */
/** @typedef {import("../core/openapi.js").FolderEnd} FolderEnd */
/** @typedef {import("../core/openapi.js").FolderInspection} Inspection */
/**
 * @typedef {NonNullable<NonNullable<import("../core/api.js").Operation<"post",
 *   "/api/v1/folders">["parameters"]["query"]>["layout"]>} Layout "auto": the likeliest
 */
/** @typedef {FolderHead | FolderFrame | UnmatchedFile | FolderEnd} FolderLine */

/**
 * @typedef {object} Entry  a file that was dropped
 * @property {string} path  relative to what was dropped, with "/"
 * @property {() => Promise<Blob>} open  a question to another process, as its size is: asked for what needs it
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
 * @property {FolderHead["layout"]} layout  null: they cannot be read
 * @property {FolderHead["layouts"]} layouts  that these files may have, the likeliest first
 * @property {FolderHead["titles"]} titles  their names for people
 * @property {ReadFrame[]} frames
 * @property {{key: string, why: string}[]} problems  frames that cannot be read
 * @property {UnmatchedFile[]} unmatched  files that belong to no frame
 * @property {string[] | null} classes  the layout's own list
 * @property {FolderHead["settings"]} settings  of a new dataset, as recording.yaml says
 * @property {FolderHead["config"]} config  keys of a configuration that recording.yaml gives
 * @property {Inspection} inspection  how the files are understood
 */

/**
 * @typedef {{step: "labels" | "waiting" | "frames", done: number, of: number | null}} Reading labels read here, then
 *   frames read by the server
 */

/**
 * Without files that readers ignore: hidden ones, and those that macOS adds to archives.
 * @param {readonly Entry[]} entries
 */
export const visibleEntries = (entries) =>
  entries.filter(({ path }) => !path.split("/").some((part) => part.startsWith(".") || part === "__MACOSX"));

/** How often the progress is told. */
const TELL_EVERY = 100;

/** The name of the one folder that holds everything, or "". @param {readonly Entry[]} entries */
export function topOf(entries) {
  const [top = "", ...rest] = (entries[0]?.path ?? "").split("/");
  return rest.length > 0 && entries.every(({ path }) => path.startsWith(`${top}/`)) ? top : "";
}

/**
 * Ask the server which frames these files make up. The server stores nothing.
 * @param {readonly Entry[]} entries @param {import("./archive.js").Packed} packed
 * @param {{layout: Layout, description: object | null}} how  the description in place of a dropped one
 * @param {AbortSignal} signal @param {(reading: Reading) => void} tell  called with the progress
 * @returns {Promise<Plan>}
 */
export async function readFolder(entries, packed, { layout, description }, signal, tell) {
  const body = archiveOf(packed, topOf(entries), description);
  tell({ step: "waiting", done: 0, of: null });
  const response = await ask("post", "/api/v1/folders", { query: { layout }, body, signal });
  return planOf(linesOf(response), entries, (done, of) => tell({ step: "frames", done, of }));
}

/**
 * @param {AsyncIterable<FolderLine>} lines
 * @param {readonly Entry[]} entries
 * @param {(done: number, of: number | null) => void} tell
 * @returns {Promise<Plan>}
 */
export async function planOf(lines, entries, tell) {
  /** @type {Map<string, Entry>} */
  const byPath = new Map();
  for (const entry of entries) if (!byPath.has(entry.path)) byPath.set(entry.path, entry);
  /** @type {Pick<Plan, "frames" | "problems" | "unmatched">} */
  const found = { frames: [], problems: [], unmatched: [] };
  let head = /** @type {FolderHead | null} */ (null);
  let inspection = /** @type {Inspection | null} */ (null);
  const pause = createPauses();
  for await (const line of lines) {
    await pause();
    if ("end" in line) inspection = line.inspection;
    else if ("why" in line) found.unmatched.push(line);
    else if ("key" in line) {
      addFrame(found, line, byPath);
      const done = found.frames.length + found.problems.length;
      if (done % TELL_EVERY === 0) tell(done, head?.count ?? null);
    } else head = line;
  }
  if (!head || !inspection) throw new Error("The server's response was cut off. Try again.");
  const { layout, layouts, titles, classes, settings, config } = head;
  return { layout, layouts, titles, classes, settings, config, inspection, ...found };
}

/**
 * @param {Pick<Plan, "frames" | "problems">} plan
 * @param {FolderFrame} line
 * @param {ReadonlyMap<string, Entry>} byPath
 */
function addFrame(plan, { key, annotation, annotation_text: text, files, fault }, byPath) {
  const named = Object.entries(files).map(([kind, name]) => ({ kind, name, entry: byPath.get(name) }));
  const missing = named.find(({ entry }) => !entry);
  const why = fault?.detail ?? (missing ? `${missing.name} is not among these files` : "");
  if (why || !annotation) plan.problems.push({ key, why });
  else {
    const there = named.flatMap(({ kind, entry }) => (entry ? [[kind, entry]] : []));
    plan.frames.push({ key, annotation, text, files: Object.fromEntries(there) });
  }
}

/**
 * The same plan once the sizes of the files are known: a frame with an empty file cannot be read.
 * @param {Plan} plan @param {import("./archive.js").Sizes} sizes @returns {Plan}
 */
export function withSizes(plan, sizes) {
  const emptyOf = (/** @type {ReadFrame} */ { files }) => Object.values(files).find((entry) => sizes.get(entry) === 0);
  const problems = plan.frames.flatMap((frame) => {
    const empty = emptyOf(frame);
    return empty ? [{ key: frame.key, why: `${empty.path} has 0 bytes` }] : [];
  });
  if (problems.length === 0) return plan;
  const frames = plan.frames.filter((frame) => !emptyOf(frame));
  return { ...plan, frames, problems: [...plan.problems, ...problems] };
}

/**
 * The lines of a response, each as soon as it has come.
 * @param {Response} response
 * @returns {AsyncGenerator<FolderLine>}
 */
export async function* linesOf(response) {
  const reader = response.body?.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (let piece = await reader?.read(); piece && !piece.done; piece = await reader?.read()) {
    const lines = (rest + piece.value).split("\n");
    rest = lines.pop() ?? "";
    for (const line of lines) yield JSON.parse(line);
  }
}
