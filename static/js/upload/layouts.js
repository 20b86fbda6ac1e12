// @ts-check
// What was dropped as frames, by the layout that its files speak for, as `unghost push` does it;
// and plain pairs of pictures, which only the page takes. No DOM.

import { LabelError, readCarlasimuNames, readLabelLines, readNames, readYamlNames } from "./labels.js";
import { joined, jsonOf, readManifestLine } from "./manifest.js";
import { SEGMENTATION_FOLDERS, baseOf, below, hasFolder, isHidden, isImage, match, sorted, suffixOf, withoutTop } from "./matching.js";
import { readVoc } from "./voc.js";

/** @typedef {import("./matching.js").Entry} Entry */
/** @typedef {import("./matching.js").FrameFiles} FrameFiles */
/** @typedef {import("./manifest.js").ReadFrame} ReadFrame */
/** @typedef {import("./matching.js").Unmatched} Unmatched */
/** @typedef {"manifest" | "carlasimu" | "yolo" | "voc" | "pairs"} Layout */

/**
 * @typedef {object} Plan
 * @property {Layout} layout
 * @property {ReadFrame[]} frames
 * @property {{key: string, why: string}[]} problems  frames that cannot be read
 * @property {Unmatched[]} unmatched  files that belong to no frame
 * @property {string[] | null} classes  the layout's own list
 */

/** @type {Record<Layout, string>} */
export const LAYOUT_NAMES = { manifest: "Manifest", carlasimu: "carlasimu folder", yolo: "YOLO folder", voc: "Pascal VOC folder", pairs: "Images and segmentations" };

const CLASS_LISTS = ["data.yaml", "data.yml", "dataset.yaml", "classes.txt", "labels.txt", "obj.names"];

const TEXTS_AT_THE_TOP = new Set(["readme.txt", "requirements.txt", "train.txt", "val.txt", "test.txt"]);

const MAX_LABEL_BYTES = 16 * 1024 * 1024;

/** @param {Entry | null} image @param {Entry | null} segmentation @returns {Record<string, Entry>} */
const filesOf = (image, segmentation) => ({ ...(image && { image }), ...(segmentation && { segmentation }) });

/** @param {Entry} entry lies in a folder of segmentations */
const isTag = ({ path }) => SEGMENTATION_FOLDERS.includes(path.split("/")[0] ?? "");

/** @param {Entry} entry */
const stemOf = ({ path }) => baseOf(path).slice(0, -suffixOf(path).length || undefined);

/** @param {string} path */
const unfoldered = (path) => (SEGMENTATION_FOLDERS.includes(path.split("/")[0] ?? "") ? path.slice(path.indexOf("/") + 1) : path);

/** @type {Record<Layout, (entries: readonly Entry[], tick: () => void) => Promise<Plan>>} */
const READERS = { manifest: readManifest, carlasimu: readCarlasimu, yolo: readYolo, voc: readVocFolder, pairs: readPairs };

/** What the files can be, the likeliest first; empty when nothing fits. @param {readonly Entry[]} entries @returns {Layout[]} */
export function layoutsOf(entries) {
  if (manifestOf(entries)) return ["manifest"];
  if (cameraOf(entries) !== null) return ["carlasimu"];
  /** @type {Layout[]} */
  const found = [];
  if (entries.some(({ path }) => suffixOf(path) === ".xml")) found.push("voc");
  if (entries.some(isLabel) && classListOf(entries)) found.push("yolo");
  if (found.length === 0 && entries.some(isImage)) found.push("pairs");
  return found;
}

/** The entries as layouts see them: inside of the one folder, without what is hidden. @param {readonly Entry[]} dropped */
export const visibleEntries = (dropped) => withoutTop(sorted(dropped.filter(({ path }) => !isHidden(path))));

/** @param {readonly Entry[]} entries @param {Layout} layout @param {() => void} [tick] called for each label that was read */
export const readLayout = (entries, layout, tick = () => {}) => READERS[layout](entries, tick);

/** @param {readonly Entry[]} entries */
function manifestOf(entries) {
  const lines = entries.filter(({ path }) => suffixOf(path) === ".jsonl");
  return lines.find(({ path }) => path === "manifest.jsonl") ?? (lines.length === 1 ? lines[0] : undefined) ?? null;
}

