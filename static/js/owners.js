// @ts-check
// Answers that an earlier version of the page has kept without saying whose they are. They are
// sent under no name before somebody says that they are theirs.

const PREFIXES = ["unghost.outbox.v1.", "unghost.bulk.v1."];

/** @typedef {{name: string, item: {person?: string}}} Kept */

/** @param {Storage} storage @returns {Kept[]} */
export function unowned(storage) {
  const names = Array.from({ length: storage.length }, (_, i) => storage.key(i) ?? "");
  return names
    .filter((name) => PREFIXES.some((prefix) => name.startsWith(prefix)))
    .flatMap((name) => {
      try {
        const item = JSON.parse(storage.getItem(name) ?? "null");
        return item && !item.person ? [{ name, item }] : [];
      } catch {
        return [];
      }
    });
}

/** @param {Storage} storage @param {string} person  who says so */
export function own(storage, person) {
  for (const { name, item } of unowned(storage)) storage.setItem(name, JSON.stringify({ ...item, person }));
}
