// The smallest valid things, with keywords to vary.

/** @param {Record<string, unknown>} [some] @returns {any} */
export const decision = (some = {}) => ({
  box_id: 1,
  id: "217",
  frame: "a/1",
  frame_id: 10,
  class: "car",
  verdict: "rejected",
  reason: "below_threshold",
  evidence: "semantic",
  match_percent: 4.08,
  threshold: 10,
  margin: -5.92,
  toss_up: false,
  matched_pixels: 51,
  box_pixels: 1250,
  area_percent: 0.1,
  crowding: 0,
  hidden_by: [{ tag: 9, name: "Vegetation", percent: 71.2 }],
  accepted_tags: [{ tag: 14, name: "Car", rgb: [0, 0, 142] }],
  distance: 20,
  xyxy: [10, 10, 60, 35],
  config: "c",
  run: 1,
  review: null,
  revision: 0,
  effective_verdict: some["verdict"] ?? "rejected",
  ...some,
});

export function memoryStorage() {
  /** @type {Map<string, string>} */
  const items = new Map();
  return /** @type {Storage} */ ({
    get length() {
      return items.size;
    },
    key: (i) => [...items.keys()][i] ?? null,
    getItem: (key) => items.get(key) ?? null,
    setItem: (key, value) => void items.set(key, value),
    removeItem: (key) => void items.delete(key),
    clear: () => items.clear(),
  });
}

/** Files as they are dropped, by path and content. @param {Record<string, string>} files */
export const entriesOf = (files) => Object.entries(files).map(([path, text]) => ({ path, open: async () => new Blob([text]) }));
