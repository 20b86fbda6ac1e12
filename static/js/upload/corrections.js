// @ts-check
// A person's corrections of how dropped files are understood: each changes one key of their description. No DOM.

/** @typedef {import("../core/openapi.js").FolderStream} Stream */

/**
 * @typedef {object} Correction
 * @property {readonly string[]} place  of the key in the description; `["files", pattern]`: the role of a stream
 * @property {string | Readonly<Record<string, string>>} value  of a stream: "" is not used
 * @property {string} text  for people: "Classes: caar measured as car"
 */

/** @typedef {Readonly<Record<string, any>>} Description  as recording.yaml has it */

/** The roles that a stream can be given, and what they are for people. @type {Readonly<Record<string, string>>} */
export const ROLES = {
  image: "picture",
  segmentation: "segmentation",
  depth: "depth",
  instances: "instances",
  ignore_mask: "ignored regions",
};

/** @param {Correction} a @param {Correction} b */
const isOfOneKey = (a, b) => a.place.join("\n") === b.place.join("\n");

/** Whether two streams are given one role, which only one can have. @param {Correction} a @param {Correction} b */
const isOfOneRole = (a, b) => a.place[0] === "files" && b.place[0] === "files" && a.value !== "" && a.value === b.value;

/**
 * @param {readonly Correction[]} corrections
 * @param {Correction} next  replaces an earlier one of the same key or role
 */
export const corrected = (corrections, next) => [
  ...corrections.filter((earlier) => !isOfOneKey(earlier, next) && !isOfOneRole(earlier, next)),
  next,
];

/**
 * What a person corrected of a key that has a word as its value; undefined: nothing.
 * @param {readonly Correction[]} corrections @param {readonly string[]} place
 */
export const correctionOf = (corrections, place) =>
  /** @type {string | undefined} */ (
    corrections.find((correction) => isOfOneKey(correction, { place, value: "", text: "" }))?.value
  );

/**
 * The description with a person's corrections.
 * @param {Description} before  that of the folder @param {readonly Stream[]} streams  as they were recognised
 * @param {readonly Correction[]} corrections @returns {Description}
 */
export function descriptionOf(before, streams, corrections) {
  const ofStreams = corrections.filter(({ place }) => place[0] === "files");
  const description = corrections
    .filter((correction) => !ofStreams.includes(correction))
    .reduce((changed, { place, value }) => withValue(changed, place, value), before);
  if (ofStreams.length === 0) return description;
  const roles = new Map(ofStreams.map(({ place, value }) => [String(place[1]), String(value)]));
  return { ...description, files: filesOf(description.files ?? {}, streams, roles) };
}

/**
 * The streams as they are used now: once files are described, those that are not named are not used.
 * @param {readonly Stream[]} streams  as they were recognised @param {readonly Stream[]} used
 * @param {readonly Correction[]} corrections @returns {readonly Stream[]}
 */
export function streamsWith(streams, used, corrections) {
  if (!corrections.some(({ place }) => place[0] === "files")) return used;
  return streams.map((stream) => {
    const now = used.find(({ pattern }) => pattern !== null && pattern === stream.pattern);
    return now ?? { ...stream, role: "", told_by: [] };
  });
}

/** What the four numbers of a box may be, each with its fields. */
export const NOTATIONS = [
  { value: "xyxy", text: "two corners", fields: ["x1", "y1", "x2", "y2"] },
  { value: "xywh", text: "corner and size", fields: ["x1", "y1", "width", "height"] },
  { value: "cxcywh", text: "centre and size", fields: ["cx", "cy", "width", "height"] },
];

/** Fields that need no column, each with how a column for it may be called. */
const OTHER_FIELDS = { class: /class|label|categ|type|name/i, frame: /frame|image|img|file/i };

/**
 * The columns of a table of boxes, by the names in its first line; none if it has no such line.
 * @param {string} text  its beginning
 */
export function columnsOf(text) {
  const [line = ""] = text.replace(/^\ufeff/, "").split(/\r?\n/, 1);
  const cells = ["\t", ";", ","].map((delimiter) => line.split(delimiter)).sort((a, b) => b.length - a.length)[0] ?? [];
  const names = cells.map((name) => name.trim().replace(/^"(.*)"$/, "$1"));
  return names.length >= 4 && names.every((name) => name && !Number.isFinite(Number(name))) ? names : [];
}

/**
 * The columns that probably hold the class and the frame.
 * @param {readonly string[]} columns @returns {Record<string, string>}
 */
export const likelyFields = (columns) =>
  Object.fromEntries(
    Object.entries(OTHER_FIELDS).flatMap(([field, names]) => {
      const column = columns.find((name) => names.test(name));
      return column ? [[field, column]] : [];
    }),
  );

/**
 * The corrections by which files are tables with these columns.
 * @param {Readonly<Record<string, string>>} fields  columns by field @returns {Correction[]}
 */
export const tableWith = (fields) => [
  { place: ["layout"], value: "table", text: "Layout: Tables of boxes" },
  { place: ["boxes", "fields"], value: fields, text: `Columns: ${Object.values(fields).join(", ")}` },
];

/**
 * @param {Description} before
 * @param {readonly string[]} place
 * @param {Correction["value"]} value
 * @returns {Description}
 */
function withValue(before, [key = "", ...below], value) {
  return { ...before, [key]: below.length > 0 ? withValue(before[key] ?? {}, below, value) : value };
}

/**
 * `files` of a description, which names every stream once it names one: another one's pattern may fit it, too.
 * @param {Description} before @param {readonly Stream[]} streams @param {ReadonlyMap<string, string>} roles  by pattern
 * @returns {Description}
 */
function filesOf({ ignore = [], ...before }, streams, roles) {
  const kept = Object.entries(before).filter(([, pattern]) => !roles.has(pattern));
  const recognised = streams
    .filter(({ role, pattern }) => role in ROLES && pattern !== null && !roles.has(pattern))
    .map(({ role, pattern }) => [role, pattern]);
  const chosen = [...roles].flatMap(([pattern, role]) => (role ? [[role, pattern]] : []));
  // The first stream of a role is that of the frames; what a person chose counts most.
  const files = Object.fromEntries([...recognised.reverse(), ...kept, ...chosen]);
  const used = Object.values(files);
  const all = [...ignore, ...streams.flatMap(({ pattern }) => pattern ?? [])];
  const unused = all.filter((pattern) => !used.includes(pattern));
  return unused.length > 0 ? { ...files, ignore: [...new Set(unused)] } : files;
}
