import assert from "node:assert/strict";
import { test } from "node:test";

import { createBundles } from "../../../static/js/boxes/bundles.js";

const never = new AbortController().signal;
const tick = () => new Promise((done) => setTimeout(done));

const addressOf = (id, version = "") => `/api/v1/boxes/${id}/crop?pad=0.5&height=64${version && `&v=${version}`}`;

/** A tar of these files, as the server sends it. @param {Record<string, string>} files */
function tarOf(files) {
  const parts = Object.entries(files).flatMap(([name, text]) => {
    const head = name.padEnd(124, "\0") + text.length.toString(8).padStart(11, "0");
    return [head.padEnd(512, "\0"), text && text.padEnd(512, "\0")];
  });
  return new Blob([...parts, "\0".repeat(1024)]);
}

test("crops that are asked for in the same moment come in few requests, and one that is missing is asked for alone", async () => {
  const asked = [];
  const fetchCrop = createBundles(async (address) => {
    asked.push(address.split("?")[0]);
    const query = new URLSearchParams(address.split("?")[1]);
    const names = query.get("crops")?.split(",").filter((name) => !name.startsWith("2-"));
    return names ? tarOf(Object.fromEntries(names.map((name) => [`${name}.webp`, name.startsWith("3-") ? "" : name]))) : new Blob(["alone"]);
  });

  const files = await Promise.allSettled([...Array(14).keys()].map((id) => fetchCrop(addressOf(id), never)));
  await fetchCrop(addressOf(1), never);

  const texts = await Promise.all(files.map((file) => (file.status === "fulfilled" ? file.value.text() : file.reason.status)));
  assert.deepEqual(texts, [...Array(14).keys()].map((id) => (id === 2 ? "alone" : id === 3 ? 404 : `${id}-0.5-64`)));
  assert.deepEqual(asked, ["/api/v1/boxes/crops", "/api/v1/boxes/crops", "/api/v1/boxes/2/crop", "/api/v1/boxes/1/crop"]);
});

test("few requests are under way at a time, and crops that are given up meanwhile are not asked for", async () => {
  /** @type {(() => void)[]} */
  const ends = [];
  const fetchCrop = createBundles(() => new Promise((resolve) => ends.push(() => resolve(new Blob(["x"])))), { parallel: 2 });
  const stop = new AbortController();
  const wanted = (id, signal) => fetchCrop(`/api/v1/frames/${id}/thumbnail`, signal).catch(() => {});
  for (const id of [1, 2]) void wanted(id, never);
  for (const id of [3, 4]) void wanted(id, stop.signal);
  void wanted(5, never);
  await tick();
  assert.equal(ends.length, 2);

  stop.abort();
  for (const end of ends) end();
  await tick();

  assert.equal(ends.length, 3);
});

test("the address of several crops changes with the version of any, and their request ends when none is wanted any more", async () => {
  const asked = [];
  const fetchCrop = createBundles((address, signal) => new Promise((_, reject) => {
    asked.push(address);
    signal.addEventListener("abort", () => reject(new DOMException("aborted", "AbortError")));
  }));
  const stops = ["a", "b"].map((version) => {
    const stop = new AbortController();
    const ended = Promise.allSettled([addressOf(1, version), addressOf(2)].map((address) => fetchCrop(address, stop.signal)));
    return { stop, ended };
  });
  await tick();
  assert.equal(asked.length, 1);
  for (const { stop } of stops) stop.abort();
  const ends = (await Promise.all(stops.map(({ ended }) => ended))).flat();
  assert.ok(ends.every(({ status }) => status === "rejected"));

  void Promise.allSettled([addressOf(1), addressOf(2), addressOf(1), addressOf(2)].map((address) => fetchCrop(address, never)));
  await tick();

  assert.notEqual(asked[0], asked[1]);
});
