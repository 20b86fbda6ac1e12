import assert from "node:assert/strict";
import { test } from "node:test";

import { createLatest } from "../../../static/js/tuning/preview.js";

/** A server whose requests stay open until the test answers or refuses them. */
function slowServer() {
  /** @type {{question: number, answer: (text: string) => void, refuse: (error: Error) => void}[]} */
  const open = [];
  /** @param {number} question @returns {Promise<string>} */
  const ask = (question) => new Promise((answer, refuse) => open.push({ question, answer, refuse }));
  return { open, ask };
}

/** @param {(question: number) => Promise<string>} ask */
function listen(ask) {
  /** @type {unknown[]} */
  const heard = [];
  const latest = createLatest(ask, {
    onAnswer: (answer, question) => heard.push([question, answer]),
    onError: (error) => heard.push(String(error)),
    onBusy: (isBusy) => heard.push(isBusy),
  });
  return { heard, latest };
}

const turn = () => new Promise((done) => setImmediate(done));

test("only one preview is requested at a time, and of those that wait only the last one is sent", async () => {
  const { open, ask } = slowServer();
  const { heard, latest } = listen(ask);

  for (const question of [1, 2, 3, 4]) latest.ask(question);
  assert.deepEqual(open.map(({ question }) => question), [1]);
  open[0]?.answer("one");
  await turn();
  assert.deepEqual(open.map(({ question }) => question), [1, 4]);
  open[1]?.answer("four");
  await turn();

  assert.deepEqual(heard, [true, [1, "one"], [4, "four"], false]);
});

test("a refused preview is reported, and the next one is sent all the same", async () => {
  const { open, ask } = slowServer();
  const { heard, latest } = listen(ask);

  latest.ask(1);
  latest.ask(2);
  open[0]?.refuse(new Error("no"));
  await turn();
  open[1]?.answer("two");
  await turn();

  assert.deepEqual(heard, [true, "Error: no", [2, "two"], false]);
});

test("after stop, no answer is reported and no request is sent", async () => {
  const { open, ask } = slowServer();
  const { heard, latest } = listen(ask);

  latest.ask(1);
  latest.ask(2);
  latest.stop();
  open[0]?.answer("late");
  await turn();

  assert.deepEqual(heard, [true]);
  assert.equal(open.length, 1);
});
