import assert from "node:assert/strict";
import { test } from "node:test";

import { countsBy, filtersOf, neighbour, nextUndecided, shownBoxes } from "../../../static/js/boxes/filters.js";
import { decision } from "../builders.js";

/** @param {string} verdict */
const answered = (verdict) => ({ verdict, reviewer: "ada", revision: 1 });
const BOXES = [
  decision({ box_id: 1, verdict: "kept", reason: "visible" }),
  decision({ box_id: 2, review: answered("reject") }),
  decision({ box_id: 3, class: "walker" }),
  decision({ box_id: 4, review: answered("unsure") }),
];

/** @param {Record<string, string>} query */
const ids = (query) => shownBoxes(BOXES, query).map((box) => box.box_id);

test("filters are joined by and", () => {
  assert.deepEqual(ids({}), [1, 2, 3, 4]);
  assert.deepEqual(ids({ verdict: "rejected" }), [2, 3, 4]);
  assert.deepEqual(ids({ verdict: "rejected", class: "walker" }), [3]);
  assert.deepEqual(ids({ reason: "visible" }), [1]);
});

test("unsure is still undecided, as on the server", () => {
  assert.deepEqual(ids({ review: "undecided" }), [1, 3, 4]);
  assert.deepEqual(ids({ review: "decided" }), [2]);
  assert.deepEqual(ids({ review: "none" }), [1, 3]);
  assert.deepEqual(ids({ review: "any" }), [2, 4]);
  assert.deepEqual(ids({ review: "unsure" }), [4]);
});

test("steps go through what is shown, from wherever one is", () => {
  const query = { verdict: "rejected" };
  assert.equal(neighbour(BOXES, query, null, 1)?.box_id, 2);
  assert.equal(neighbour(BOXES, query, null, -1)?.box_id, 4);
  assert.equal(neighbour(BOXES, query, 1, 1)?.box_id, 2);
  assert.equal(neighbour(BOXES, query, 4, 1), null);
  assert.equal(neighbour(BOXES, query, 2, -1), null);
});

test("the next undecided starts again at the front, and never is the same box", () => {
  assert.equal(nextUndecided(BOXES, {}, 1)?.box_id, 3);
  assert.equal(nextUndecided(BOXES, {}, 3)?.box_id, 1);
  assert.equal(nextUndecided([decision({ box_id: 1 })], {}, 1), null);
});

test("only filters are carried on", () => {
  assert.deepEqual(filtersOf({ box: "3", verdict: "kept", key: "a" }), { verdict: "kept" });
});

test("choices are counted", () => {
  assert.deepEqual([...countsBy(BOXES, "class")], [["car", 3], ["walker", 1]]);
});