/** @param {readonly Entry[]} entries @param {() => void} tick @returns {Promise<Plan>} */
async function readManifest(entries, tick) {
  const manifest = /** @type {Entry} */ (manifestOf(entries));
  const folder = manifest.path.slice(0, -baseOf(manifest.path).length);
  const byPath = new Map(entries.map((entry) => [entry.path, entry]));
  /** @type {Set<Entry>} */
  const used = new Set([manifest]);
  /** @param {string} path */
  const find = (path) => {
    const entry = byPath.get(joined(folder, path) ?? "") ?? null;
    if (entry) used.add(entry);
    return entry;
  };
  const lines = (await manifest.blob.text()).split("\n").map((line, i) => ({ line, at: `${baseOf(manifest.path)}, line ${i + 1}` }));
  const read = await each(lines.filter(({ line }) => line.trim()), tick, ({ at }) => at, ({ line, at }) => readManifestLine(line, at, find));
  const unmatched = entries.filter((entry) => !used.has(entry)).map(({ path }) => ({ path, why: "no line of the manifest names it" }));
  return { layout: "manifest", ...read, unmatched, classes: null };
}

/** The folder with carlasimu's labels, "" for the one dropped. @param {readonly Entry[]} entries @returns {string | null} */
function cameraOf(entries) {
  const folders = new Set(entries.filter(({ path }) => path.split("/").length > 2).map(({ path }) => path.split("/")[0] ?? ""));
  return ["", ...[...folders].sort()].find((folder) => bandsOf(below(entries, folder)).length > 0) ?? null;
}

