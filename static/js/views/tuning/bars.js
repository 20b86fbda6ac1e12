// @ts-check
// The bars of a histogram on the chart's canvas: hatched below the threshold, solid above.

/** @typedef {import("../../chart.js").UPlot} UPlot */
/** @typedef {import("../../chart.js").Ink} Ink */
/** @typedef {{heights: readonly number[], threshold: number, active: number}} Bars */

const HATCH_PX = 5;

/** @param {UPlot} plot @param {Ink} ink @param {Bars} bars */
export function paintBars(plot, ink, { heights, threshold, active }) {
  const { ctx, bbox } = plot;
  const at = (/** @type {number} */ percent) => plot.valToPos(percent, "x", true);
  const shape = barShape(plot, heights);
  const split = at(threshold);
  if (active !== threshold) paintChange(plot, ink, at(active), split);
  within(ctx, bbox.left, split, bbox, () => {
    ctx.globalAlpha = 0.3;
    ctx.fillStyle = ink["rejected-strong"] ?? "";
    ctx.fill(shape);
    ctx.globalAlpha = 1;
    ctx.fillStyle = hatch(ctx, ink["rejected-strong"] ?? "") ?? "";
    ctx.fill(shape);
  });
  within(ctx, split, bbox.left + bbox.width, bbox, () => {
    ctx.fillStyle = ink["kept-strong"] ?? "";
    ctx.fill(shape);
  });
}

/** @param {UPlot} plot @param {readonly number[]} heights */
function barShape(plot, heights) {
  const shape = new Path2D();
  const floor = plot.valToPos(0, "y", true);
  const gap = plot.bbox.width / heights.length > 5 * devicePixelRatio ? devicePixelRatio : 0;
  for (const [bin, height] of heights.entries()) {
    if (height <= 0) continue;
    const left = plot.valToPos((100 * bin) / heights.length, "x", true);
    const right = plot.valToPos((100 * (bin + 1)) / heights.length, "x", true);
    const top = plot.valToPos(height, "y", true);
    shape.rect(left, top, right - left - gap, floor - top);
  }
  return shape;
}

/** What lies between the active threshold and the one being tried. @param {UPlot} plot @param {Ink} ink @param {number} from @param {number} to */
function paintChange({ ctx, bbox }, ink, from, to) {
  ctx.save();
  ctx.globalAlpha = 0.12;
  ctx.fillStyle = ink.accent ?? "";
  ctx.fillRect(Math.min(from, to), bbox.top, Math.abs(to - from), bbox.height);
  ctx.globalAlpha = 1;
  ctx.strokeStyle = ink["text-faint"] ?? "";
  ctx.lineWidth = devicePixelRatio;
  ctx.setLineDash([3 * devicePixelRatio, 3 * devicePixelRatio]);
  ctx.beginPath();
  ctx.moveTo(from, bbox.top);
  ctx.lineTo(from, bbox.top + bbox.height);
  ctx.stroke();
  ctx.restore();
}

/** @param {CanvasRenderingContext2D} ctx @param {number} left @param {number} right @param {UPlot["bbox"]} bbox @param {() => void} paint */
function within(ctx, left, right, bbox, paint) {
  ctx.save();
  ctx.beginPath();
  ctx.rect(left, bbox.top, Math.max(0, right - left), bbox.height);
  ctx.clip();
  paint();
  ctx.restore();
}

/** One tile per colour and density. @type {Map<string, OffscreenCanvas>} */
const tiles = new Map();

/** Slanted lines: the sign of a rejected box that needs no colour. @param {CanvasRenderingContext2D} ctx @param {string} color */
function hatch(ctx, color) {
  const name = `${color} ${devicePixelRatio}`;
  const tile = tiles.get(name) ?? hatchTile(color);
  tiles.set(name, tile);
  return ctx.createPattern(tile, "repeat");
}

/** @param {string} color */
function hatchTile(color) {
  const size = Math.round(HATCH_PX * devicePixelRatio);
  const tile = new OffscreenCanvas(size, size);
  const pen = tile.getContext("2d");
  if (!pen) return tile;
  pen.strokeStyle = color;
  pen.lineWidth = 1.3 * devicePixelRatio;
  pen.beginPath();
  for (const offset of [-size, 0, size]) {
    pen.moveTo(offset, size);
    pen.lineTo(offset + size, 0);
  }
  pen.stroke();
  return tile;
}
