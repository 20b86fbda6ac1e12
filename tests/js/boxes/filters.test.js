import assert from "node:assert/strict";
import { test } from "node:test";

import { countOfMore, countsBy, filtersOf, isFiltered, listQuery, listedOf, neighbour, nextUnanswered, selectionOf, shownBoxes, sortOf, withoutFilters, withoutFrameFilters, withoutList } from "../../../static/js/boxes/filters.js";
import { decision } from "../../support/page/builders.js";

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

test("a box is shown if it matches all filters", () => {
  assert.deepEqual(ids({}), [1, 2, 3, 4]);
  assert.deepEqual(ids({ verdict: "rejected" }), [2, 3, 4]);
  assert.deepEqual(ids({ verdict: "rejected", class: "walker" }), [3]);
  assert.deepEqual(ids({ reason: "visible" }), [1]);
});

test("a box answered with unsure counts as undecided, as on the server", () => {
  assert.deepEqual(ids({ review: "undecided" }), [1, 3, 4]);
  assert.deepEqual(ids({ review: "decided" }), [2]);
  assert.deepEqual(ids({ review: "none" }), [1, 3]);
  assert.deepEqual(ids({ review: "any" }), [2, 4]);
  assert.deepEqual(ids({ review: "unsure" }), [4]);
});

test("a step leads to the next box that the filters show", () => {
  const query = { verdict: "rejected" };
  assert.equal(neighbour(BOXES, query, null, 1)?.box_id, 2);
  assert.equal(neighbour(BOXES, query, null, -1)?.box_id, 4);
  assert.equal(neighbour(BOXES, query, 1, 1)?.box_id, 2);
  assert.equal(neighbour(BOXES, query, 4, 1), null);
  assert.equal(neighbour(BOXES, query, 2, -1), null);
});

test("the next box without an answer is searched from the front again at the end, and is never the current one", () => {
  assert.equal(nextUnanswered(BOXES, {}, 1)?.box_id, 3);
  assert.equal(nextUnanswered(BOXES, {}, 3)?.box_id, 1);
  assert.equal(nextUnanswered([decision({ box_id: 1 })], {}, 1), null);
});

test("only the filters of an address are kept for another view", () => {
  const kept = { verdict: "kept", map: "Town01", distance_max: "50" };
  assert.deepEqual(filtersOf({ box: "3", key: "a", ...kept }), kept);
});

test("boxes are counted by class", () => {
  assert.deepEqual([...countsBy(BOXES, "class")], [["car", 3], ["walker", 1]]);
});

test("filters of the address are read as the server's types, and invalid values are left out", () => {
  const query = { verdict: "kept", toss_up: "true", conflict: "no", match_min: "5", match_max: "many", distance_max: "-1", box: "7", map: "Town01" };

  assert.deepEqual(selectionOf(query), { effective: "kept", map: "Town01", toss_up: true, match_min: 5 });
  assert.equal(countOfMore(query), 3);
});

test("boxes are listed in order of doubt unless the address names another order", () => {
  assert.equal(sortOf({}), "doubt");
  assert.equal(sortOf({ sort: "crowding" }), "crowding");
  assert.equal(sortOf({ sort: "drop table" }), "doubt");
});

test("clearing the filters keeps the order", () => {
  const query = { sort: "id", class: "car", match_min: "5" };

  assert.ok(isFiltered(query));
  assert.deepEqual(withoutFilters(query), { sort: "id" });
  assert.ok(!isFiltered(withoutFilters(query)));
});

test("removing the filters of a frame keeps those that only the grid has", () => {
  assert.deepEqual(withoutFrameFilters({ verdict: "kept", review: "none", match_min: "5", sort: "id" }), { match_min: "5", sort: "id" });
});

test("listed boxes keep the order of the address, each once", () => {
  assert.deepEqual(listedOf({ boxes: "1042,7,1042" }), [1042, 7]);
  assert.deepEqual(listedOf(listQuery([1042, 7])), [1042, 7]);
});

test("a list of boxes in the address leaves out what is not an id", () => {
  assert.deepEqual(listedOf({ boxes: "7,x,-3,1.5,,1e99" }), [7]);
  assert.deepEqual(listedOf({}), []);
});

test("a list of boxes in the address names at most 50", () => {
  const many = Array.from({ length: 500 }, (_, at) => at + 1);
  assert.equal(listedOf(listQuery(many)).length, 50);
  assert.equal(listedOf({ boxes: many.join(",") }).length, 50);
});

test("removing the list of boxes from an address keeps the rest", () => {
  assert.deepEqual(withoutList({ boxes: "7", order: "random" }), { order: "random" });
});
