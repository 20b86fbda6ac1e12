import assert from "node:assert/strict";
import { test } from "node:test";

import { causeText, labelText, matchText, reasonText, shortText, spokenText } from "../../../static/js/boxes/wording.js";
import { decision } from "../../support/page/builders.js";

test("a label gives the match, the threshold, and what hides the box", () => {
  assert.equal(labelText(decision()), "4.1 % Car < 10 % · hidden by Vegetation 71 %");
});

test("a label gives enough digits to compare a match with a threshold that is equal or nearly equal", () => {
  const said = (/** @type {object} */ numbers) => labelText(decision({ hidden_by: [], threshold: 10, ...numbers }));
  const kept = { verdict: "kept", reason: "visible" };
  assert.equal(said({ match_percent: 10 }), "10 % Car ≤ 10 %"); // rejected: the profile carlasimu needs more than the threshold
  assert.equal(said({ match_percent: 50, threshold: 50, reason: "large_below_threshold" }), "50 % Car ≤ 50 %");
  assert.equal(said({ match_percent: 9.96 }), "9.96 % Car < 10 %");
  assert.equal(said({ match_percent: 9.9999 }), "9.9999 % Car < 10 %");
  assert.equal(said({ match_percent: 10, ...kept }), "10 % Car ≥ 10 %");
  assert.equal(said({ match_percent: 10.0004, ...kept }), "10.0004 % Car ≥ 10 %");
  assert.equal(said({ match_percent: 12.26, threshold: 12.25, ...kept }), "12.3 % Car ≥ 12.25 %");
  assert.equal(said({ match_percent: 0.004, threshold: 0.5 }), "0.004 % Car < 0.5 %");
  assert.equal(said({ match_percent: 99.99, threshold: 10, ...kept }), "99.99 % Car ≥ 10 %");
});

test("a label says 100 % hidden only if it is exactly 100 %", () => {
  const said = (/** @type {number} */ percent) => labelText(decision({ hidden_by: [{ tag: 9, name: "Vegetation", percent }] }));
  assert.match(said(99.7), /hidden by Vegetation 99\.7 %$/);
  assert.match(said(100), /hidden by Vegetation 100 %$/);
  assert.match(said(0.3), /hidden by Vegetation 0\.3 %$/);
});

test("lists do not round a match to its threshold either", () => {
  assert.equal(matchText(decision({ match_percent: 9.96 })), "9.96 %");
  assert.equal(shortText(decision({ match_percent: 9.96 })), "car 9.96 %");
});

test("the label of a kept box does not name what hides it", () => {
  assert.equal(labelText(decision({ verdict: "kept", reason: "visible", match_percent: 62 })), "62 % Car ≥ 10 %");
});

test("each reason has its own words", () => {
  const bike = [{ tag: 18, name: "Motorcycle", rgb: [0, 0, 230] }, { tag: 13, name: "Rider", rgb: [255, 0, 0] }];
  const cases = [
    [{ reason: "no_visible_pixels", match_percent: 0, threshold: null, hidden_by: [], accepted_tags: bike }, "too few Motorcycle or Rider pixels"],
    [{ matched_pixels: 0, reason: "no_visible_pixels", match_percent: 0, threshold: null, hidden_by: [], accepted_tags: bike }, "no Motorcycle or Rider pixel"],
    [{ reason: "out_of_range", distance: 214.3, hidden_by: [] }, "214 m: out of range"],
    [{ reason: "outside_image", hidden_by: [] }, "outside the image"],
    [{ reason: "no_segmentation", verdict: "unmeasured", match_percent: null, hidden_by: [] }, "not measured"],
  ];
  for (const [some, expected] of cases) assert.equal(labelText(decision(/** @type {any} */ (some))), expected);
});

test("the label of a box that another channel judged gives that channel's explanation, and no match", () => {
  const judged = { match_percent: 69.8, threshold: null, margin: null, explained_by: "122" };
  const cases = [
    ["ordered", "rejected", "explained_by_nearer", "its Car pixels belong to nearer boxes, above all car 122"],
    ["depth", "rejected", "hidden_by_depth", "all Car pixels here are 2.6 m nearer than the box"],
    ["instance", "rejected", "hidden_by_instance", "no instance in the image belongs to it"],
    ["lidar", "rejected", "too_few_lidar_points", "no LiDAR points of Car lie inside it, 5 are needed"],
    ["depth", "kept", "visible", "1,125 of its Car pixels are at its own distance"],
  ];
  for (const [evidence, verdict, reason, words] of cases) {
    const box = decision({ ...judged, evidence, verdict, reason, explanation: `${verdict}: ${words}` });
    assert.equal(labelText(box), words);
    assert.equal(shortText(box), "car");
    assert.equal(matchText(box), "");
  }
});

test("without an explanation by the server, the label names the reason", () => {
  const box = decision({ evidence: "lidar", reason: "too_few_lidar_points", threshold: null });
  assert.equal(labelText(box), "too few LiDAR points");
});

test("a reason that the page does not know is shown readably", () => {
  assert.equal(reasonText("eaten_by_grue"), "eaten by grue");
});

test("the text for screen readers names box, verdict and answer", () => {
  const box = decision({ review: { verdict: "keep", reviewer: "ada", revision: 1 } });
  assert.equal(spokenText(box), "car 217, rejected, answered keep: 4.1 % Car < 10 % · hidden by Vegetation 71 %");
  assert.equal(shortText(box), "car 4.1 %");
});

test("lists show the match where the segmentation decided, and nothing where nothing was measured", () => {
  assert.equal(matchText(decision()), "4.1 %");
  assert.equal(matchText(decision({ evidence: null, match_percent: null, threshold: null })), "");
});

test("what led to a verdict is said by numbers that differ, or by its reason", () => {
  /** @param {Partial<import("../../../static/js/core/openapi.js").FlipSide>} some */
  const text = (some) => causeText({ verdict: "rejected", reason: "below_threshold", match_percent: 16.49, threshold: 16.5, ...some }).replaceAll("\u00a0", " ");

  assert.equal(text({}), "match 16.49 % < 16.5 %");
  assert.equal(text({ match_percent: 16.5 }), "match 16.5 % ≤ 16.5 %");
  assert.equal(text({ verdict: "kept", reason: "visible", match_percent: 16.52 }), "match 16.52 % ≥ 16.5 %");
  assert.equal(text({ reason: "large_below_threshold", threshold: 30 }), "large, match 16.5 % < 30 %");
  assert.equal(text({ reason: "no_visible_pixels", threshold: null }), "too few visible pixels");
});
