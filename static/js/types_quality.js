// @ts-check
// The shapes of the comparison of the filter with people, as JSDoc types. No code here.

/**
 * @typedef {{value: number, low: number, high: number}} Measure  0 to 1, with a 95 % interval
 * @typedef {"kept_keep" | "kept_reject" | "rejected_keep" | "rejected_reject"} Cell  the filter's word, then a person's
 * @typedef {Record<Cell, number> & {precision: Measure | null, recall: Measure | null, f1: Measure | null}} Confusion
 * @typedef {{threshold: number, precision: number | null, recall: number | null, f1: number | null}} CurvePoint
 */

/**
 * @typedef {object} Suggestion
 * @property {string} class
 * @property {number} current  threshold
 * @property {number} suggested
 * @property {[number, number] | null} interval
 * @property {number} answers
 * @property {number | null} f1_current
 * @property {number | null} f1_suggested
 * @property {CurvePoint[]} curve
 */

/**
 * @typedef {object} Agreement
 * @property {number} boxes  answered by more than one person
 * @property {number} agreed
 * @property {number | null} percent
 * @property {number | null} kappa
 * @property {[number, number] | null} interval  of kappa
 * @property {{a: string, b: string, boxes: number, agreed: number, kappa: number | null}[]} pairs
 */

/**
 * @typedef {"people" | "instances"} Truth
 * @typedef {object} Quality
 * @property {Truth} truth
 * @property {number} reviewed
 * @property {number} unsure
 * @property {Confusion} confusion
 * @property {Record<string, Confusion>} by_class
 * @property {(Confusion & {band: string})[]} by_distance
 * @property {{name: string, answers: number, keep: number, reject: number, unsure: number}[]} reviewers
 * @property {Agreement} agreement
 * @property {Suggestion[]} suggested
 */

/**
 * @typedef {Record<"kept_visible" | "kept_hidden" | "rejected_visible" | "rejected_hidden", number> & {precision: Measure | null, recall: Measure | null, f1: Measure | null}} Score
 * @typedef {Score & {judged: number, by_class: Record<string, Score>, by_distance: (Score & {band: string})[], worst: {box_id: number, frame_id: number, error: string, pixels: number}[]}} ChannelScore  the segmentation judged the boxes that it did not
 * @typedef {{truth: string, not_measured: string[], frames: number, boxes: number, channels: Record<string, ChannelScore>}} Evaluation  every measured channel on the same boxes
 */

export {};