/** carlasimu's folders of labels, the widest distance band last. @param {readonly Entry[]} entries */
function bandsOf(entries) {
  const bands = new Set(entries.flatMap(({ path }) => /^labels\/label(\d+)\//i.exec(path)?.[1] ?? []));
  if (bands.size === 0) return hasFolder(entries, "label") ? ["label"] : [];
  const folders = new Set(entries.flatMap(({ path }) => /^(labels\/label\d+)\//i.exec(path)?.[1] ?? []));
  return [...folders].sort((a, b) => Number(a.replace(/\D/g, "")) - Number(b.replace(/\D/g, "")));
}

/** @param {readonly Entry[]} entries @param {() => void} tick @returns {Promise<Plan>} */
async function readCarlasimu(entries, tick) {
  const camera = below(entries, cameraOf(entries) ?? "");
  const bands = bandsOf(camera);
  const labels = bands.at(-1) ?? "";
  const images = ["images", "img"].find((folder) => hasFolder(camera, folder)) ?? labels;
  const readme = camera.find(({ path }) => path === "Readme.txt");
  const classes = readCarlasimuNames(readme ? await readme.blob.text() : "");
  const tags = tagsOf(camera).length ? tagsOf(camera) : tagsOf(entries);
  const found = match(below(camera, labels).filter(({ path }) => suffixOf(path) === ".txt"), below(camera, images).filter(isImage), tags);
  return { layout: "carlasimu", ...(await readFrames(found, tick, (text, name) => ({ boxes: readLabelLines(text, name, classes) }))), classes };
}

/** @param {readonly Entry[]} entries @param {() => void} tick @returns {Promise<Plan>} */
async function readYolo(entries, tick) {
  const list = /** @type {Entry} */ (classListOf(entries));
  const text = await textOf(list);
  const classes = /\.ya?ml$/.test(list.path) ? readYamlNames(text, list.path) : readNames(text);
  const rest = entries.filter((entry) => entry !== list && !isTag(entry));
  const found = match(rest.filter(isLabel), rest.filter(isImage), tagsOf(entries));
  const plan = await readFrames(found, tick, (lines, name) => ({ boxes: readLabelLines(lines, name, classes) }));
  return { layout: "yolo", ...plan, unmatched: [...plan.unmatched, ...strange(rest, [".txt", ".yaml", ".yml", ".names"])], classes };
}

/** @param {readonly Entry[]} entries @param {() => void} tick @returns {Promise<Plan>} */
async function readVocFolder(entries, tick) {
  const rest = entries.filter((entry) => !isTag(entry));
  const found = match(rest.filter(({ path }) => suffixOf(path) === ".xml"), rest.filter(isImage), tagsOf(entries));
  const plan = await readFrames(found, tick, readVoc);
  return { layout: "voc", ...plan, unmatched: [...plan.unmatched, ...strange(rest, [".xml"])], classes: null };
}

/** Images with their segmentations, and each frame's annotation where a .json of its name lies by. @param {readonly Entry[]} entries @param {() => void} tick @returns {Promise<Plan>} */
async function readPairs(entries, tick) {
  const tagged = entries.filter((entry) => isImage(entry) && (isTag(entry) || /[-_. ](seg|segmentation|semantic)$/i.test(stemOf(entry))));
  const images = entries.filter((entry) => isImage(entry) && !tagged.includes(entry));
  const texts = entries.filter(({ path }) => suffixOf(path) === ".json");
  const plain = tagged.map((entry) => ({ ...entry, path: unfoldered(entry.path).replace(/[-_. ](seg|segmentation|semantic)(\.\w+)$/i, "$2") }));
  const found = match(images, texts, plain, "image");
  const frames = await each(found.frames, tick, ({ key }) => key, async ({ key, label, image, segmentation }) => ({
    key,
    annotation: image ? /** @type {Record<string, unknown>} */ (jsonOf(await textOf(image), image.path)) : { boxes: [] },
    files: filesOf(label, segmentation),
  }));
  const named = found.unmatched.map(({ path, why }) => ({ path, why: foreignWords(path) ?? (suffixOf(path) === ".json" ? "no image of this name" : why.replace("for this image", "for this file")) }));
  return { layout: "pairs", ...frames, unmatched: [...named, ...strange(entries, [".json"])], classes: null };
}

/**
 * @param {{frames: FrameFiles[], unmatched: Unmatched[]}} found @param {() => void} tick
 * @param {(text: string, name: string) => Record<string, unknown>} read
 */
async function readFrames({ frames, unmatched }, tick, read) {
  const done = await each(frames, tick, ({ key }) => key, async ({ key, label, image, segmentation }) => ({
    key,
    annotation: read(await textOf(label), label.path),
    files: filesOf(image, segmentation),
  }));
  return { ...done, unmatched };
}

/**
 * One after the other; a fault is that frame's, and the others go on.
 * @template T
 * @param {readonly T[]} items @param {() => void} tick @param {(item: T) => string} keyOf @param {(item: T) => ReadFrame | Promise<ReadFrame>} read
 * @returns {Promise<{frames: ReadFrame[], problems: {key: string, why: string}[]}>}
 */
async function each(items, tick, keyOf, read) {
  const frames = [];
  const problems = [];
  for (const item of items) {
    try {
      frames.push(await read(item));
    } catch (error) {
      problems.push({ key: keyOf(item), why: error instanceof Error ? error.message : String(error) });
    }
    tick();
  }
  return { frames, problems };
}

/** @param {Entry} entry */
async function textOf({ blob, path, size }) {
  if (size > MAX_LABEL_BYTES) throw new LabelError(`${path}: expected at most ${MAX_LABEL_BYTES} bytes, found ${size}`);
  return blob.text();
}

/** The first of the usual folders that is there. @param {readonly Entry[]} entries */
function tagsOf(entries) {
  const folder = SEGMENTATION_FOLDERS.find((name) => hasFolder(entries, name));
  return folder ? below(entries, folder).filter(isImage) : [];
}

/** A text file that holds boxes. @param {Entry} entry */
function isLabel({ path }) {
  const name = path.toLowerCase();
  const folder = name.slice(0, Math.max(0, name.lastIndexOf("/")));
  return suffixOf(name) === ".txt" && !["classes.txt", "labels.txt"].includes(baseOf(name)) && !TEXTS_AT_THE_TOP.has(folder || baseOf(name));
}

/** @param {readonly Entry[]} entries */
function classListOf(entries) {
  const places = [...CLASS_LISTS, ...CLASS_LISTS.map((name) => `labels/${name}`)];
  const byPath = new Map(entries.map((entry) => [entry.path, entry]));
  return places.map((name) => byPath.get(name)).find(Boolean) ?? null;
}

/** Labels that only the command line reads. @param {string} path */
function foreignWords(path) {
  if (/(^|\/)label_0?[23]\/[^/]*\.txt$/i.test(path)) return "KITTI labels: use unghost push";
  if (/(^|\/)annotations\/[^/]*\.json$|(^|\/)(instances_[^/]*|[^/]*coco[^/]*)\.json$/i.test(path)) return "COCO labels: use unghost push";
  return null;
}

/** What is no picture and none of these. @param {readonly Entry[]} entries @param {readonly string[]} suffixes @returns {Unmatched[]} */
function strange(entries, suffixes) {
  const others = entries.filter((entry) => !isImage(entry) && !suffixes.includes(suffixOf(entry.path)));
  return others.map(({ path }) => ({ path, why: foreignWords(path) ?? (suffixOf(path) === ".txt" ? "labels need their class names: a data.yaml or classes.txt" : "neither an image nor a label") }));
}
