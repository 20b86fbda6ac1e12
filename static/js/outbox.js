// @ts-check
// Answers that the server has not confirmed yet, in localStorage: they outlive a reload, a
// lost network and an ended session. One entry per answer, so that two tabs never overwrite
// each other's list.

/** @typedef {import("./types.js").Answer} Answer */

/**
 * @typedef {object} QueuedAnswer
 * @property {string} key  also the Idempotency-Key
 * @property {string} person  who gave it: it is sent under no other name
 * @property {string} tab  that sends it
 * @property {number} order
 * @property {number} boxId
 * @property {number} frameId
 * @property {Answer} verdict
 * @property {string} comment
 * @property {number} seenRevision
 * @property {boolean} attempted  may have reached the server: to be repeated word for word
 */

const PREFIX = "unghost.outbox.v1.";

/** @param {Storage} storage @param {string} tab @param {() => string} who  answers now @param {() => string} [newKey] */
export function createOutbox(storage, tab, who, newKey = () => crypto.randomUUID()) {
  /** @param {QueuedAnswer} item */
  const write = (item) => storage.setItem(PREFIX + item.key, JSON.stringify(item));

  const everyone = () => storedItems(storage);

  const mine = () => everyone().filter((item) => item.tab === tab && item.person === who());

  return {
    /** This person's answers in this tab, in the order in which they were given. */
    items: mine,

    /**
     * An answer that has not been sent is replaced; one that may have arrived is followed.
     * @param {{boxId: number, frameId: number, verdict: Answer, comment: string, seenRevision: number}} answer  of whoever answers now
     */
    add(answer) {
      const waiting = mine();
      const same = waiting.find((item) => item.boxId === answer.boxId && !item.attempted);
      if (same) {
        storage.removeItem(PREFIX + same.key);
        write({ ...same, key: newKey(), verdict: answer.verdict, comment: answer.comment });
        return;
      }
      const order = Math.max(0, ...waiting.map((item) => item.order)) + 1;
      write({ ...answer, key: newKey(), person: who(), tab, order, attempted: false });
    },

    /** How many answers of each person are kept in this browser, by any tab. @returns {Map<string, number>} */
    kept() {
      /** @type {Map<string, number>} */
      const counts = new Map();
      for (const { person } of everyone()) if (person) counts.set(person, (counts.get(person) ?? 0) + 1);
      return counts;
    },

    /** @param {QueuedAnswer} item */
    markAttempted: (item) => write({ ...item, attempted: true }),

    /** @param {QueuedAnswer} item */
    remove: (item) => storage.removeItem(PREFIX + item.key),

    /** What waits for this box has now seen that revision. @param {number} boxId @param {number} revision */
    rebase(boxId, revision) {
      for (const item of mine()) if (item.boxId === boxId) write({ ...item, seenRevision: revision });
    },

    /** Take over what closed tabs have left behind. @param {ReadonlySet<string>} openTabs */
    adopt(openTabs) {
      for (const item of everyone()) if (item.tab !== tab && !openTabs.has(item.tab)) write({ ...item, tab });
    },
  };
}

/** @typedef {ReturnType<typeof createOutbox>} Outbox */

/** @param {Storage} storage @returns {QueuedAnswer[]} */
function storedItems(storage) {
  const items = [];
  for (let i = 0; i < storage.length; i++) {
    const name = storage.key(i);
    if (name?.startsWith(PREFIX)) items.push(parsed(storage.getItem(name)));
  }
  return items.filter((item) => item !== null).sort((a, b) => a.order - b.order);
}

/** @param {string | null} text @returns {QueuedAnswer | null} */
function parsed(text) {
  try {
    const item = JSON.parse(text ?? "");
    return typeof item?.boxId === "number" ? item : null;
  } catch {
    return null;
  }
}

const TAB_LOCK = "unghost-tab-";

/**
 * A name for this tab that survives a reload, held as a lock as long as the tab is open.
 * A duplicated tab starts with the other's name, finds the lock taken, and gets its own.
 * @returns {Promise<{tab: string, openTabs: Set<string>}>}
 */
export async function nameThisTab() {
  const remembered = sessionStorage.getItem("unghost.tab") ?? crypto.randomUUID();
  const tab = (await holdLock(TAB_LOCK + remembered)) ? remembered : crypto.randomUUID();
  if (tab !== remembered) await holdLock(TAB_LOCK + tab);
  sessionStorage.setItem("unghost.tab", tab);
  const { held = [] } = (await navigator.locks?.query()) ?? {};
  const names = held.map(({ name = "" }) => name).filter((name) => name.startsWith(TAB_LOCK));
  return { tab, openTabs: new Set(names.map((name) => name.slice(TAB_LOCK.length))) };
}

/** @param {string} name @returns {Promise<boolean>} true without locks, too: there they cannot be asked for */
function holdLock(name) {
  if (!navigator.locks) return Promise.resolve(true);
  return new Promise((resolve) => {
    navigator.locks.request(name, { ifAvailable: true }, (lock) => {
      resolve(lock !== null);
      return lock === null ? undefined : new Promise(() => {});
    });
  });
}
