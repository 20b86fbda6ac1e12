// @ts-check
// Texts for reasons, verdicts and numbers of a box, the same in all views.
//
// A decision comes with a sentence that explains it (`explanation`, composed in
// filter_core/decisions/explain.py), which the inspector shows. It is too long for a label on an image or a row of a
// list, so the page words those itself, from the same numbers. Where a channel decided, it takes the sentence.

import { exactPercentText, metresText, percentText, unbroken, wholePercentText } from "../core/numbers.js";

/** @import { FlipSide } from "../core/openapi.js" */
/** @import { Decision, Verdict } from "./box.js" */

/**
 * Short names of the reasons, in the order of `ReasonLabel` in filter_core/verdicts.py.
 * @type {Record<string, string>}
 */
export const REASONS = {
  outside_image: "outside the image",
  covers_image: "covers the image",
  degenerate: "no area",
  out_of_range: "out of range",
  unmapped_class: "class not known",
  no_segmentation: "not measured",
  no_visible_pixels: "too few visible pixels",
  large_below_threshold: "large, below threshold",
  below_threshold: "below threshold",
  explained_by_nearer: "its pixels belong to nearer boxes",
  hidden_by_depth: "hidden by depth",
  hidden_by_instance: "too few instance pixels",
  too_few_lidar_points: "too few LiDAR points",
  visible: "visible",
  passed: "not to be measured",
  unknown_pixels: "unknown pixels",
};

/** In a blind review: in place of what the filter and others say. */
const WITHHELD = "hidden until you answer";

/** @param {string} reason */
export const reasonText = (reason) =>
  reason === "withheld" ? WITHHELD : (REASONS[reason] ?? reason.replaceAll("_", " "));

/** @type {Record<Verdict, string>} the sign that goes with the colour */
export const VERDICT_SIGN = { kept: "✓", rejected: "✕", unmeasured: "?", withheld: "•" };

/** @type {Record<string, string>} */
export const ANSWER_TEXT = { keep: "keep", reject: "reject", unsure: "unsure", clear: "removed the answer" };

/** "Car" or "Motorcycle + Rider". @param {Decision} box */
export const acceptedText = (box) => box.accepted_tags?.map(({ name }) => name).join(" + ") || box.class;

/**
 * Whether no channel decided the box: the share of matching pixels did, or nothing was measured.
 * @param {Decision} box
 */
export const isByShare = ({ evidence }) => !evidence || evidence === "semantic";

/** The share of matching pixels if it decided, else an empty text. @param {Decision} box */
export const matchText = (box) => (isMeasured(box) && isByShare(box) ? shareText(box) : "");

/**
 * What the box's label says: "4.1 % Car < 10 % · hidden by Vegetation 71 %"; if a channel decided, the server's
 *   sentence.
 * @param {Decision} box
 */
export function labelText(box) {
  // The server's sentence after its verdict: "its Car pixels belong to nearer boxes, above all car 122".
  if (!isByShare(box)) return box.explanation?.replace(/^\w+: /, "") || reasonText(box.reason);
  const most = box.verdict === "rejected" && box.hidden_by?.[0];
  return measureText(box) + (most ? ` · hidden by ${most.name} ${wholePercentText(most.percent)}` : "");
}

/**
 * Names of the kinds of evidence, what each measures, and the same in plain words.
 * @type {Record<string, {text: string, about: string, plain: string}>}
 */
