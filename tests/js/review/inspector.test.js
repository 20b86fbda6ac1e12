import assert from "node:assert/strict";
import { test } from "node:test";

import { swatchOf } from "../../../static/js/review/inspector.js";

test("an unknown tag has no swatch", () => {
  assert.equal(swatchOf("Vegetation"), "rgb(107 142 35)");
  assert.equal(swatchOf("<img src=x>"), "transparent");
});
