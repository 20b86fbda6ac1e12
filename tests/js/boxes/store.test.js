import assert from "node:assert/strict";
import { test } from "node:test";

import { createBoxes } from "../../../static/js/boxes/store.js";
import { decision } from "../../support/page/builders.js";

/** @param {string} verdict @param {number} revision */
const answered = (verdict, revision) => decision({ revision, review: { verdict, reviewer: "bo", revision, comment: "" } });

/** What observers are told. @param {import("../../../static/js/boxes/store.js").Boxes} boxes */
function changesOf(boxes) {
  /** @type {number[][]} */
  const told = [];
  boxes.observe((changed) => told.push([...changed]));
  return told;
}

const swept = () => new Promise((resolve) => setImmediate(resolve));

test("a box is kept once, whichever list it came with", () => {
  const boxes = createBoxes();
  assert.deepEqual(boxes.receive([decision({ box_id: 1 }), decision({ box_id: 2 })]), [1, 2]);
  const first = boxes.get(1);

  boxes.receive([decision({ box_id: 1 })]);

  assert.equal(boxes.get(1), first);
  assert.deepEqual(boxes.all([2, 3, 1]).map((box) => box.box_id), [2, 1]);
  assert.throws(() => Object.assign(boxes.get(1) ?? {}, { verdict: "kept" }), TypeError);
});

test("the higher revision wins; of two with the same, that which came later", () => {
  const boxes = createBoxes();
  boxes.receive([answered("keep", 2)]);
  const told = changesOf(boxes);

  boxes.receive([answered("reject", 1)]);
  assert.deepEqual([boxes.get(1)?.review?.verdict, told], ["keep", []]);
  boxes.receive([{ ...answered("keep", 2), threshold: 12 }]);
  assert.deepEqual([boxes.get(1)?.threshold, told], [12, [[1]]]);
  boxes.receive([answered("reject", 3)]);
  assert.equal(boxes.get(1)?.review?.verdict, "reject");
});

test("an unconfirmed answer lies over the box until it is lifted off, and keeps the server's revision", () => {
  const boxes = createBoxes();
  boxes.layOver(new Map([[1, { verdict: /** @type {const} */ ("keep"), comment: "far" }]]));
  boxes.receive([decision({ revision: 4 })]);
  const told = changesOf(boxes);
  const shown = boxes.get(1);
  assert.deepEqual([shown?.effective_verdict, shown?.review?.comment, shown?.revision], ["kept", "far", 4]);
  assert.equal(boxes.get(1), shown);

  boxes.layOver(new Map());

  assert.deepEqual([boxes.get(1)?.review, boxes.get(1)?.effective_verdict, told], [null, "rejected", [[1]]]);
});

test("who observes is told of boxes whose answer is another, and of no others", () => {
  const boxes = createBoxes();
  boxes.receive([decision({ box_id: 1 }), decision({ box_id: 2 })]);
  const keep = { verdict: /** @type {const} */ ("keep"), comment: "" };
  boxes.layOver(new Map([[1, keep]]));
  const told = changesOf(boxes);

  boxes.layOver(new Map([[1, { ...keep }], [2, keep]]));

  assert.deepEqual(told, [[2]]);
});

test("a box that nobody holds any more goes; one that is held again at once stays", async () => {
  const boxes = createBoxes();
  boxes.receive([decision({ box_id: 1 }), decision({ box_id: 2 }), decision({ box_id: 3 })]);
  const give = boxes.hold([1, 2]);
  const other = boxes.hold([2]);
  give();
  give();
  boxes.hold([1]);
  await swept();
  assert.deepEqual([1, 2].map((id) => boxes.get(id)?.box_id), [1, 2]);

  other();
  await swept();

  assert.deepEqual([1, 2].map((id) => boxes.get(id)?.box_id), [1, undefined]);
});

test("boxes that were just answered stay, so that an earlier response does not replace them", async () => {
  const boxes = createBoxes();
  const release = boxes.hold(boxes.receive([answered("keep", 2)]));
  boxes.holdAnswered([1]);
  release();
  await swept();

  boxes.receive([answered("reject", 1)]);
  assert.equal(boxes.get(1)?.review?.verdict, "keep");
  for (let i = 0; i < 500; i++) boxes.holdAnswered([2]);
  await swept();

  assert.equal(boxes.get(1), undefined);
});

test("few boxes are loaded again one by one; for many, lists are read again", async () => {
  const boxes = createBoxes();
  boxes.hold(boxes.receive([decision({ box_id: 1 }), decision({ box_id: 2 })]));
  /** @type {string[]} */
  const asked = [];
  globalThis.fetch = async (address) => {
    asked.push(String(address).replace(/.*api/, ""));
    return asked.length === 1 ? Response.json({}, { status: 503 }) : Response.json({ ...answered("keep", 1), box_id: 2 });
  };

  await boxes.loadAgain([1, 2]);
  assert.deepEqual([asked, boxes.reloads.get()], [["/v1/boxes/1", "/v1/boxes/2"], 0]);
  assert.deepEqual(boxes.all([1, 2]).map((box) => box.review?.verdict), [undefined, "keep"]);

  await boxes.loadAgain(Array.from({ length: 21 }, (_, i) => i));
  assert.deepEqual([asked.length, boxes.reloads.get()], [2, 1]);
});
