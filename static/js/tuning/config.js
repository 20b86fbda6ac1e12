// @ts-check
// A configuration that is tried out: edits, differences, link, YAML. Pure functions.

/** @import { FilterConfigIn as ConfigBody } from "../core/openapi.js" */
/** @typedef {string | number | null | readonly (string | number)[] | Readonly<Record<string, string>>} ConfigValue */
/** @typedef {Readonly<Record<string, ConfigValue | undefined>>} Values  by their keys */
/** @typedef {Record<string, ConfigValue | undefined>} Edits  by path; undefined removes a class's own value */
/** @typedef {{path: string, before: ConfigValue | undefined, after: ConfigValue | undefined}} Difference */

/** Keys for the share of its pixels that a box needs: with a tag of its class; of its own, where that can be told. */
export const THRESHOLD = "threshold_small_box";
export const OWN_SHARE = "min_visible_percent";

/** The value in a link for a class whose own value is removed. */
const FOLLOW = "follow";

/** Names that mean the same class. @type {Record<string, string>} */
const ALIASES = { street_light: "traffic_light" };

/** @param {string} name @param {string} [key] */
export const classPath = (name, key = THRESHOLD) => `classes.${ALIASES[name] ?? name}.${key}`;

/** The values for all classes. @param {ConfigBody} config @returns {Values} */
const globalsOf = ({ classes: _, ...values }) => values;

/**
 * The values of single classes that differ, by the names of the classes.
 * @param {ConfigBody} config @returns {Readonly<Record<string, Values>>}
 */
const overridesOf = ({ classes }) =>
  Object.fromEntries(
    Object.entries(classes ?? {}).map(([name, own]) => [name, typeof own === "string" ? { measures_as: own } : own]),
  );

/** Class names may have dots, keys have none. @param {string} path @returns {{name: string | null, key: string}} */
function parsePath(path) {
  const match = /^classes\.(.+)\.(\w+)$/.exec(path);
  return match ? { name: match[1] ?? "", key: match[2] ?? "" } : { name: null, key: path };
}

/**
 * @param {ConfigBody} config @param {string} path @returns {ConfigValue | undefined} undefined: not set for this class
 */
export function valueOf(config, path) {
  const { name, key } = parsePath(path);
  return (name === null ? globalsOf(config) : overridesOf(config)[name])?.[key];
}

/**
 * The value of a key, or its default if the version is older than the key.
 * @param {ConfigBody} config @param {{key: string, initial: unknown}} field @returns {ConfigValue | undefined}
 */
export function keyValue(config, { key, initial }) {
  const own = valueOf(config, key);
  return own === undefined ? /** @type {ConfigValue} */ (initial) : own;
}

/** What a dataset's settings are unless they were changed. */
const UNSET = ["auto", "refuse"];

/**
 * The dataset's own setting, if it is used in place of this key of the configuration; else "".
 * @param {Readonly<Record<string, unknown>>} dataset @param {ConfigBody} config
 * @param {{key: string, initial: unknown}} field
 */
export function ownSetting(dataset, config, field) {
  const own = dataset[field.key];
  return typeof own === "string" && isReading(field.key) && !UNSET.includes(own) && own !== keyValue(config, field)
    ? own
    : "";
}

/** Whether a key of the configuration is a setting of datasets, too. @param {string} key */
export const isReading = (key) => ["palette", "encoding", "channel_order", "lossy_segmentation"].includes(key);

/**
 * The value that applies to a class: its own, or the one for all classes.
 * @param {ConfigBody} config @param {string} name @param {string} [key] @returns {ConfigValue | undefined}
 */
export function appliesTo(config, name, key = THRESHOLD) {
  const own = valueOf(config, classPath(name, key));
  return own === undefined ? valueOf(config, key) : own;
}

/** @param {ConfigBody} config @param {Edits} edits @returns {ConfigBody} */
export function withEdits(config, edits) {
  /** @type {Record<string, ConfigValue | undefined>} */
  const changed = { ...globalsOf(config) };
  const classes = { ...overridesOf(config) };
  for (const [path, value] of Object.entries(edits)) {
    const { name, key } = parsePath(path);
    if (name === null) {
      if (value !== undefined) changed[key] = value;
      continue;
    }
    const { [key]: _, ...rest } = classes[name] ?? {};
    classes[name] = value === undefined ? rest : { ...rest, [key]: value };
    if (Object.keys(classes[name]).length === 0) delete classes[name];
  }
  return /** @type {ConfigBody} */ ({ ...changed, classes });
}

/** Only what really differs. @param {ConfigBody} config @param {Edits} edits @returns {Edits} */
export const effectiveEdits = (config, edits) =>
  Object.fromEntries(Object.entries(edits).filter(([path, value]) => !isSame(valueOf(config, path), value)));

