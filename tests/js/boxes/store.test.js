import assert from "node:assert/strict";
import { test } from "node:test";

import { withAnswer } from "../../../static/js/boxes/box.js";
import { createBoxes } from "../../../static/js/boxes/store.js";
import { decision } from "../../support/page/builders.js";

/** @param {string} verdict @param {number} revision */
const answered = (verdict, revision) => decision({ revision, review: { verdict, reviewer: "bo", revision, comment: "" } });

/**
 * Observe the store; gives a list to which each notification adds its ids.
 * @param {import("../../../static/js/boxes/store.js").Boxes} boxes
 */
function changesOf(boxes) {
  /** @type {number[][]} */
  const told = [];
  boxes.observe((changed) => told.push([...changed]));
  return told;
}

const swept = () => new Promise((resolve) => setImmediate(resolve));

test("a box is stored once, also if several lists contain it, and cannot be changed", () => {
  const boxes = createBoxes();
  assert.deepEqual(boxes.receive([decision({ box_id: 1 }), decision({ box_id: 2 })]), [1, 2]);
  const first = boxes.get(1);

  boxes.receive([decision({ box_id: 1 })]);

  assert.equal(boxes.get(1), first);
  assert.deepEqual(boxes.all([2, 3, 1]).map((box) => box.box_id), [2, 1]);
  assert.throws(() => Object.assign(boxes.get(1) ?? {}, { verdict: "kept" }), TypeError);
});

