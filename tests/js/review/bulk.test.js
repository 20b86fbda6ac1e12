import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { decision, memoryStorage } from "../../support/page/builders.js";
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

test("undoing all answers after one's own answer gives that again", () => {
  const review = { verdict: "keep", reviewer: "ada", revision: 1, comment: "" };
  app.boxes.receive([decision({ box_id: 1, revision: 1, review })]);
  app.answer(3, "unsure");
  app.bulkAnswers.answer("d", "clear", [1, 2], new Map([[1, 1]]));
  app.answer(1, "reject");
  undo();
  assert.deepEqual(answers(), [null, null, "unsure"]);
  undo();
  assert.deepEqual(answers(), ["keep", null, "unsure"]);
});

test("undoing a bulk answer that was not sent does not undo what somebody else has answered meanwhile", () => {
  const storage = memoryStorage();
  ({ app } = reviewPage(storage));
  app.answer(3, "unsure");
  app.bulkAnswers.answer("d", "reject", [1, 2], new Map());
  const review = { verdict: "keep", reviewer: "bo", revision: 1, comment: "" };
  app.boxes.receive([decision({ box_id: 1, revision: 1, review })]);
  undo();
  assert.deepEqual([answers(), storage.length], [["keep", null, "unsure"], 1]);
});

test("a refused bulk answer is given again on the boxes that were not answered since", async () => {
  const refused = Response.json({ status: 413, detail: "too many" }, { status: 413 });
  globalThis.fetch = async () => refused;
  app.bulkAnswers.answer("d", "reject", [1, 2, 3], new Map());
  await new Promise((resolve) => setTimeout(resolve, 20));
  assert.deepEqual(answers(), [null, null, null]);
  assert.deepEqual(said, ["3 answers not saved: too many"]);
  const [open] = app.sender.state.get().bulkItems;
  globalThis.fetch = () => new Promise(() => {});
  app.answer(1, "keep");
  const review = { verdict: "unsure", reviewer: "bo", revision: 1, comment: "" };
  app.boxes.receive([decision({ box_id: 2, revision: 1, review })]);

  app.bulkAnswers.answerAgain(open.item);

  assert.deepEqual(answers(), ["keep", "unsure", "reject"]);
  assert.deepEqual(app.sender.state.get().bulkItems.map((/** @type {any} */ { item, state }) => [item.boxIds, state]), [[[3], "sending"]]);
});

test("a refused bulk answer stays offered where the browser has no room to give it again", async () => {
  const storage = memoryStorage();
  ({ app } = reviewPage(storage));
  globalThis.fetch = async () => Response.json({ status: 413, detail: "too many" }, { status: 413 });
  app.bulkAnswers.answer("d", "reject", [1, 2], new Map());
  await new Promise((resolve) => setTimeout(resolve, 20));
  fill(storage);

  app.bulkAnswers.answerAgain(app.sender.state.get().bulkItems[0].item);

  assert.deepEqual(app.sender.state.get().bulkItems.map((/** @type {any} */ { state }) => state), ["refused"]);
});

for (const [where, isFull, states] of /** @type {[string, boolean, string[]][]} */ ([
  ["", false, ["sending"]],
  [", and stays offered where the browser has no room", true, ["changed"]],
])) {
  test(`a bulk answer on a filter that selects other boxes now is given again on these${where}`, async () => {
    const storage = memoryStorage();
    ({ app } = reviewPage(storage));
    globalThis.fetch = async () => Response.json({ status: 409, code: "stale_snapshot", detail: "other boxes" }, { status: 409 });
    app.bulkAnswers.answerAll("d", "keep", { class: "car" }, { total: 2, snapshot: "before" });
    await new Promise((resolve) => setTimeout(resolve, 20));
    const [{ item }] = app.sender.state.get().bulkItems;
    globalThis.fetch = () => new Promise(() => {});
    if (isFull) fill(storage);

    app.bulkAnswers.answerAgain(item, { total: 3, snapshot: "after" });

    const open = app.sender.state.get().bulkItems;
    assert.deepEqual(open.map((/** @type {any} */ { state }) => state), states);
    if (!isFull) assert.deepEqual([open[0].item.snapshot, open[0].item.count, open[0].item.filter], ["after", 3, { class: "car" }]);
  });
}
