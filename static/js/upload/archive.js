// @ts-check
// A tar of dropped files with what the server needs to recognise them: texts whole, and a sample of the images. No DOM.

import { contentOf, createPauses, opened } from "./uploader.js";

/** @typedef {import("./folder.js").Entry} Entry */

/** Files whose content the server needs; of all others but those in `SIZED` and the sample it needs only the names. */
const TEXT = /\.(txt|xml|jsonl?|ya?ml|names|csv|tsv|npz|gz)$/i;

/** For KITTI the server needs the size of each picture, which is in its first bytes. */
const SIZED = /(^|\/)image_2\/[^/]*$/;
const PNG_SIZE_BYTES = 24;
const JPEG_SIZE_BYTES = 64 * 1024;

const IMAGE = /\.(png|jpe?g)$/i;

/** @param {readonly Entry[]} entries */
export const hasImages = (entries) => entries.some(({ path }) => IMAGE.test(path));

/** The description of a recording, in its top folder. */
const RECORDING = "recording.yaml";

/** Numbers, and the long hexadecimal ones of hashes. */
const NUMBER = /[0-9a-f]{12,}|\d+/gi;
const MOST_OF_A_GROUP = 8;
const MOST_GROUPS = 64;
const MOST_SAMPLE_BYTES = 32 * 1024 * 1024;

/** @typedef {{entry: Entry, frame: string}} Numbered  `frame`: the numbers of its path that differ within its group */

/**
 * Some images of each kind, of the same frames in each: what the server looks at.
 *
 * Images of a kind have the same path but for its numbers; nothing is read into words.
 * @param {readonly Entry[]} entries @returns {Promise<Set<Entry>>}
 */
export async function sampleOf(entries) {
  const images = entries.filter(({ path }) => IMAGE.test(path)).sort((a, b) => (a.path < b.path ? -1 : 1));
  const groups = groupsOf(images);
  let sample = /** @type {{entry: Entry, size: number}[]} */ ([]);
  for (let most = MOST_OF_A_GROUP; most >= 1; most /= 2) {
    const chosen = chosenFrom(groups, most);
    sample = await Promise.all(chosen.map(async (entry) => ({ entry, size: (await opened(entry)).size })));
    if (sample.reduce((sum, { size }) => sum + size, 0) <= MOST_SAMPLE_BYTES) break;
  }
  let left = MOST_SAMPLE_BYTES;
  const within = sample.filter(({ size }) => size <= left && (left -= size) >= 0);
  return new Set(within.map(({ entry }) => entry));
}

/** @param {readonly Entry[]} images @returns {Numbered[][]} the largest group first */
function groupsOf(images) {
  const byPath = grouped(images, (path) => path.replace(NUMBER, "#"));
  const folderOf = (/** @type {string} */ path) => path.slice(0, path.lastIndexOf("/") + 1);
  // Names that have nothing in common but their folder are one kind.
  const groups = byPath.length <= MOST_GROUPS ? byPath : grouped(images, (path) => folderOf(path).replace(NUMBER, "#"));
  return groups
    .sort((a, b) => b.length - a.length)
    .slice(0, MOST_GROUPS)
    .map(numbered);
}

/** @param {readonly Entry[]} images @param {(path: string) => string} nameOf @returns {Entry[][]} */
function grouped(images, nameOf) {
  /** @type {Map<string, Entry[]>} */
  const groups = new Map();
  for (const entry of images) {
    const name = nameOf(entry.path);
    const group = groups.get(name);
    if (group) group.push(entry);
    else groups.set(name, [entry]);
  }
  return [...groups.values()];
}

/** @param {readonly Entry[]} group @returns {Numbered[]} */
function numbered(group) {
  const numbers = group.map(({ path }) => (path.match(NUMBER) ?? []).map((text) => text.replace(/^0+(?=.)/, "")));
  const [first = []] = numbers;
  const differs = first.map((number, place) => numbers.some((others) => others[place] !== number));
  return group.map((entry, at) => {
    const differing = (numbers[at] ?? []).filter((_, place) => differs[place] ?? true);
    return { entry, frame: differing.join("/") };
  });
}

/** @param {readonly Numbered[][]} groups @param {number} most  of each group @returns {Entry[]} */
function chosenFrom(groups, most) {
  /** @type {Set<string>} */
  const frames = new Set();
  return groups.flatMap((group) => {
    const shared = group.filter(({ frame }) => frames.has(frame));
    const chosen = evenly(shared.length >= Math.min(most, group.length) ? shared : group, most);
    for (const { frame } of chosen) frames.add(frame);
    return chosen.map(({ entry }) => entry);
  });
}

/**
 * So many of a list, the first and the last among them.
 * @template T @param {readonly T[]} list @param {number} count @returns {T[]}
 */
function evenly(list, count) {
  if (list.length <= count) return [...list];
  const step = count > 1 ? (list.length - 1) / (count - 1) : 0;
  return Array.from({ length: count }, (_, at) => /** @type {T} */ (list[Math.round(at * step)]));
}

/** So many files of a drop are read as one, which takes half the time of reading each. */
const READ_AS_ONE = 64;

/**
 * Parts of a tar: all files but the description, and the dropped description, if there is one.
 * @typedef {{files: Blob, description: Blob}} Packed
 */

/**
 * Pack these files, of each what the server needs: see `partOf`.
 * @param {readonly Entry[]} entries @param {string} top  the folder of the description
 * @param {AbortSignal} signal @param {(done: number, of: number) => void} tell
 * @returns {Promise<Packed>}
 */