test("of two versions of a box, the higher revision wins; of equal ones, the later response", () => {
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

test("an unconfirmed answer is shown on its box until it is removed, with the server's revision", () => {
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

test("observers are notified only of boxes whose shown answer has changed", () => {
  const boxes = createBoxes();
  boxes.receive([decision({ box_id: 1 }), decision({ box_id: 2 })]);
  const keep = { verdict: /** @type {const} */ ("keep"), comment: "" };
  boxes.layOver(new Map([[1, keep]]));
  const told = changesOf(boxes);

  boxes.layOver(new Map([[1, { ...keep }], [2, keep]]));

  assert.deepEqual(told, [[2]]);
});

test("a box is dropped when its last holder lets go, unless it is held again at once", async () => {
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

test("boxes that were just answered are kept, so that an older response does not replace them", async () => {
  const boxes = createBoxes();
  const release = boxes.hold(boxes.receive([answered("keep", 2)]));
  boxes.keepRevisions([1]);
  release();
  await swept();

  boxes.receive([answered("reject", 1)]);
  assert.equal(boxes.get(1)?.review?.verdict, "keep");
  for (let i = 0; i < 500; i++) boxes.keepRevisions([2]);
  await swept();

  assert.equal(boxes.get(1), undefined);
});

/**
 * Let the server have these frames, given as their boxes by id.
 * @param {Record<number, any[]>} frames @returns {string[]} the addresses that are requested
 */
function serve(frames) {
  /** @type {string[]} */
  const asked = [];
  globalThis.fetch = async (address) => {
    const id = Number(asked[asked.push(String(address).replace(/.*api.v1/, "")) - 1]?.split("/").at(-1));
    return frames[id] ? Response.json({ id, boxes: frames[id] }) : Response.json({}, { status: 404 });
  };
  return asked;
}

test("boxes are loaded again by their frames, and only those in the store are replaced", async () => {
  const boxes = createBoxes();
  boxes.hold(boxes.receive([1, 2, 3].map((id) => decision({ box_id: id, frame_id: id === 3 ? 11 : 10 }))));
  const asked = serve({ 10: [1, 2, 4].map((id) => ({ ...answered("keep", 1), box_id: id })) });

  await boxes.loadAgain([3, 1, 2]);

  assert.deepEqual([asked, boxes.reloads.get()], [["/frames/11", "/frames/10"], 0], "the first of them is deleted");
  assert.deepEqual([1, 2, 3].map((id) => boxes.get(id)?.review?.verdict), ["keep", "keep", undefined]);
  assert.equal(boxes.get(4), undefined);
});

test("for many boxes, lists are told to load again, and only boxes that others hold are loaded here", async () => {
  const boxes = createBoxes();
  const ids = Array.from({ length: 21 }, (_, i) => i);
  const giveBack = boxes.hold(boxes.receive(ids.map((id) => decision({ box_id: id, frame_id: id }))));
  boxes.hold([7]);
  boxes.reloads.observe(giveBack);
  const asked = serve({ 7: [{ ...answered("keep", 1), box_id: 7, frame_id: 7 }] });

  await boxes.loadAgain(ids);

  assert.deepEqual([boxes.reloads.get(), asked, boxes.get(7)?.review?.verdict], [1, ["/frames/7"], "keep"]);
});

test("boxes that are only remembered are not loaded one by one if many have changed", async () => {
  const boxes = createBoxes();
  const ids = Array.from({ length: 21 }, (_, i) => i);
  const giveBack = boxes.hold(boxes.receive(ids.map((id) => decision({ box_id: id, frame_id: id }))));
  boxes.keepRevisions(ids);
  boxes.remember(ids);
  boxes.layOver(new Map([[7, { verdict: "keep", comment: "" }]]));
  boxes.showUntilLoaded([7]);
  boxes.layOver(new Map());
  boxes.reloads.observe(giveBack);
  const asked = serve({});

  await boxes.loadAgain(ids);

  assert.deepEqual([boxes.reloads.get(), asked, boxes.get(7)?.review], [1, [], null]);
});

test("an answer stays shown until its box has been loaded, even if that takes several attempts", async () => {
  /** @type {(string | undefined)[]} */
  const shown = [];
  const look = () => shown.push(boxes.get(1)?.review?.verdict);
  const boxes = createBoxes((again) => (look(), setImmediate(again)));
  boxes.hold(boxes.receive([decision(), decision({ box_id: 2 })]));
  const keep = { verdict: /** @type {const} */ ("keep"), comment: "" };
  boxes.layOver(new Map([[1, keep], [2, keep]]));
  const statuses = [503, 401, 0];
  globalThis.fetch = async () => {
    const status = statuses.shift();
    if (status === 0) throw new TypeError("offline");
    return status ? Response.json({}, { status }) : Response.json({ id: 10, boxes: [answered("reject", 1), decision({ box_id: 2 })] });
  };

  boxes.showUntilLoaded([1, 2]);
  boxes.layOver(new Map());
  await boxes.loadAgain([1, 2]);

  assert.deepEqual([shown, statuses], [["keep", "keep", "keep"], []]);
  assert.deepEqual([1, 2].map((id) => boxes.get(id)?.review?.verdict), ["reject", undefined]);
});

test("an answer that is shown until its box is loaded is replaced by a newer one", async () => {
  const boxes = createBoxes(() => {});
  boxes.hold(boxes.receive([decision()]));
  boxes.layOver(new Map([[1, { verdict: "keep", comment: "" }]]));
  boxes.showUntilLoaded([1]);
  boxes.layOver(new Map());
  assert.equal(boxes.get(1)?.review?.verdict, "keep");

  boxes.receive([answered("reject", 1)]);

  assert.equal(boxes.get(1)?.review?.verdict, "reject");
});

test("a box that arrives after its answer was stored, but is older, is shown with the answer", () => {
  const boxes = createBoxes();
  const applyTo = (/** @type {any} */ box) => withAnswer(box, "keep", "", 1);
  boxes.receiveAnswers(new Map([[1, { revision: 1, applyTo }]]));

  boxes.hold(boxes.receive([decision({ box_id: 1, revision: 0 })]));
  assert.equal(boxes.get(1)?.review?.verdict, "keep");

  const review = { verdict: "reject", reviewer: "bo", revision: 2, comment: "" };
  boxes.receive([decision({ box_id: 1, revision: 2, review })]);
  assert.equal(boxes.get(1)?.review?.verdict, "reject");
});

test("a frame that cannot be loaded at first does not stop the others from being loaded", async () => {
  const boxes = createBoxes((again) => setImmediate(again));
  boxes.hold(boxes.receive([decision({ box_id: 1, frame_id: 1 }), decision({ box_id: 2, frame_id: 2 })]));
  /** @type {string[]} */
  const asked = [];
  globalThis.fetch = async (address) => {
    const frame = Number(String(address).split("/").at(-1));
    asked.push(`frame ${frame}`);
    const isBusy = frame === 1 && asked.length < 3;
    return isBusy ? Response.json({}, { status: 500 }) : Response.json({ boxes: [{ ...answered("keep", 1), box_id: frame, frame_id: frame }] });
  };

  await boxes.loadAgain([1, 2]);

  assert.deepEqual(asked, ["frame 1", "frame 2", "frame 1"]);
  assert.deepEqual(boxes.all([1, 2]).map((box) => box.review?.verdict), ["keep", "keep"]);
});
