// @ts-check
// A person's answer on a box's corner: a filled sign, drawn once and then copied.

/** @typedef {import("./paint.js").Inks} Inks */
/** @typedef {"keep" | "reject" | "unsure"} Given */

const RADIUS_PX = 7;
const SIDE_PX = 2 * RADIUS_PX + 4;
/** Sharp on every screen, and when the browser is zoomed. */
const DENSITY = 3;

/** @type {Map<string, HTMLCanvasElement>} */
const signs = new Map();

/** On the top right corner. @param {CanvasRenderingContext2D} ctx @param {Given | null} answer @param {import("../types.js").Xyxy} rect @param {Inks} inks */
export function paintMark(ctx, answer, [, y0, x1], inks) {
  if (!answer) return;
  ctx.imageSmoothingEnabled = true;
  ctx.drawImage(signOf(answer, inks), x1 - SIDE_PX / 2, y0 - SIDE_PX / 2, SIDE_PX, SIDE_PX);
}

/** @param {Given} answer @param {Inks} inks */
function signOf(answer, inks) {
  const fill = { keep: inks.label.kept, reject: inks.label.rejected, unsure: inks.unsure }[answer];
  const key = `${answer} ${fill} ${inks.text}`;
  const known = signs.get(key);
  if (known) return known;
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = SIDE_PX * DENSITY;
  const ctx = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  ctx.setTransform(DENSITY, 0, 0, DENSITY, canvas.width / 2, canvas.height / 2);
  ctx.beginPath();
  ctx.arc(0, 0, RADIUS_PX, 0, 2 * Math.PI);
  ctx.fillStyle = fill;
  ctx.fill();
  ctx.strokeStyle = inks.text;
  ctx.lineWidth = 1.5;
  ctx.stroke();
  paintSign(ctx, answer, inks);
  signs.set(key, canvas);
  return canvas;
}

/** Around the origin. @param {CanvasRenderingContext2D} ctx @param {Given} answer @param {Inks} inks */
function paintSign(ctx, answer, inks) {
  ctx.beginPath();
  if (answer === "keep") {
    ctx.moveTo(-3, 0.2);
    ctx.lineTo(-0.8, 2.6);
    ctx.lineTo(3.2, -2.4);
  } else if (answer === "reject") {
    ctx.moveTo(-2.4, -2.4);
    ctx.lineTo(2.4, 2.4);
    ctx.moveTo(2.4, -2.4);
    ctx.lineTo(-2.4, 2.4);
  } else {
    ctx.font = `700 10px ${inks.font}`;
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    ctx.fillStyle = inks.text;
    ctx.fillText("?", 0, 0.5);
  }
  ctx.lineCap = "round";
  ctx.lineWidth = 1.75;
  ctx.stroke();
}
