// @ts-check
// Tags in pixels: which of a box's pixels match, and the colour of a tag by name. No DOM.

/** @typedef {import("./types.js").Rgb} Rgb */
/** @typedef {import("./types.js").AcceptedTag} AcceptedTag */
/** @typedef {{encoding: string, channel_order: string, lossy: boolean}} PixelForm */

/** How far a JPEG may have moved a colour, per channel: the server's own tolerance. */
const LOSSY_TOLERANCE = 32;

/**
 * A test for one pixel: do these three stored channels carry an accepted tag?
 * @param {readonly AcceptedTag[]} accepted @param {PixelForm} form
 * @returns {(c0: number, c1: number, c2: number) => boolean}
 */
export function tagMatcher(accepted, form) {
  const swapped = form.channel_order === "bgr";
  if (form.encoding === "raw") {
    const tags = new Set(accepted.map(({ tag }) => tag));
    return swapped ? (_0, _1, c2) => tags.has(c2) : (c0) => tags.has(c0);
  }
  const colors = accepted.map(({ rgb }) => (swapped ? [rgb[2], rgb[1], rgb[0]] : rgb));
  if (form.lossy) {
    return (c0, c1, c2) =>
      colors.some(([a = 0, b = 0, c = 0]) => isNear(c0, a) && isNear(c1, b) && isNear(c2, c));
  }
  const packed = new Set(colors.map(([a = 0, b = 0, c = 0]) => (a << 16) | (b << 8) | c));
  return (c0, c1, c2) => packed.has((c0 << 16) | (c1 << 8) | c2);
}

/** @param {number} found @param {number} wanted */
const isNear = (found, wanted) => Math.abs(found - wanted) <= LOSSY_TOLERANCE;

/**
 * Light the matching pixels: `lit` where the tag is accepted, `unlit` elsewhere.
 * @param {Uint8ClampedArray} rgba of the segmentation; replaced in place
 * @param {(c0: number, c1: number, c2: number) => boolean} matches
 * @param {readonly number[]} lit rgba @param {readonly number[]} unlit rgba
 * @returns {number} how many pixels are lit
 */
export function lightPixels(rgba, matches, lit, unlit) {
  let count = 0;
  for (let i = 0; i < rgba.length; i += 4) {
    const isLit = matches(rgba[i] ?? 0, rgba[i + 1] ?? 0, rgba[i + 2] ?? 0);
    if (isLit) count++;
    rgba.set(isLit ? lit : unlit, i);
  }
  return count;
}

/** CARLA's colours by name (0.9.14 on), for swatches beside a tag's name. @type {Record<string, Rgb>} */
const COLOR_OF = {
  Unlabeled: [0, 0, 0],
  Road: [128, 64, 128],
  Sidewalk: [244, 35, 232],
  Building: [70, 70, 70],
  Wall: [102, 102, 156],
  Fence: [190, 153, 153],
  Pole: [153, 153, 153],
  TrafficLight: [250, 170, 30],
  TrafficSign: [220, 220, 0],
  Vegetation: [107, 142, 35],
  Terrain: [152, 251, 152],
  Sky: [70, 130, 180],
  Pedestrian: [220, 20, 60],
  Rider: [255, 0, 0],
  Car: [0, 0, 142],
  Vehicle: [0, 0, 142],
  Truck: [0, 0, 70],
  Bus: [0, 60, 100],
  Train: [0, 80, 100],
  Motorcycle: [0, 0, 230],
  Bicycle: [119, 11, 32],
  Static: [110, 190, 160],
  Dynamic: [170, 120, 50],
  Other: [55, 90, 80],
  Water: [45, 60, 150],
  RoadLine: [157, 234, 50],
  Ground: [81, 0, 81],
  Bridge: [150, 100, 100],
  RailTrack: [230, 150, 140],
  GuardRail: [180, 165, 180],
  Rock: [180, 130, 70],
};

/** @param {string} name @returns {string} a CSS color */
export function swatchOf(name) {
  const rgb = COLOR_OF[name];
  return rgb ? `rgb(${rgb.join(" ")})` : "transparent";
}

/** WCAG contrast of two colours, 1 to 21. @param {Rgb} a @param {Rgb} b */
export function contrast(a, b) {
  const [light, dark] = [luminance(a), luminance(b)].sort((x, y) => y - x);
  return ((light ?? 0) + 0.05) / ((dark ?? 0) + 0.05);
}

/** @param {Rgb} rgb */
function luminance(rgb) {
  const [r, g, b] = rgb.map((channel) => {
    const share = channel / 255;
    return share <= 0.04045 ? share / 12.92 : ((share + 0.055) / 1.055) ** 2.4;
  });
  return 0.2126 * (r ?? 0) + 0.7152 * (g ?? 0) + 0.0722 * (b ?? 0);
}