export async function pack(entries, top, signal, tell) {
  const sample = await sampleOf(entries);
  const name = recordingIn(top);
  const members = entries.map(({ path }) => headersOf(path, 0));
  const needed = [...entries.entries()].flatMap(([at, entry]) => {
    const most = sample.has(entry) ? Infinity : partOf(entry);
    return most > 0 ? [{ at, entry, most }] : [];
  });
  let done = 0;
  const groups = Array.from({ length: Math.ceil(needed.length / READ_AS_ONE) }, (_, at) =>
    needed.slice(at * READ_AS_ONE, (at + 1) * READ_AS_ONE),
  );
  await forEachOf(groups, signal, async (group) => {
    const contents = await contentsOf(group);
    for (const [place, { at, entry }] of group.entries())
      members[at] = memberOf(entry.path, contents[place] ?? new Uint8Array());
    tell((done += group.length), needed.length);
  });
  const place = entries.findIndex(({ path }) => path === name);
  const description = place < 0 ? [] : members.splice(place, 1).flat();
  return { files: new Blob([...inPieces(members.flat())]), description: new Blob(description) };
}

/**
 * The first bytes of each file, so many at most.
 * @param {readonly {entry: Entry, most: number}[]} group
 */
async function contentsOf(group) {
  const files = await Promise.all(group.map(({ entry }) => opened(entry)));
  const parts = files.map((file, at) => file.slice(0, Math.min(file.size, group[at]?.most ?? 0)));
  const together = await new Blob(parts).arrayBuffer().catch(() => null);
  // One of them cannot be read: which one, its own reading says.
  if (together === null) return Promise.all(group.map(({ entry, most }) => contentOf(entry, most)));
  let end = 0;
  return parts.map(({ size }) => new Uint8Array(together, (end += size) - size, size));
}

/** @typedef {ReadonlyMap<Entry, number>} Sizes  in bytes */

/** @param {readonly Entry[]} entries @param {AbortSignal} signal @returns {Promise<Sizes>} */
export async function sizesOf(entries, signal) {
  /** @type {Map<Entry, number>} */
  const sizes = new Map();
  await forEachOf(entries, signal, async (entry) => void sizes.set(entry, (await opened(entry)).size));
  return sizes;
}

const AT_ONCE = 32;

/**
 * Work on some of these at a time, and let the browser draw meanwhile.
 * @template T @param {readonly T[]} things @param {AbortSignal} signal @param {(thing: T) => Promise<void>} work
 */
async function forEachOf(things, signal, work) {
  const left = things.values();
  const pause = createPauses();
  const workOn = async () => {
    for (const thing of left) {
      signal.throwIfAborted();
      await pause();
      await work(thing);
    }
  };
  await Promise.all(Array.from({ length: AT_ONCE }, workOn));
}

/** @param {string} top */
const recordingIn = (top) => (top ? `${top}/${RECORDING}` : RECORDING);

/**
 * The tar of packed files.
 * @param {Packed} packed @param {string} top
 * @param {object | null} description  in place of the dropped one; JSON is YAML, too
 */
export function archiveOf({ files, description: dropped }, top, description) {
  const text = new TextEncoder().encode(JSON.stringify(description));
  const member = description ? memberOf(recordingIn(top), text) : [dropped];
  return new Blob([files, ...member, new Uint8Array(2 * BLOCK)], { type: "application/x-tar" });
}

const BLOCK = 512;

const PIECE_BYTES = 4 * 1024 * 1024;

/**
 * Join small parts into larger ones: a browser is slow at sending a body of tens of thousands of parts.
 * @param {readonly Uint8Array<ArrayBuffer>[]} parts
 */
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

/** How many bytes at most the server needs of a file that is not in the sample. @param {Entry} entry */
function partOf({ path }) {
  if (TEXT.test(path)) return Infinity;
  if (!SIZED.test(path)) return 0;
  return path.toLowerCase().endsWith(".png") ? PNG_SIZE_BYTES : JPEG_SIZE_BYTES;
}

/** @param {number} size */
const padding = (size) => (BLOCK - (size % BLOCK)) % BLOCK;

const NAME_BYTES = 100;

/** A file in a tar. @param {string} path @param {Uint8Array<ArrayBuffer>} content */
const memberOf = (path, content) => [
  ...headersOf(path, content.length),
  content,
  new Uint8Array(padding(content.length)),
];

/**
 * What stands before a file in a tar; a long name has an entry of its own.
 * @param {string} path @param {number} size
 */
function headersOf(path, size) {
  const name = new TextEncoder().encode(path);
  if (name.length <= NAME_BYTES) return [header(name, size, "0")];
  const long = new Uint8Array(name.length + 1 + padding(name.length + 1));
  long.set(name);
  const link = new TextEncoder().encode("././@LongLink");
  return [header(link, name.length + 1, "L"), long, header(name.subarray(0, NAME_BYTES), size, "0")];
}

const CHECKSUM_AT = 148;

/** @param {Uint8Array} name @param {number} size @param {string} type */
function header(name, size, type) {
  const block = new Uint8Array(BLOCK);
  /** @param {number} at @param {string} text */
  const write = (at, text) => block.set(new TextEncoder().encode(text), at);
  let sum = 0;
  /** @param {number} number @param {number} digits */
  const octal = (number, digits) => number.toString(8).padStart(digits, "0");
  block.set(name);
  // Mode, owner, group, size, time, an empty checksum, type; then what marks a POSIX tar.
  write(NAME_BYTES, `0000644\0${"0000000\0".repeat(2)}${octal(size, 11)}\0${"0".repeat(11)}\0        ${type}`);
  write(257, "ustar\x0000");
  for (const byte of block) sum += byte;
  write(CHECKSUM_AT, `${octal(sum, 6)}\0 `);
  return block;
}
