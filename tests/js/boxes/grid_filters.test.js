import assert from "node:assert/strict";
import { test } from "node:test";

import { countOfMore, isFiltered, selectionOf, sortOf, withoutFilters } from "../../../static/js/boxes/filters.js";

test("the address is read as the server takes it, and nonsense is left out", () => {
  const query = { verdict: "kept", toss_up: "true", conflict: "no", match_min: "5", match_max: "many", distance_max: "-1", box: "7" };

  assert.deepEqual(selectionOf(query), { verdict: "kept", toss_up: true, match_min: 5 });
  assert.equal(countOfMore(query), 2);
});

test("doubt comes first unless another order is named", () => {
  assert.equal(sortOf({}), "doubt");
  assert.equal(sortOf({ sort: "crowding" }), "crowding");
  assert.equal(sortOf({ sort: "drop table" }), "doubt");
});

test("clearing keeps the order", () => {
  const query = { sort: "id", class: "car", match_min: "5" };

  assert.ok(isFiltered(query));
  assert.deepEqual(withoutFilters(query), { sort: "id" });
  assert.ok(!isFiltered(withoutFilters(query)));
});