export const EVIDENCE = {
  auto: {
    text: "Strongest evidence",
    about: "instances, depth, order or tags, as a frame allows",
    plain: "Each box by the strongest evidence that its frame allows: instances, else depth, else order, else tags.",
  },
  semantic: {
    text: "Segmentation",
    about: "pixels of the class in the box",
    plain:
      "Counts the pixels in the box whose tag fits its class. " +
      "A car behind another car counts, too: both are tagged Car.",
  },
  ordered: {
    text: "Order",
    about: "the nearest box takes its pixels first",
    plain:
      "Nearer boxes take their pixels first. A box that is left with too few is hidden. " +
      "Needs distances or 3D boxes.",
  },
  depth: {
    text: "Depth",
    about: "pixels as far away as the box",
    plain: "Counts only pixels that are as far away as the 3D box itself. Needs depth images.",
  },
  depth_center: {
    text: "Depth at the centre",
    about: "what is seen in the middle",
    plain: "Looks at one pixel, in the middle of the box. Others do it so; it is here for comparison.",
  },
  instance: {
    text: "Instances",
    about: "pixels of the object itself",
    plain: "Counts the pixels of this very object. Needs CARLA's instance images.",
  },
  lidar: {
    text: "LiDAR",
    about: "points in the 3D box",
    plain: "Counts LiDAR points in the 3D box. Far objects have few; it is here for comparison.",
  },
};

/** @param {string} name */
export const evidenceText = (name) => EVIDENCE[name]?.text ?? name.replaceAll("_", " ");

/** The distance of a box, or between which distances it is; null if neither is known. @param {Decision} box */
export const distanceText = ({ distance, distance_range: range }) => {
  if (distance !== null) return metresText(distance);
  return range ? `${range[0]} to ${metresText(range[1])}` : null;
};

const FAR_M = 100;

/** Boxes that are farther away fade, until a person asks for them. @param {Decision} box */
export const isFar = ({ distance, distance_range: range }) => (distance ?? range?.[0] ?? 0) > FAR_M;

/** @param {Decision} box */
function measureText(box) {
  const tags = acceptedText(box);
  switch (box.reason) {
    case "visible":
      return isMeasured(box) ? `${shareText(box)} ${tags}${thresholdText(box, "≥")}` : "visible";
    case "below_threshold":
    case "large_below_threshold":
      // A box that is rejected at exactly its threshold was decided under profile carlasimu, where that is too low.
      return `${shareText(box)} ${tags}${thresholdText(box, box.match_percent === box.threshold ? "≤" : "<")}`;
    case "no_visible_pixels":
      return box.matched_pixels
        ? `too few ${tags.replaceAll(" + ", " or ")} pixels`
        : `no ${tags.replaceAll(" + ", " or ")} pixel`;
    case "out_of_range":
      return `${distanceText(box) ?? "–"}: out of range`;
    case "withheld":
      return `${box.class} ${box.id}`;
    default:
      return reasonText(box.reason);
  }
}

/** @param {Decision} box */
const isMeasured = (box) => box.match_percent !== null && box.match_percent !== undefined;

/** @param {Decision} box @param {string} sign */
const thresholdText = (box, sign) => (box.threshold === null ? "" : ` ${sign} ${exactPercentText(box.threshold)}`);

/** The share of matching pixels, on its side of the threshold. @param {Decision} box */
const shareText = ({ match_percent: match, threshold }) => percentText(match, threshold);

/** What led to a verdict: "match 16.2 % < 16.5 %", or the reason where no threshold applied. @param {FlipSide} side */
export function causeText({ verdict, reason, match_percent: match, threshold }) {
  if (match === null || threshold === null) return reasonText(reason);
  const sign = verdict === "kept" ? "≥" : match === threshold ? "≤" : "<";
  const what = reason === "large_below_threshold" ? "large, match" : "match";
  return unbroken(`${what} ${percentText(match, threshold)} ${sign}\u00a0${exactPercentText(threshold)}`);
}

/** What the smallest label says: "car 4.1 %". @param {Decision} box */
export function shortText(box) {
  return isMeasured(box) && isByShare(box) ? `${box.class} ${shareText(box)}` : box.class;
}

/** One sentence for screen readers. @param {Decision} box */
export function spokenText(box) {
  if (box.verdict === "withheld") return `${box.class} ${box.id}, ${WITHHELD}`;
  const answer = box.review && box.review.verdict !== "clear" ? `, answered ${box.review.verdict}` : "";
  return `${box.class} ${box.id}, ${box.verdict}${answer}: ${labelText(box)}`;
}
