import assert from "node:assert/strict";
import { test } from "node:test";

import { appliesTo, classPath, differences, editsBetween, editsOf, effectiveEdits, ownSetting, queryOf, toYaml, valueOf, valueText, withEdits } from "../../../static/js/tuning/config.js";

const ACTIVE = {
  profile: "paper",
  threshold_small_box: 10,
  min_distance: null,
  classes: { traffic_light: { threshold_small_box: 2 }, van: { accept: ["Truck", "Car"] } },
};

test("a class has its own threshold, or else the one for all classes", () => {
  assert.equal(appliesTo(ACTIVE, "car"), 10);
  assert.equal(appliesTo(ACTIVE, "traffic_light"), 2);
  assert.equal(appliesTo(ACTIVE, "street_light"), 2);
});

test("a setting of the dataset that is not the default is used in place of the key of the configuration", () => {
  const dataset = { palette: "auto", lossy_segmentation: "nearest", description: "refuse" };
  const config = { lossy_segmentation: "refuse", palette: "carla-0.9.14" };

  assert.equal(ownSetting(dataset, config, { key: "lossy_segmentation", initial: "refuse" }), "nearest");
  assert.equal(ownSetting(dataset, { lossy_segmentation: "nearest" }, { key: "lossy_segmentation", initial: "refuse" }), "");
  for (const key of ["palette", "description", "min_distance"]) assert.equal(ownSetting(dataset, config, { key, initial: null }), "");
});

test("edits change only the keys that they name, in a copy of the configuration", () => {
  const edits = { threshold_small_box: 12, "classes.car.threshold_small_box": 20, "classes.traffic_light.threshold_small_box": undefined };

  assert.deepEqual(withEdits(ACTIVE, edits), {
    ...ACTIVE,
    threshold_small_box: 12,
    classes: { car: { threshold_small_box: 20 }, van: { accept: ["Truck", "Car"] } },
  });
  assert.equal(ACTIVE.classes.traffic_light.threshold_small_box, 2);
});

test("classes may have any name, dots included", () => {
  const changed = withEdits(ACTIVE, { [classPath("classes.a.b c")]: 3 });

  assert.equal(appliesTo(changed, "classes.a.b c"), 3);
  assert.deepEqual(differences(ACTIVE, changed), [{ path: "classes.classes.a.b c.threshold_small_box", before: undefined, after: 3 }]);
});

test("an edit that restores the active value is dropped", () => {
  const edits = { threshold_small_box: 10, min_distance: 5, "classes.car.threshold_small_box": undefined };
  assert.deepEqual(effectiveEdits(ACTIVE, edits), { min_distance: 5 });
});

test("every kind of edit can be written to an address and read from it again", () => {
  const edits = { profile: "carlasimu", threshold_small_box: 12.5, "classes.traffic_light.threshold_small_box": undefined, "classes.van.accept": ["Truck"] };

  assert.deepEqual(queryOf(edits), {
    profile: "carlasimu",
    threshold_small_box: "12.5",
    "classes.traffic_light.threshold_small_box": "follow",
    "classes.van.accept": '["Truck"]',
  });
  assert.deepEqual(editsOf(ACTIVE, { ...queryOf(edits), class: "car", scale: "log" }), edits);
  assert.deepEqual(editsOf({ ...ACTIVE, min_distance: 5 }, { min_distance: "null" }), { min_distance: null });
});

test("an address cannot set a number to a text", () => {
  assert.deepEqual(editsOf(ACTIVE, { threshold_small_box: "abc", "classes.car.threshold_small_box": "x", profile: "carlasimu" }), { profile: "carlasimu" });
});

test("edits lead from either configuration to the other; differences list keys for all classes first", () => {
  const other = withEdits(ACTIVE, { profile: "carlasimu", "classes.traffic_light.threshold_small_box": undefined });

  assert.deepEqual(differences(ACTIVE, other), [
    { path: "profile", before: "paper", after: "carlasimu" },
    { path: "classes.traffic_light.threshold_small_box", before: 2, after: undefined },
  ]);
  assert.deepEqual(withEdits(ACTIVE, editsBetween(ACTIVE, other)), other);
  assert.deepEqual(withEdits(other, editsBetween(other, ACTIVE)), ACTIVE);
});

test("values of keys are shown in words", () => {
  assert.deepEqual([undefined, null, 0.5, "paper", ["Truck", "Car"], { 40: "Pedestrian", 100: "Car" }, {}].map(valueText), ["as for all", "none", "0.5", "paper", "Truck, Car", "40: Pedestrian, 100: Car", "none"]);
  assert.equal(valueOf(ACTIVE, "classes.van.threshold_small_box"), undefined);
});

test("the YAML file has every key, and quotes names that YAML would misread", () => {
  const config = { ...ACTIVE, classes: { "a: b": { threshold_small_box: 2 }, no: { accept: ["Car", 14] } } };

  assert.equal(
    toYaml(config),
    ["profile: paper", "threshold_small_box: 10", "min_distance: null", "classes:", '  "a: b":', "    threshold_small_box: 2", '  "no":', "    accept: [Car, 14]", ""].join("\n"),
  );
  assert.match(toYaml({ ...ACTIVE, classes: {} }), /\nclasses: \{\}\n$/);
});
