// @ts-check
// Files out of a drop or a file field, folders included. The only part that knows the DOM.

/** @typedef {import("./matching.js").Entry} Entry */

/** More than this is no small set; walking on would only freeze the page. */
export const MOST_FILES = 60_000;

/** What was dropped goes beyond what a page should read. */
export class TooMany extends Error {
  constructor() {
    super(`More than ${MOST_FILES} files: use the command line for these.`);
  }
}

/** Do files hang on the pointer? @param {DataTransfer | null} transfer */
export const hasFiles = (transfer) => transfer?.types.includes("Files") ?? false;

/** All files of a drop. To be called while the event is on: what it holds is gone afterwards. @param {DataTransfer} transfer @returns {Promise<Entry[]>} */
export function filesOfDrop(transfer) {
  const items = [...transfer.items].filter(({ kind }) => kind === "file");
  const found = items.map((item) => item.webkitGetAsEntry?.() ?? item.getAsFile());
  return allOf(found);
}

/** @param {readonly (FileSystemEntry | File | null)[]} found */
async function allOf(found) {
  /** @type {Entry[]} */
  const entries = [];
  for (const one of found) {
    if (one instanceof File) entries.push(entryOf(one, one.name));
    else if (one) await collect(one, entries);
  }
  return entries;
}

/** @param {FileList} files @returns {Promise<Entry[]>} */
export async function filesOfField(files) {
  if (files.length > MOST_FILES) throw new TooMany();
  return [...files].map((file) => entryOf(file, file.webkitRelativePath || file.name));
}

/** @param {File} file @param {string} path @returns {Entry} */
const entryOf = (file, path) => ({ path, size: file.size, blob: file });

/** @param {FileSystemEntry} entry @param {Entry[]} entries */
async function collect(entry, entries) {
  if (entries.length >= MOST_FILES) throw new TooMany();
  const path = entry.fullPath.replace(/^\//, "");
  if (entry.isFile) {
    const file = await new Promise((resolve, reject) => /** @type {FileSystemFileEntry} */ (entry).file(resolve, reject));
    entries.push(entryOf(file, path));
    return;
  }
  const reader = /** @type {FileSystemDirectoryEntry} */ (entry).createReader();
  // A reader gives a portion at a time, and an empty one at the end.
  for (let some = await portion(reader); some.length; some = await portion(reader)) {
    for (const one of some) await collect(one, entries);
  }
}

/** @param {FileSystemDirectoryReader} reader @returns {Promise<FileSystemEntry[]>} */
const portion = (reader) => new Promise((resolve, reject) => reader.readEntries(resolve, reject));
