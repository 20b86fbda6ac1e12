import assert from "node:assert/strict";
import { test } from "node:test";

import { linkTo, loginOf, parseHash } from "../../../static/js/core/router.js";

test("an empty address is the list of datasets", () => {
  for (const hash of ["", "#", "#/", "#/datasets"]) assert.equal(parseHash(hash).name, "datasets", hash);
});

test("an address that linkTo writes is read again as the same view, parameters and query", () => {
  const query = { box: "7", class: "traffic light & co", key: "a/b?c=1" };
  const name = "town 10/ü#?%";
  assert.deepEqual(parseHash(linkTo("frames", { dataset: name }, query)), { name: "frames", params: { dataset: name }, query });
});

test("empty filters are left out of an address", () => {
  assert.equal(linkTo("frame", { id: 3 }, { box: "", verdict: "kept" }), "#/frames/3?verdict=kept");
});

test("an unknown address leads to a view that says so", () => {
  assert.equal(parseHash("#/nothing/here").name, "unknown");
  assert.equal(parseHash("#/frames/3/more").name, "unknown");
});

test("a broken escape in an address is kept as text", () => {
  assert.equal(parseHash("#/datasets/%E0%A4%A/frames").params["dataset"], "%E0%A4%A");
});

test("a login link gives its code and its view, and no other address gives one", () => {
  assert.deepEqual(loginOf("#code=abc%2Bd"), { code: "abc+d", to: "" });
  assert.deepEqual(loginOf("#code=ab&to=frames%2F3%2Fcompare"), { code: "ab", to: "#/frames/3/compare" });
  for (const hash of ["#/datasets?code=abc", "#code=", "#other=abc", ""]) assert.equal(loginOf(hash), null, hash);
});
