import assert from "node:assert/strict";
import { test } from "node:test";

import { MAX_SCALE, boxesAt, clampView, contextOf, cropView, fitView, hiderOf, inClickOrder, nextOfStack, panBy, pixelBounds, revealView, toImage, toStage, zoomAt } from "../../../static/js/stage/geometry.js";

const IMAGE = { width: 1280, height: 720 };
const STAGE = { width: 800, height: 600 };
const NO_INSETS = { side: 0, top: 0, bottom: 0 };

/** @param {{x: number, y: number}} a @param {{x: number, y: number}} b */
function assertNear(a, b) {
  assert.ok(Math.hypot(a.x - b.x, a.y - b.y) < 1e-9, `${JSON.stringify(a)} is not ${JSON.stringify(b)}`);
}

test("fit shows the whole image in the middle", () => {
  assert.deepEqual(fitView(IMAGE, STAGE, NO_INSETS), { scale: 0.625, x: 0, y: 75 });
});

test("fit leaves room for the bars around the stage", () => {
  const [x0, y0, x1, y1] = toStage(fitView(IMAGE, STAGE), [0, 0, 1280, 720]);
  assert.ok(x0 >= 4 && x1 <= 796 && y0 >= 56 && y1 <= 532);
});

test("crop centres a box and shows its surroundings", () => {
  const view = cropView([600, 300, 640, 340], STAGE, IMAGE);
  const [x0, y0, x1, y1] = toStage(view, [600, 300, 640, 340]);
  assert.deepEqual([(x0 + x1) / 2, (y0 + y1) / 2], [400, 300]);
  assert.ok(y1 - y0 < STAGE.height / 2);
});

test("crop of a tiny box shows enough around it to recognise the place", () => {
  const { scale } = cropView([500, 300, 502, 305], STAGE, IMAGE);
  assert.ok(STAGE.height / scale >= 96 && STAGE.width / scale >= 96);
});

test("crop of a box at the edge of the image is filled by the image", () => {
  const [x0, y0] = toStage(cropView([0, 0, 40, 40], STAGE, IMAGE), [0, 0, 1280, 720]);
  assert.deepEqual([x0, y0], [0, 0]);
});

test("crop shows what hides the box, as far as it is near", () => {
  const near = contextOf([500, 300, 512, 306], [470, 280, 560, 330]);
  assert.deepEqual(near, { width: 116, height: 96 });
  assert.equal(contextOf([500, 300, 512, 306], [0, 0, 1280, 720]).width, 192);
});

test("a nearer kept box over most of another one hides it", () => {
  /** @param {string} id @param {import("../../../static/js/boxes/box.js").Xyxy} xyxy @param {number | null} distance @param {string} verdict @returns {any} */
  const boxAt = (id, xyxy, distance, verdict = "kept") => ({ id, xyxy, distance, effective_verdict: verdict });
  const box = boxAt("asked", [10, 10, 20, 20], 50, "rejected");
  const around = boxAt("around", [0, 0, 40, 40], 30);
  const partly = boxAt("partly", [10, 10, 15, 20], 30);
  assert.deepEqual(hiderOf([box, around], box), { box: around, where: "inside" });
  assert.deepEqual(hiderOf([box, partly], box), { box: partly, where: "behind" });
  assert.equal(hiderOf([box, boxAt("ghost", [0, 0, 40, 40], 30, "rejected")], box), null);
  assert.equal(hiderOf([box, boxAt("farther", [0, 0, 40, 40], 60)], box), null);
  assert.equal(hiderOf([box, boxAt("aside", [18, 18, 40, 40], 30)], box), null);
});

test("zoom keeps the point under the pointer", () => {
  const before = { scale: 0.5, x: 30, y: -20 };
  const at = { x: 123, y: 321 };
  assertNear(toImage(zoomAt(before, 1.7, at, 0.01), at), toImage(before, at));
});

test("zoom stops at its limits", () => {
  const view = { scale: 1, x: 0, y: 0 };
  assert.equal(zoomAt(view, 1e9, { x: 0, y: 0 }, 0.2).scale, MAX_SCALE);
  assert.equal(zoomAt(view, 1e-9, { x: 0, y: 0 }, 0.2).scale, 0.2);
});

test("toImage is the inverse of toStage", () => {
  const view = { scale: 3, x: 7, y: -9 };
  const [x, y] = toStage(view, [11, 13, 0, 0]);
  assertNear(toImage(view, { x, y }), { x: 11, y: 13 });
});

test("panning far in any direction keeps a part of the image in sight", () => {
  for (const [dx, dy] of [[1e6, 1e6], [-1e6, -1e6], [1e6, -1e6]]) {
    const [x0, y0, x1, y1] = toStage(clampView(panBy({ scale: 1, x: 0, y: 0 }, dx ?? 0, dy ?? 0), IMAGE, STAGE), [0, 0, 1280, 720]);
    assert.ok(x1 > 0 && y1 > 0 && x0 < STAGE.width && y0 < STAGE.height);
  }
});

test("revealing a box moves the view only if the box is out of sight", () => {
  const view = { scale: 1, x: 0, y: 0 };
  assert.equal(revealView(view, [10, 10, 50, 50], STAGE), view);
  assert.equal(revealView(view, [1200, 10, 1250, 50], STAGE).scale, 1);
});

test("a click hits the smallest box under the pointer first, and another click the next larger one", () => {
  const large = { xyxy: [0, 0, 100, 100] };
  const small = { xyxy: [40, 40, 60, 60] };
  const outside = { xyxy: null };
  const hits = boxesAt(/** @type {any} */ ([large, small, outside]), { x: 50, y: 50 }, 0);
  assert.deepEqual(hits, [small, large]);
  assert.equal(nextOfStack(hits, undefined), small);
  assert.equal(nextOfStack(hits, small), large);
  assert.equal(nextOfStack(hits, large), small);
  assert.equal(nextOfStack([], undefined), undefined);
});

test("a box covers every pixel that it touches, at least one, and none outside of the image", () => {
  assert.deepEqual(pixelBounds([0.5, 0.5, 2.1, 2], IMAGE), { x: 0, y: 0, width: 3, height: 2 });
  assert.deepEqual(pixelBounds([7.2, 7.2, 7.4, 7.4], IMAGE), { x: 7, y: 7, width: 1, height: 1 });
  assert.deepEqual(pixelBounds([1280, 720, 1280, 720], IMAGE), { x: 1279, y: 719, width: 1, height: 1 });
});

test("a click selects the object's box first, then kept boxes, then others", () => {
  /** @param {string} id @param {import("../../../static/js/boxes/box.js").Xyxy} xyxy @param {string} verdict @returns {any} */
  const boxAt = (id, xyxy, verdict) => ({ id, xyxy, tight_xyxy: null, effective_verdict: verdict });
  const [ghost, part, bus] = [boxAt("ghost", [4, 4, 8, 8], "rejected"), boxAt("part", [0, 0, 10, 10], "kept"), boxAt("bus", [0, 0, 40, 20], "kept")];
  assert.deepEqual(inClickOrder([ghost, part, bus], null), [part, bus, ghost]);
  assert.deepEqual(inClickOrder([ghost, part, bus], [0, 0, 40, 18]), [bus, part, ghost]);
  assert.deepEqual(inClickOrder([ghost, part, bus], [0, 0, 640, 360]), [part, bus, ghost]);
});
