// @ts-check
// The shapes that travel: what the server answers, as JSDoc types. No code here.

/**
 * @typedef {"kept" | "rejected" | "unmeasured" | "veiled"} Verdict  the filter's word; veiled: not to be seen before the answer, never travels
 * @typedef {"keep" | "reject" | "unsure" | "clear"} Answer  a person's word; clear takes it back
 * @typedef {[number, number, number, number]} Xyxy  image px, half-open: x_min y_min x_max y_max
 * @typedef {[number, number, number]} Rgb
 */

/**
 * @typedef {object} Review
 * @property {Answer} verdict
 * @property {string} reviewer
 * @property {number} revision
 * @property {string} [comment]
 */

/**
 * @typedef {{tag: number, name: string, percent: number}} HiddenBy
 * @typedef {{tag: number, name: string, rgb: Rgb}} AcceptedTag
 */

/**
 * @typedef {object} Decision
 * @property {number} box_id
 * @property {string} id  the sender's
 * @property {string} frame
 * @property {number} frame_id
 * @property {string} class
 * @property {Verdict} verdict
 * @property {string} reason
 * @property {string | null} evidence  the channel used
 * @property {number | null} [visible_pixels]  known to be the object's own
 * @property {string} [explanation]
 * @property {number | null} match_percent
 * @property {number | null} threshold
 * @property {number | null} margin
 * @property {boolean} toss_up
 * @property {boolean} [large]
 * @property {number | null} matched_pixels
 * @property {number | null} box_pixels
 * @property {number | null} area_percent
 * @property {number | null} crowding
 * @property {string | number | null} [explained_by]
 * @property {HiddenBy[]} hidden_by
 * @property {AcceptedTag[]} [accepted_tags]
 * @property {boolean} [lossy]
 * @property {number | null} distance
 * @property {Xyxy | null} xyxy  the corrected rectangle that was used; null when outside
 * @property {Xyxy | null} [amodal_xyxy]
 * @property {Xyxy | null} [visible_xyxy]
 * @property {Xyxy | null} [tight_xyxy]
 * @property {Xyxy[] | null} [edges]  clipped 3D edges: x1 y1 x2 y2
 * @property {string} config  digest
 * @property {number} run
 * @property {Review | null} review
 * @property {number} [revision]  of the latest review, a taken-back one included
 * @property {Verdict} effective_verdict
 */

/**
 * @typedef {object} FrameCounts
 * @property {number} boxes
 * @property {number} kept
 * @property {number} rejected
 * @property {number} unmeasured
 * @property {number} reviewed
 * @property {number} to_review
 */

/**
 * @typedef {object} FrameItem
 * @property {number} id
 * @property {string} key
 * @property {number} revision
 * @property {number | null} width
 * @property {number | null} height
 * @property {boolean} has_image
 * @property {boolean} has_segmentation
 * @property {boolean} lossy
 * @property {string | null} map
 * @property {string} created_at
 * @property {FrameCounts} counts
 */

/**
 * @typedef {object} SegmentationReport
 * @property {string} palette
 * @property {"palette" | "raw"} encoding
 * @property {"rgb" | "bgr"} channel_order
 * @property {boolean} lossy
 * @property {number} [unknown_percent]
 * @property {string[]} [notes]
 */

/**
 * @typedef {object} FrameDetail
 * @property {string} dataset
 * @property {string | null} [carla_version]
 * @property {string | null} [captured_at]
 * @property {SegmentationReport | null} segmentation
 * @property {Record<string, {url: string}>} [files]
 * @property {number | null} previous_id
 * @property {number | null} next_id
 * @property {Decision[]} boxes
 */

/** @typedef {FrameItem & FrameDetail} Frame */

/**
 * @typedef {object} Dataset
 * @property {string} name
 * @property {string} description
 * @property {string[]} classes
 * @property {string} created_at
 * @property {string} palette
 * @property {string} encoding
 * @property {string} channel_order
 * @property {string} lossy_segmentation
 * @property {string | null} [config]
 * @property {number | null} thumbnail_frame_id
 * @property {FrameCounts & {frames: number, problems: number}} counts
 */

/** @typedef {{name: string, role: string, expires_at: string | null}} Person  who is signed in */
/** @typedef {Person & {session: string}} NewSession  with the secret that is shown for it */
/** @typedef {{token: string} | {code: string}} Credential  a token, or the code of a login link */

/**
 * @template T
 * @typedef {{items: T[], next_cursor: string | null}} Page
 */

/**
 * @typedef {object} HistoryItem
 * @property {"decision" | "review"} kind
 * @property {string} at
 * @property {string} verdict
 * @property {number} [run]
 * @property {string} [config]
 * @property {string} [reason]
 * @property {number | null} [match_percent]
 * @property {number | null} [threshold]
 * @property {number} [revision]
 * @property {string} [reviewer]
 * @property {string} [comment]
 */

/**
 * @typedef {object} StoredReview  what the server says after it has stored an answer
 * @property {number} box_id
 * @property {number} revision
 * @property {Answer} verdict
 * @property {string} reviewer
 * @property {string} [comment]
 * @property {Verdict} effective_verdict
 */

export {};
