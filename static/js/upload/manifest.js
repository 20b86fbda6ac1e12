// @ts-check
// The JSONL manifest: one frame per line, its annotation and the paths of its files. No DOM.

import { LabelError } from "./labels.js";
import { FILE_KINDS } from "./sender.js";

/** @typedef {import("./matching.js").Entry} Entry */
/** @typedef {{key: string, annotation: Record<string, unknown>, files: Record<string, Entry>}} ReadFrame */

/**
 * @param {string} line @param {string} at  "manifest.jsonl, line 3"
 * @param {(path: string) => Entry | null} find  a file by its path relative to the manifest
 * @returns {ReadFrame}
 */
export function readManifestLine(line, at, find) {
  const { key, ...rest } = objectOf(line, at);
  if (typeof key !== "string" || key === "" || key.length > 512) {
    throw new LabelError(`${at}: expected "key" of 1 to 512 characters, found ${JSON.stringify(key)?.slice(0, 60)}`);
  }
  /** @type {Record<string, Entry>} */
  const files = {};
  for (const kind of FILE_KINDS) {
    const given = rest[kind];
    delete rest[kind];
    if (given === undefined || given === null || given === "") continue;
    if (typeof given !== "string") throw new LabelError(`${at}, ${kind}: expected a path, found ${JSON.stringify(given).slice(0, 60)}`);
    const file = find(given);
    if (!file) throw new LabelError(`${at}, ${kind}: ${given} is not among these files`);
    files[kind] = file;
  }
  return { key, annotation: rest, files };
}

/** @param {string} line @param {string} at @returns {Record<string, unknown>} */
function objectOf(line, at) {
  const found = jsonOf(line, at);
  if (typeof found !== "object" || found === null || Array.isArray(found)) throw new LabelError(`${at}: expected one JSON object`);
  return { ...found };
}

/** @param {string} text @param {string} at @returns {unknown} */
export function jsonOf(text, at) {
  try {
    return JSON.parse(text.replace(/^\ufeff/, ""));
  } catch (error) {
    throw new LabelError(`${at}: expected JSON: ${error instanceof Error ? error.message : error}`);
  }
}

/** "a/./b/../c" -> "a/c"; null when it leads out of the folder. @param {string} folder @param {string} path */
export function joined(folder, path) {
  if (/^([/\\]|[a-z]:)/i.test(path)) return null;
  /** @type {string[]} */
  const parts = [];
  for (const part of [...folder.split("/"), ...path.replaceAll("\\", "/").split("/")]) {
    if (part === "..") {
      if (parts.pop() === undefined) return null;
    } else if (part && part !== ".") parts.push(part);
  }
  return parts.join("/");
}
