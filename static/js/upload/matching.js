// @ts-check
// Which files belong together: the same name in parallel folders, as the command line has it. No DOM.

/**
 * @typedef {object} Entry  a file that was dropped
 * @property {string} path  relative to what was dropped, with "/"
 * @property {number} size
 * @property {Blob} blob
 */

/** @typedef {{path: string, why: string}} Unmatched */
/** @typedef {{key: string, label: Entry, image: Entry | null, segmentation: Entry | null}} FrameFiles */

const IMAGE_SUFFIXES = [".png", ".jpg", ".jpeg"];

/** Names of folders that say what their files are, not which frame they belong to. */
const FOLDER_WORDS = new Set(["images", "image", "img", "jpegimages", "labels", "label", "annotations"]);

export const SEGMENTATION_FOLDERS = ["seg", "segmentation", "segmentations", "semantic"];

/** @param {string} path */
export const baseOf = (path) => path.slice(path.lastIndexOf("/") + 1);

/** @param {string} path @returns {string} with its dot, in small letters; empty without one */
export function suffixOf(path) {
  const base = baseOf(path);
  const dot = base.lastIndexOf(".");
  return dot > 0 ? base.slice(dot).toLowerCase() : "";
}

/** @param {Entry} entry */
export const isImage = ({ path }) => IMAGE_SUFFIXES.includes(suffixOf(path));

/** Hidden files and what some systems put into archives. @param {string} path */
export const isHidden = (path) => path.split("/").some((part) => part.startsWith(".") || part === "__MACOSX");

/** @param {string} a @param {string} b the order of code points, as the command line sorts */
const byCodePoint = (a, b) => (a < b ? -1 : a > b ? 1 : 0);

/** @template {{path: string}} E @param {readonly E[]} entries @returns {E[]} */
export const sorted = (entries) => [...entries].sort((a, b) => byCodePoint(a.path, b.path));

/**
 * The key of the frame that a file belongs to: without the last suffix and without folders
 * that say what kind of files they hold. Accents are composed: some systems store them apart.
 * @param {string} path
 */
export function frameKey(path) {
  const parts = path.normalize("NFC").split("/");
  const base = parts.pop() ?? "";
  const stem = base.slice(0, base.length - suffixOf(base).length);
  return [...parts.filter((part) => !FOLDER_WORDS.has(part.toLowerCase())), stem].join("/");
}

/** The files below a folder, with paths from there on. @param {readonly Entry[]} entries @param {string} folder empty: all @returns {Entry[]} */
export function below(entries, folder) {
  if (!folder) return [...entries];
  const start = `${folder}/`;
  return entries.filter(({ path }) => path.startsWith(start)).map((entry) => ({ ...entry, path: entry.path.slice(start.length) }));
}

/** @param {readonly Entry[]} entries @param {string} folder */
export const hasFolder = (entries, folder) => entries.some(({ path }) => path.startsWith(`${folder}/`));

/** One folder was dropped: paths begin inside of it. @param {readonly Entry[]} entries @returns {Entry[]} */
export function withoutTop(entries) {
  const [top = "", ...rest] = (entries[0]?.path ?? "").split("/");
  if (rest.length === 0 || !entries.every(({ path }) => path.startsWith(`${top}/`))) return [...entries];
  return below(entries, top);
}

/** Files by frame key; a second file of the same key is noted, not taken. */
class FileIndex {
  /** @param {readonly Entry[]} entries */
  constructor(entries) {
    /** @type {Map<string, Entry>} */
    this.byKey = new Map();
    /** @type {Unmatched[]} */
    this.unmatched = [];
    /** @type {Map<string, string | null>} key by last name; null where several end in it */
    this.byBase = new Map();
    for (const entry of sorted(entries)) {
      const key = frameKey(entry.path);
      const first = this.byKey.get(key);
      if (first) this.unmatched.push({ path: entry.path, why: `same frame as ${first.path}, which is used` });
      else {
        this.byKey.set(key, entry);
        this.byBase.set(baseOf(key), this.byBase.has(baseOf(key)) ? null : key);
      }
    }
    this.unused = new Map(this.byKey);
  }

  /** @param {string} key @param {boolean} byBase else the only one with its last name */
  take(key, byBase) {
    const found = this.byKey.has(key) || !byBase ? key : (this.byBase.get(baseOf(key)) ?? key);
    this.unused.delete(found);
    return this.byKey.get(found) ?? null;
  }

  /** @param {string} why @returns {Unmatched[]} */
  leftOver(why) {
    return [...this.unmatched, ...[...this.unused.values()].map(({ path }) => ({ path, why }))];
  }
}

/**
 * One entry per label file, in the order of the keys, and all that is left over.
 * @param {readonly Entry[]} labels @param {readonly Entry[]} images @param {readonly Entry[]} segmentations
 * @param {string} [what]  a label is called in messages
 * @returns {{frames: FrameFiles[], unmatched: Unmatched[]}}
 */
export function match(labels, images, segmentations, what = "label file") {
  const labelIndex = new FileIndex(labels);
  const imageIndex = new FileIndex(images);
  const tagIndex = new FileIndex(segmentations);
  const frames = [...labelIndex.byKey].sort(([a], [b]) => byCodePoint(a, b)).map(([key, label]) => {
    // Segmentations often lie in a flat folder beside labels in sub-folders, but only a
    // name that occurs once on both sides can be told by its end.
    const isAlone = labelIndex.byBase.get(baseOf(key)) === key;
    return { key, label, image: imageIndex.take(key, isAlone), segmentation: tagIndex.take(key, isAlone) };
  });
  const unmatched = [
    ...labelIndex.unmatched,
    ...imageIndex.leftOver(`no ${what} for this image`),
    ...tagIndex.leftOver(`no ${what} for this segmentation`),
  ];
  return { frames, unmatched };
}
