// @ts-check
// Shapes of what the API answers and takes.

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

/**
 * @typedef {string | number | null | readonly (string | number)[]} ConfigValue
 * @typedef {Record<string, Record<string, ConfigValue>>} ClassOverrides
 * @typedef {Record<string, ConfigValue | ClassOverrides>} ConfigBody  every key, `classes` among them
 */

/**
 * @typedef {object} ConfigVersion
 * @property {string} digest
 * @property {ConfigBody} config
 * @property {string[]} unused_keys
 * @property {string} created_by
 * @property {string} created_at
 * @property {boolean} active
 */

/** @typedef {{kept: number, rejected: number, unmeasured: number}} VerdictCounts */
/** @typedef {{kept_to_rejected: number, rejected_to_kept: number}} FlipCounts */

/**
 * @typedef {object} Flip
 * @property {number} box_id
 * @property {number} frame_id
 * @property {string} class
 * @property {number | null} match_percent
 * @property {{verdict: string, reason: string}} before
 * @property {{verdict: string, reason: string}} after
 */

/**
 * @typedef {object} Preview  everything is null when pixels are needed
 * @property {string} config  digest
 * @property {boolean} needs_pixels
 * @property {VerdictCounts | null} counts
 * @property {Record<string, number> | null} by_reason
 * @property {Record<string, VerdictCounts> | null} by_class
 * @property {Record<string, Record<string, number>> | null} reasons_by_class
 * @property {{edges: number[], classes: Record<string, number[]>, thresholds: Record<string, number>} | null} histograms
 * @property {(FlipCounts & {total: number, by_class: Record<string, FlipCounts>, items: Flip[]}) | null} flips
 */

/**
 * @typedef {"queued" | "running" | "done" | "failed" | "cancelled"} JobState
 */

/**
 * @typedef {object} Run
 * @property {number} id
 * @property {string} dataset
 * @property {string} kind
 * @property {JobState} state
 * @property {string} config  digest
 * @property {boolean} activate
 * @property {number} total  frames
 * @property {number} done
 * @property {number} changed  boxes
 * @property {Partial<VerdictCounts>} counts
 * @property {{title?: string, detail?: string} | null} error
 * @property {string} created_by
 * @property {string} created_at
 * @property {string | null} started_at
 * @property {string | null} finished_at
 */

/**
 * @typedef {object} RunDiff
 * @property {number} run
 * @property {number | null} against
 * @property {number} total
 * @property {number} kept_to_rejected
 * @property {number} rejected_to_kept
 * @property {Record<string, number>} by_class
 * @property {Flip[]} items
 * @property {string | null} next_cursor
 */

/**
 * @typedef {object} Export
 * @property {number} id
 * @property {string} dataset
 * @property {string} format
 * @property {Record<string, unknown>} options
 * @property {JobState} state
 * @property {number} [done]
 * @property {number} [total]
 * @property {number | null} size_bytes
 * @property {string | null} sha256
 * @property {Record<string, unknown> | null} counts
 * @property {{title?: string, detail?: string} | null} error
 * @property {string} created_by
 * @property {string} created_at
 * @property {string | null} finished_at
 * @property {string | null} download
 */

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
