import assert from "node:assert/strict";
import { test } from "node:test";

import { withAnswer, withStored } from "../../../static/js/boxes/box.js";
import { decision } from "../../support/page/builders.js";

test("an answer changes the effective verdict, never the filter's", () => {
  const box = decision();
  assert.deepEqual(["keep", "reject", "unsure", "clear"].map((answer) => withAnswer(box, /** @type {any} */ (answer)).effective_verdict), ["kept", "rejected", "rejected", "rejected"]);
  assert.equal(withAnswer(box, "keep").verdict, "rejected");
  assert.equal(withAnswer(box, "clear").review, null);
});

test("a stored answer replaces the shown one, and brings the server's revision", () => {
  const stored = /** @type {any} */ ({ box_id: 1, revision: 4, verdict: "clear", reviewer: "ada", comment: "", effective_verdict: "rejected" });
  const box = withStored(withAnswer(decision(), "keep"), stored);
  assert.deepEqual([box.review, box.revision, box.effective_verdict], [null, 4, "rejected"]);
});
