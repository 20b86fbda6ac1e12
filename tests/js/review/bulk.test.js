import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { decision, memoryStorage } from "../../support/page/builders.js";
import { fill, reviewPage } from "../../support/page/review_page.js";

/** @type {any} */
let app;
/** @type {string[]} */
let said;
/** The action that each message offers, such as undo. @type {({run: () => void} | undefined)[]} */
let offers;

beforeEach(() => {
  ({ app, said, offers } = reviewPage());
});

const answers = () => app.boxes.all([1, 2, 3]).map((/** @type {any} */ box) => box.review?.verdict ?? null);
const undo = () => app.undo(() => {});

test("undoing an unsent bulk answer also restores a box whose later answer was undone before", () => {
  app.answer(3, "unsure");
  app.bulkAnswers.answer("d", "reject", [1, 2], new Map());
  app.answer(1, "keep");
  undo();
  assert.deepEqual(answers(), ["reject", "reject", "unsure"]);
  undo();
  assert.deepEqual(answers(), [null, null, "unsure"]);
});

test("undoing a bulk answer that is being sent is shown at once", () => {
  app.bulkAnswers.answer("d", "reject", [1, 2], new Map());
  undo();
  assert.deepEqual(answers(), [null, null, null]);
});

test("undoing a bulk answer by its message keeps a later answer on one of its boxes", async () => {
  globalThis.fetch = async () => Response.json({ id: 7, count: 2, skipped: [], stale: [] }, { status: 201 });
  app.bulkAnswers.answer("d", "reject", [1, 2], new Map());
  await new Promise((resolve) => setTimeout(resolve, 20));
  globalThis.fetch = () => new Promise(() => {});
  app.answer(1, "keep");
  offers.at(-1)?.run();
  assert.deepEqual([answers(), said], [["keep", null, null], ["2 boxes rejected, 0 of them looked at"]]);
});

test("a bulk answer that changed nothing leaves its boxes at their revision, and nothing to undo", async () => {
  const sent = [];
  globalThis.fetch = async (address, init) => {
    sent.push(JSON.parse(String(init?.body ?? "{}")));
    return Response.json({ id: 7, count: 0, skipped: [], stale: [] }, { status: 201 });
  };
  app.bulkAnswers.answer("d", "reject", [1, 2], new Map());
  await new Promise((resolve) => setTimeout(resolve, 20));
  undo();
  app.answer(1, "keep");
  await new Promise((resolve) => setTimeout(resolve, 20));
  assert.deepEqual([said, sent.length, sent[1].seen_revision], [["No answer has changed.", "Nothing to undo."], 2, 0]);
});

test("if the browser's storage is full, undoing a bulk answer fails, and can be tried again later", () => {
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

test("undoing a bulk answer that cleared an own answer restores that answer", () => {
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

test("undoing an unsent bulk answer keeps what another person has answered meanwhile", () => {
  const storage = memoryStorage();
  ({ app } = reviewPage(storage));
  app.answer(3, "unsure");
  app.bulkAnswers.answer("d", "reject", [1, 2], new Map());
  const review = { verdict: "keep", reviewer: "bo", revision: 1, comment: "" };
  app.boxes.receive([decision({ box_id: 1, revision: 1, review })]);
  undo();
  assert.deepEqual([answers(), storage.length], [["keep", null, "unsure"], 1]);
});

test("a refused bulk answer is given again only on boxes that nobody has answered since", async () => {
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

test("a refused bulk answer stays on offer if the browser's storage is full when it is given again", async () => {
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
