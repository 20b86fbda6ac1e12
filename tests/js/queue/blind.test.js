import assert from "node:assert/strict";
import { test } from "node:test";

import { compared, isBlind } from "../../../static/js/queue/line.js";
import { decision } from "../builders.js";

const review = (verdict) => ({ verdict, reviewer: "bo", revision: 1, comment: "I think so" });

test("an audit is blind unless one wants to see", () => {
  assert.ok(isBlind({ order: "audit" }, { blind: false }));
  assert.ok(!isBlind({ order: "audit", blind: "off" }, { blind: true }));
  assert.ok(!isBlind({}, { blind: false }));
  assert.ok(isBlind({}, { blind: true }));
  assert.ok(isBlind({ blind: "on" }, {}));
});

test("one is told whether one agrees with the person before, else with the filter", () => {
  const reviewed = decision({ review: review("keep") });

  assert.equal(compared(reviewed, "keep")?.agrees, true);
  assert.match(compared(reviewed, "reject")?.words ?? "", /bo said keep, you said reject/);
  assert.equal(compared(decision({ verdict: "rejected" }), "reject")?.agrees, true);
  assert.equal(compared(decision({ verdict: "rejected" }), "keep")?.agrees, false);
  assert.equal(compared(reviewed, "unsure"), null);
  assert.equal(compared(decision({ verdict: "unmeasured" }), "keep"), null);
});