/** @param {ConfigValue | undefined} a @param {ConfigValue | undefined} b */
const isSame = (a, b) => JSON.stringify(a) === JSON.stringify(b);

/**
 * The keys in which two configurations differ, those for all classes first.
 * @param {ConfigBody} before @param {ConfigBody} after @returns {Difference[]}
 */
export function differences(before, after) {
  const paths = new Set([...pathsOf(before), ...pathsOf(after)]);
  return [...paths]
    .map((path) => ({ path, before: valueOf(before, path), after: valueOf(after, path) }))
    .filter((row) => !isSame(row.before, row.after));
}

/** @param {ConfigBody} config @returns {string[]} */
function pathsOf(config) {
  const own = Object.entries(overridesOf(config)).flatMap(([name, keys]) =>
    Object.keys(keys).map((key) => `classes.${name}.${key}`),
  );
  return [...Object.keys(globalsOf(config)), ...own];
}

/**
 * The edits that turn one configuration into another.
 * @param {ConfigBody} before @param {ConfigBody} after @returns {Edits}
 */
export const editsBetween = (before, after) =>
  Object.fromEntries(differences(before, after).map((row) => [row.path, row.after]));

/**
 * The parts of an address that are about the configuration.
 * @param {ConfigBody} config @param {Record<string, string>} query @returns {Record<string, string>}
 */
export const configQuery = (config, query) =>
  Object.fromEntries(
    Object.entries(query).filter(([path]) => parsePath(path).name !== null || (path in config && path !== "classes")),
  );

/**
 * The edits that an address names; without those that are no number where one is needed.
 * @param {ConfigBody} config @param {Record<string, string>} query @returns {Edits}
 */
export function editsOf(config, query) {
  const known = Object.entries(configQuery(config, query));
  const edits = known.map(
    ([path, text]) => /** @type {const} */ ([path, text === FOLLOW ? undefined : parseValue(text)]),
  );
  const usable = edits.filter(
    ([path, value]) => typeof value !== "string" || typeof valueOf(config, parsePath(path).key) !== "number",
  );
  return effectiveEdits(config, Object.fromEntries(usable));
}

/** @param {string} text @returns {ConfigValue} */
function parseValue(text) {
  try {
    return JSON.parse(text);
  } catch {
    return text;
  }
}

/** @param {Edits} edits @returns {Record<string, string>} */
export const queryOf = (edits) =>
  Object.fromEntries(
    Object.entries(edits).map(([path, value]) => [
      path,
      value === undefined ? FOLLOW : typeof value === "string" ? value : JSON.stringify(value),
    ]),
  );

/** @param {ConfigValue | undefined} value */
export function valueText(value) {
  if (value === undefined) return "as for all";
  if (value === null) return "none";
  if (Array.isArray(value)) return value.join(", ");
  if (typeof value !== "object") return String(value);
  return (
    Object.entries(value)
      .map((entry) => entry.join(": "))
      .join(", ") || "none"
  );
}

/** The whole configuration as YAML. @param {ConfigBody} config */
export function toYaml(config) {
  const lines = Object.entries(globalsOf(config)).map(([key, value]) => `${key}: ${yamlValue(value ?? null)}`);
  const classes = Object.entries(overridesOf(config));
  if (classes.length === 0) return [...lines, "classes: {}", ""].join("\n");
  const own = classes.flatMap(([name, keys]) => [
    `  ${yamlValue(name)}:`,
    ...Object.entries(keys).map(([key, value]) => `    ${key}: ${yamlValue(value ?? null)}`),
  ]);
  return [...lines, "classes:", ...own, ""].join("\n");
}

/** JSON is YAML; plain words need no quotes. @param {ConfigValue} value */
function yamlValue(value) {
  if (
    typeof value === "string" &&
    /^[a-zA-Z][\w.-]*$/.test(value) &&
    !/^(true|false|null|yes|no|on|off|y|n)$/i.test(value)
  )
    return value;
  return Array.isArray(value) ? `[${value.map(yamlItem).join(", ")}]` : JSON.stringify(value);
}

/** @param {string | number} value @returns {string} */
const yamlItem = (value) => yamlValue(value);

/**
 * The suggestions that are worth a change: another value with a better F1, or, for the target "recall", any other
 * value.
 * @template {{current: number, suggested: number, f1_current: number | null, f1_suggested: number | null}} T
 * @param {readonly T[]} suggested @param {string} [target] @returns {T[]}
 */
export const worthTrying = (suggested, target = "f1") =>
  suggested.filter(
    (one) => one.suggested !== one.current && (target !== "f1" || (one.f1_suggested ?? 0) > (one.f1_current ?? 0)),
  );

/** The edits that take suggested thresholds. @param {readonly import("../core/openapi.js").Suggestion[]} suggested */
export const editsFor = (suggested) =>
  Object.fromEntries(suggested.map(({ class: name, key, suggested: value }) => [classPath(name, key), value]));
