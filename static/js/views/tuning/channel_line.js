// @ts-check
// Where another channel than the segmentation decides: which of the keys are its own.

import { html } from "../../html.js";
import { valueOf, valueText } from "../../tuning.js";

/** @type {Record<string, readonly string[]>} the keys that its rule reads */
const OWN_KEYS = {
  ordered: ["ordered_min_pixels"],
  depth: ["min_visible_pixels", "depth_tolerance"],
  depth_center: ["depth_tolerance"],
  instance: ["min_visible_pixels"],
  lidar: ["lidar_min_points"],
  auto: ["min_visible_pixels", "depth_tolerance", "ordered_min_pixels"],
};

/** @param {{config: import("../../types_jobs.js").ConfigBody}} props */
export function ChannelLine({ config }) {
  const channel = String(config.evidence);
  const keys = OWN_KEYS[channel];
  if (!keys) return null;
  return html`<p class="tuning__channel">The channel <code>${channel}</code> decides, by ${keys.map(
    (key, at) => html`${at > 0 ? (at === keys.length - 1 ? " and " : ", ") : ""}<code>${key}</code> (${valueText(valueOf(config, key))})`,
  )}; match thresholds only decide boxes that it has no number for.</p>`;
}
