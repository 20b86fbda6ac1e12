import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { createBoxes } from "../../../static/js/boxes/store.js";
import { createMedia } from "../../../static/js/stage/media.js";
import { decision } from "../../support/page/builders.js";

const tick = () => new Promise((done) => setTimeout(done));

/** @type {ReturnType<typeof createBoxes>} */
let boxes;
/** @type {ReturnType<typeof createMedia>} */
let media;
const PICTURE = "7/thumbnail?width=16383";
/** The ends of the addresses that were requested. @type {string[]} */
let asked;

beforeEach(() => {
  asked = [];
  boxes = createBoxes();
  media = createMedia(boxes);
  globalThis.fetch = async (address) => {
    asked.push(String(address).replace("/api/v1/frames/", ""));
    const id = Number(/frames\/(\d+)$/.exec(String(address))?.[1]);
    return id ? Response.json({ id, has_image: true, has_segmentation: true, files: {}, segmentation: null, boxes: [decision({ box_id: 10 * id, frame_id: id })] }) : new Response("picture");
  };
  // Stands for the browser's class; these tests do not look at decoded pictures.
  globalThis.Image = /** @type {any} */ (class { decode() {} });
});

const gone = () => new AbortController().signal;

test("a frame that was fetched ahead has its picture, and is used only once", async () => {
  media.fetchAhead(7);
  media.fetchAhead(7);
  await tick();
  assert.deepEqual(asked, ["7", PICTURE]);

  assert.equal((await media.frame(7, gone())).id, 7);
  assert.ok(media.of(7).picture.value);
  assert.equal(asked.length, 2);
  await media.frame(7, gone());

  assert.deepEqual(asked, ["7", PICTURE, "7"]);
});

test("a frame that was fetched ahead shows answers that were stored since", async () => {
  media.fetchAhead(7);
  await tick();

  boxes.receiveAnswers(new Map([[70, { revision: 1, applyTo: (box) => ({ ...box, revision: 1 }) }]]));
  const { boxIds } = await media.frame(7, gone());

  assert.deepEqual(boxes.all(boxIds).map(({ revision }) => revision), [1]);
  assert.deepEqual(asked, ["7", PICTURE]);
});

test("a frame that was fetched ahead is asked for again if any box may have changed since", async () => {
  media.fetchAhead(7);
  await tick();

  boxes.reload();
  await media.frame(7, gone());

  assert.deepEqual(asked, ["7", PICTURE, "7"]);
});

test("boxes stay in the store as long as their frame is kept", async () => {
  for (const id of [7, 8]) await media.of(id).frame.get();

  for (const id of [1, 2, 3, 4, 5, 6, 8]) media.of(id);
  await tick();
  assert.deepEqual(boxes.all([70, 80]).map(({ box_id }) => box_id), [70, 80]);
  media.of(9);
  await tick();
  assert.deepEqual(boxes.all([70, 80]).map(({ box_id }) => box_id), [80]);

  media.end();
  await tick();
  assert.deepEqual(boxes.all([70, 80]), []);
});

test("boxes that come after the view was closed do not stay in the store", async () => {
  const coming = media.of(7).frame.get();

  media.end();
  await coming;
  await tick();

  assert.deepEqual(boxes.all([70]), []);
});

test("a frame that was fetched ahead may be used for twenty seconds", async (t) => {
  let now = 1_000;
  t.mock.method(Date, "now", () => now);
  for (const id of [7, 8]) media.fetchAhead(id);
  await tick();

  now += 19_999;
  await media.frame(7, gone());
  now += 1;
  await media.frame(8, gone());

  assert.deepEqual(asked.filter((address) => !address.includes("/thumbnail")), ["7", "8", "8"]);
});

test("the eight frames that were used last are kept", () => {
  const [first, second] = [media.of(1), media.of(2)];
  for (const id of [3, 4, 5, 6, 7, 8]) media.of(id);

  assert.equal(media.of(1), first);
  media.of(9);

  assert.equal(media.of(1), first);
  assert.notEqual(media.of(2), second);
});

test("the mask is loaded when it is wanted, and not before", async () => {
  const { frame, picture, mask } = media.of(7);
  await frame.get();
  await picture.get();
  assert.deepEqual(asked, ["7", PICTURE]);

  await mask.get();

  assert.match(asked[2] ?? "", /^7\/overlay\?layer=segmentation&boxes=$/);
});
