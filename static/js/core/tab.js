// @ts-check
// The tabs of this browser that show the page: a name for this one, and which of them are open.

/** 128 random bits. (`crypto.randomUUID` and `navigator.locks` are missing on pages that are not served securely.) */
export const randomId = () =>
  Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");

/** @typedef {Pick<ReadonlySet<string>, "has">} OpenTabs */

/**
 * A name for this tab that survives a reload.
 * @returns {Promise<{tab: string, openTabs: () => Promise<OpenTabs>}>}  `openTabs`: the names of the tabs that are open
 *   now, this one included
 */
export async function nameThisTab() {
  const remembered = sessionStorage.getItem("unghost.tab") ?? randomId();
  const tab = navigator.locks ? await lockName(remembered) : remembered;
  sessionStorage.setItem("unghost.tab", tab);
  return { tab, openTabs: navigator.locks ? lockedNames : createRollCall(tab) };
}

const TAB_LOCK = "unghost-tab-";

/**
 * Hold the tab's name as a lock for as long as the tab is open. A duplicated tab starts with the name of the other one,
 * finds its lock taken, and gets another name.
 * @param {string} name @returns {Promise<string>} the name that was locked
 */
const lockName = (name) =>
  new Promise((resolve) => {
    navigator.locks.request(TAB_LOCK + name, { ifAvailable: true }, (lock) => {
      resolve(lock ? name : lockName(randomId()));
      return lock ? new Promise(() => {}) : undefined;
    });
  });

async function lockedNames() {
  const { held = [] } = await navigator.locks.query();
  return new Set(held.map(({ name = "" }) => name.slice(TAB_LOCK.length)));
}

const ROLL_CALL = "who is open?";

/** An open tab replies much sooner, also in the background. */
const LONGEST_REPLY_MS = 300;

/**
 * Where there are no locks, the other tabs are asked, and each replies with its name.
 * @param {string} tab @returns {() => Promise<OpenTabs>}
 */
function createRollCall(tab) {
  const channel = new BroadcastChannel("unghost-tabs");
  channel.addEventListener("message", ({ data }) => data === ROLL_CALL && channel.postMessage(tab));

  return async () => {
    const names = new Set([tab]);
    const note = (/** @type {MessageEvent<string>} */ { data }) => data !== ROLL_CALL && names.add(data);
    channel.addEventListener("message", note);
    channel.postMessage(ROLL_CALL);
    await new Promise((resolve) => setTimeout(resolve, LONGEST_REPLY_MS));
    channel.removeEventListener("message", note);
    return names;
  };
}
