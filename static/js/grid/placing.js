// @ts-check
// How a box is shown in a square cell: centred, with some of what is around it, at a scale at
// which all cells can be compared. Pure.

/** @typedef {import("../types.js").Xyxy} Xyxy */
/** @typedef {{width: number, height: number}} Size */
/** @typedef {{left: number, top: number, width: number, height: number}} Place  px in the cell */

/** Of the box's longer side, on every side of it. */
const AROUND = 0.3;
/** Of a tiny box one sees at least so much around. */
const LEAST_SIDE_PX = 28;
const PAD_STEP = 0.05;
const MOST_PAD = 10;
const HEIGHT_STEP_PX = 32;

/** The square of the image that a cell shows. @param {Xyxy} xyxy */
function squareAround([x0, y0, x1, y1]) {
  const side = Math.max(Math.max(x1 - x0, y1 - y0) * (1 + 2 * AROUND), LEAST_SIDE_PX);
  return { x: (x0 + x1 - side) / 2, y: (y0 + y1 - side) / 2, side };
}

/** What to ask the server for: enough around the box to fill the square. @param {Xyxy} xyxy @param {number} cell css px @param {number} density device px per css px @returns {{pad: number, height: number}} */
export function cropRequest(xyxy, cell, density) {
  const [x0, y0, x1, y1] = xyxy;
  const long = Math.max(x1 - x0, y1 - y0, 1);
  const short = Math.min(x1 - x0, y1 - y0);
  const { side } = squareAround(xyxy);
  const pad = Math.min(MOST_PAD, Math.ceil((side - short) / (2 * long) / PAD_STEP) * PAD_STEP);
  const rows = y1 - y0 + 2 * pad * long;
  const pixels = (rows * cell * Math.min(density, 2)) / side;
  const height = Math.min(1024, Math.max(HEIGHT_STEP_PX, Math.ceil(pixels / HEIGHT_STEP_PX) * HEIGHT_STEP_PX));
  return { pad: Math.round(pad * 100) / 100, height };
}

/** The part of the image that the server cuts out, as long as the image goes on. @param {Xyxy} xyxy @param {number} pad */
function windowOf([x0, y0, x1, y1], pad) {
  const margin = pad * Math.max(x1 - x0, y1 - y0, 1);
  return {
    left: Math.max(0, Math.floor(x0 - margin)),
    top: Math.max(0, Math.floor(y0 - margin)),
    right: Math.ceil(x1 + margin),
    bottom: Math.ceil(y1 + margin),
  };
}

/**
 * Where the crop and the box on it lie in the cell.
 * @param {Xyxy} xyxy @param {number} pad @param {number} cell css px
 * @param {Size} natural of the crop @param {Size | null} frame of the image, if it is known
 * @returns {{picture: Place, box: Place}}
 */
export function placed(xyxy, pad, cell, natural, frame) {
  const { x, y, side } = squareAround(xyxy);
  const scale = cell / side;
  const cut = clipped(windowOf(xyxy, pad), natural, frame);
  const [x0, y0, x1, y1] = xyxy;
  return {
    picture: {
      left: (cut.left - x) * scale,
      top: (cut.top - y) * scale,
      width: (cut.right - cut.left) * scale,
      height: (cut.bottom - cut.top) * scale,
    },
    box: boxPlace(x0 - x, y0 - y, x1 - x0, y1 - y0, scale),
  };
}

/** The box alone, for a cell whose crop is still to come. @param {Xyxy} xyxy @param {number} cell @returns {Place} */
export function boxIn(xyxy, cell) {
  const { x, y, side } = squareAround(xyxy);
  const [x0, y0, x1, y1] = xyxy;
  return boxPlace(x0 - x, y0 - y, x1 - x0, y1 - y0, cell / side);
}

/** @param {number} left @param {number} top @param {number} width @param {number} height @param {number} scale @returns {Place} */
const boxPlace = (left, top, width, height, scale) => ({ left: left * scale, top: top * scale, width: width * scale, height: height * scale });

/** @typedef {{left: number, top: number, right: number, bottom: number}} Window */

/**
 * Where the image ended, the crop is smaller than what was asked for. Its shape tells on which
 * side; where both sides end, only the image's size does.
 * @param {Window} asked @param {Size} natural @param {Size | null} frame @returns {Window}
 */
function clipped(asked, natural, frame) {
  const shape = natural.width / natural.height;
  if (frame) {
    const inside = { ...asked, right: Math.min(asked.right, frame.width), bottom: Math.min(asked.bottom, frame.height) };
    if (isLike(shapeOf(inside), shape, natural)) return inside;
  }
  if (isLike(shapeOf(asked), shape, natural)) return asked;
  if (shape < shapeOf(asked)) return { ...asked, right: asked.left + shape * (asked.bottom - asked.top) };
  return { ...asked, bottom: asked.top + (asked.right - asked.left) / shape };
}

/** @param {Window} window */
const shapeOf = ({ left, top, right, bottom }) => (right - left) / Math.max(1, bottom - top);

/** Equal but for the rounding of either side to whole pixels. @param {number} a @param {number} b @param {Size} natural */
const isLike = (a, b, { width, height }) => Math.abs(a / b - 1) <= 1.5 / Math.min(width, height);
