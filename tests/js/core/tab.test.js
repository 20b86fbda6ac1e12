import assert from "node:assert/strict";
import { afterEach, beforeEach, test } from "node:test";

import { nameThisTab } from "../../../static/js/core/tab.js";
import { memoryStorage } from "../../support/page/builders.js";

const { BroadcastChannel } = globalThis;
/** @type {BroadcastChannel[]} */
let channels;

beforeEach(() => {
  // Without `navigator.locks`, as on a page that was loaded over http:// from another machine.
  Object.defineProperty(globalThis, "navigator", { value: {}, configurable: true });
  channels = [];
  globalThis.BroadcastChannel = class extends BroadcastChannel {
    /** @param {string} name */
    constructor(name) {
      super(name);
      channels.push(this);
    }
  };
});

afterEach(() => channels.forEach((channel) => channel.close()));

/** Open a tab; `close` closes it. */
async function openTab(sessionStorage = memoryStorage()) {
  Object.assign(globalThis, { sessionStorage });
  const { tab, openTabs } = await nameThisTab();
  const channel = channels.at(-1);
  return { tab, openTabs, close: () => channel?.close() };
}

test("a tab that is reloaded keeps its name", async () => {
  const storage = memoryStorage();
  const before = await openTab(storage);
  before.close();

  assert.equal((await openTab(storage)).tab, before.tab);
});

test("without locks, open tabs answer each other, so that each knows which are open", async () => {
  const first = await openTab();
  const second = await openTab();
  const third = await openTab();
  third.close();

  const [open, atTheSameTime] = await Promise.all([second.openTabs(), second.openTabs()]);

  for (const tabs of [open, atTheSameTime, await first.openTabs()]) {
    assert.deepEqual([first, second, third].map(({ tab }) => tabs.has(tab)), [true, true, false]);
  }
});
