// @ts-check
// The tabs of this browser that show the page: a name for this one, and which others are open.

/** 128 random bits. (`crypto.randomUUID` and `navigator.locks` are missing on pages that are not served securely.) */
export const randomId = () =>
  Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");

const TAB_LOCK = "unghost-tab-";

/** @typedef {Pick<ReadonlySet<string>, "has">} OpenTabs */

/**
 * A name for this tab that survives a reload, held as a lock as long as the tab is open.
 * A duplicated tab starts with the other's name, finds the lock taken, and gets its own.
 * @returns {Promise<{tab: string, openTabs: () => Promise<OpenTabs>}>}  `openTabs`: those that are open now
 */
export async function nameThisTab() {
  const remembered = sessionStorage.getItem("unghost.tab") ?? randomId();
  const tab = (await holdLock(TAB_LOCK + remembered)) ? remembered : randomId();
  if (tab !== remembered) await holdLock(TAB_LOCK + tab);
  sessionStorage.setItem("unghost.tab", tab);
  let isFirst = true;
  return {
    tab,
    async openTabs() {
      const isStart = isFirst;
      isFirst = false;
      // Without locks nobody knows. Then this tab takes over what others have left when it is opened, and nothing later.
      if (!navigator.locks) return { has: () => !isStart };
      const { held = [] } = await navigator.locks.query();
      return new Set(held.map(({ name = "" }) => name.slice(TAB_LOCK.length)));
    },
  };
}

/** @param {string} name @returns {Promise<boolean>} true also in browsers without locks */
function holdLock(name) {
  if (!navigator.locks) return Promise.resolve(true);
  return new Promise((resolve) => {
    navigator.locks.request(name, { ifAvailable: true }, (lock) => {
      resolve(lock !== null);
      return lock === null ? undefined : new Promise(() => {});
    });
  });
}
