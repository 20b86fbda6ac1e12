// @ts-check
// The shapes of configurations, previews, runs and exports, as JSDoc types. No code here.

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
 * @property {string} created_at
 * @property {string | null} download
 */

export {};
