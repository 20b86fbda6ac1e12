import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { memoryStorage } from "../../support/page/builders.js";
import { fill, reviewPage } from "../../support/page/review_page.js";

/** @type {any} */
let app;
/** @type {string[]} */
let said;
/** What the messages offer to do. @type {({run: () => void} | undefined)[]} */
let offers;

beforeEach(() => {
  ({ app, said, offers } = reviewPage());
});

const answers = () => app.boxes.all([1, 2, 3]).map((/** @type {any} */ box) => box.review?.verdict ?? null);
const undo = () => app.undo(() => {});

test("undo of a bulk answer that was not sent restores the boxes that were answered after it too", () => {
  app.answer(3, "unsure");
  app.bulkAnswers.answer("d", "reject", [1, 2], new Map());
  app.answer(1, "keep");
  undo();
  assert.deepEqual(answers(), ["reject", "reject", "unsure"]);
  undo();
  assert.deepEqual(answers(), [null, null, "unsure"]);
});

test("the undo of a bulk answer that is on its way is shown at once", () => {
  app.bulkAnswers.answer("d", "reject", [1, 2], new Map());
  undo();
  assert.deepEqual(answers(), [null, null, null]);
});

test("the undo of a bulk answer, asked for after a later answer, leaves that answer as it is", async () => {
  globalThis.fetch = async () => Response.json({ id: 7, count: 2, skipped: [], stale: [] }, { status: 201 });
  app.bulkAnswers.answer("d", "reject", [1, 2], new Map());
  await new Promise((resolve) => setTimeout(resolve, 20));
  globalThis.fetch = () => new Promise(() => {});
  app.answer(1, "keep");
  offers.at(-1)?.run();
  assert.deepEqual([answers(), said], [["keep", null, null], ["2 boxes rejected"]]);
});

test("where the browser has no room for the undo of a bulk answer, it can be asked for again", () => {
  const storage = memoryStorage();
  ({ app, said } = reviewPage(storage));
  app.bulkAnswers.answer("d", "reject", [1, 2], new Map());
  const { setItem } = storage;
  fill(storage);

  undo();
  assert.deepEqual([answers(), said.length], [["reject", "reject", null], 1]);
  storage.setItem = setItem;
  undo();

  assert.deepEqual([answers(), said.length], [[null, null, null], 1]);
});
