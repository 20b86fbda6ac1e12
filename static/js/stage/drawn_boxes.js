// @ts-check
// While one pans, hundreds of boxes only move together: they are drawn once, with a margin
// around the stage, and then copied.

/** @typedef {import("./paint.js").Scene} Scene */

const MARGIN_PX = 256;

/** @param {(ctx: CanvasRenderingContext2D, scene: Scene) => void} paint  draws the boxes of a scene */
export function createDrawnBoxes(paint) {
  const canvas = document.createElement("canvas");
  const own = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  /** What is on the canvas. @type {Scene | null} */
  let drawn = null;

  /** @param {Scene} scene @param {number} density */
  function holds(scene, density) {
    return (
      drawn !== null &&
      canvas.width === Math.round((scene.size.width + 2 * MARGIN_PX) * density) &&
      canvas.height === Math.round((scene.size.height + 2 * MARGIN_PX) * density) &&
      drawn.snapshot === scene.snapshot &&
      drawn.inks === scene.inks &&
      drawn.view.scale === scene.view.scale &&
      Math.abs(drawn.view.x - scene.view.x) <= MARGIN_PX &&
      Math.abs(drawn.view.y - scene.view.y) <= MARGIN_PX
    );
  }

  /** @param {Scene} scene @param {number} density */
  function draw(scene, density) {
    const size = { width: scene.size.width + 2 * MARGIN_PX, height: scene.size.height + 2 * MARGIN_PX };
    canvas.width = Math.round(size.width * density);
    canvas.height = Math.round(size.height * density);
    own.setTransform(density, 0, 0, density, 0, 0);
    const { scale, x, y } = scene.view;
    paint(own, { ...scene, size, view: { scale, x: x + MARGIN_PX, y: y + MARGIN_PX } });
    drawn = scene;
  }

  /** The boxes of a scene that moves, on whole pixels. @param {CanvasRenderingContext2D} ctx @param {Scene} scene */
  return function copy(ctx, scene) {
    const density = ctx.getTransform().a;
    if (!holds(scene, density)) draw(scene, density);
    const from = /** @type {Scene} */ (drawn).view;
    const x = Math.round((scene.view.x - from.x) * density) / density - MARGIN_PX;
    const y = Math.round((scene.view.y - from.y) * density) / density - MARGIN_PX;
    ctx.imageSmoothingEnabled = false;
    ctx.drawImage(canvas, x, y, canvas.width / density, canvas.height / density);
  };
}

/** @typedef {ReturnType<typeof createDrawnBoxes>} DrawnBoxes */
