import assert from "node:assert/strict";
import { test } from "node:test";

import { createLazy, createValue } from "../../../static/js/core/observable.js";

test("an observer may remove itself while it is notified of a change", () => {
  const value = createValue(0);
  /** @type {number[]} */
  const seen = [];
  const stop = value.observe((n) => (seen.push(n), stop()));
  value.observe((n) => seen.push(n * 10));
  value.set(1);
  value.set(1);
  value.set(2);
  assert.deepEqual(seen, [1, 10, 20]);
});

/** A lazy value whose requests stay open until the test answers them. */
function lazyByHand() {
  /** @type {{signal: AbortSignal, answer: (value: string) => void, fail: (error: Error) => void}[]} */
  const requests = [];
  const lazy = createLazy((signal) => new Promise((answer, fail) => requests.push({ signal, answer, fail })));
  return { lazy, requests };
}

test("several callers get their value from one request, and the value is kept", async () => {
  const { lazy, requests } = lazyByHand();
  const asked = [lazy.get(), lazy.get(new AbortController().signal)];
  assert.equal(lazy.value, undefined);

  requests[0]?.answer("here");

  assert.deepEqual(await Promise.all([...asked, lazy.get()]), ["here", "here", "here"]);
  assert.deepEqual([lazy.value, requests.length], ["here", 1]);
});

test("a request is aborted when all its callers have given up, and not before", async () => {
  const { lazy, requests } = lazyByHand();
  const [one, other] = [new AbortController(), new AbortController()];
  void lazy.get(one.signal);
  void lazy.get(other.signal);

  one.abort();
  assert.equal(requests[0]?.signal.aborted, false);
  other.abort();
  assert.equal(requests[0]?.signal.aborted, true);

  const again = lazy.get();
  requests[1]?.answer("again");
  assert.equal(await again, "again");
});

test("a value that is fetched ahead is not aborted when a view that asked for it closes", () => {
  const { lazy, requests } = lazyByHand();
  void lazy.get();
  const view = new AbortController();
  void lazy.get(view.signal);

  view.abort();

  assert.equal(requests[0]?.signal.aborted, false);
});

test("a value whose request failed is requested again", async () => {
  const { lazy, requests } = lazyByHand();
  const first = lazy.get();
  requests[0]?.fail(new Error("no network"));
  await assert.rejects(first, /no network/);

  const second = lazy.get();
  requests[1]?.answer("here");

  assert.equal(await second, "here");
});
