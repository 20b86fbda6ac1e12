// @ts-check
// The outbox: answers that the server has not stored yet. They are kept in localStorage, so that they survive a reload
// and the end of their tab. Nothing is sent here: that is what sender.js does.
//
// An item of the outbox is an answer on one box or the undo of one, a bulk answer (one answer on many boxes), or the
// undo of a bulk answer. Each tab sends its own items, in their order.
//
// Every answer that the server stores gives its box the next revision. For each of its boxes, an item has the *seen
// revision*: that of the box as the person saw it. If the box has a newer one when the item arrives, somebody else has
// answered it meanwhile, and the server refuses the item.
//
// If a person answers the same box twice, two items on it may wait:
//
// - As long as the first one waits, the page shows the box with that answer, even if it has loaded newer answers of
//   other people since. The person has not seen those. So the second item gets the seen revision of the first (`add`),
//   and if somebody else has answered the box since that revision, the server refuses both items.
// - When the first one is stored, the box has a newer revision. A second item of the same tab gets it as its seen
// revision (`finish`). One of another tab keeps the old one: the server refuses it, and the person chooses between the
//   two answers.

import { randomId } from "../core/tab.js";

/** @import { Answer, AnswerWithComment } from "../boxes/box.js" */
/** @import { BoxSelection as Filter } from "../core/openapi.js" */
/** @import { OpenTabs } from "../core/tab.js" */

/**
 * @typedef {object} SingleAnswer  on one box, or the undo of one
 * @property {string} key  see also `idempotencyKey`
 * @property {string} person  who gave it: it is sent under no other name
 * @property {string} tab  the id of the tab that sends it
 * @property {number} order  about when it was given, in milliseconds since 1970: the lowest is sent first
 * @property {number} boxId
 * @property {number} frameId
 * @property {Answer} verdict  of an undo: that of the answer which the box gets again; so is the comment
 * @property {string} comment
 * @property {number} seenRevision  the box's revision that the person saw
 * @property {number | null} [lookedMs]  for how long the person had the box and its picture on the screen
 * @property {boolean} [attempted]  see `wasAttempted`
 * @property {number} [renewed]  how many times it was made a new answer, see `renew`
 * @property {number} [undoes]  of an undo: the revision of the answer that it undoes
 * @property {AnswerWithComment} [earlier] of an answer that was undone while it was being sent: what the box gets again
 */

/**
 * @typedef {object} GivenAnswer  what is needed to undo an answer on one box
 * @property {string} key  of its item
 * @property {number | null} revision  of its box, once it is stored
 */

/**
 * @typedef {object} BulkAnswer  one answer on many boxes: on those in `boxIds`, or on all that match `filter`
 * @property {string} key  also the Idempotency-Key
 * @property {string} person  who gave it: it is sent under no other name
 * @property {string} tab  the id of the tab that sends it
 * @property {number} order
 * @property {string} dataset
 * @property {Answer} verdict
 * @property {number[]} [boxIds]
 * @property {number[]} [seenRevisions]  the revision of each of these boxes that the person saw
 * @property {Filter} [filter]
 * @property {string} [snapshot]  with `filter`: identifies the state of the list that the person saw
 * @property {number} count  of boxes
 * @property {boolean} [attempted]  see `wasAttempted`
 * @property {number} [lookedAt]  how many of the boxes had their picture on the screen
 */

/**
 * @typedef {object} BulkUndo  the undo of a bulk answer as a whole
 * @property {string} key
 * @property {string} person
 * @property {string} tab
 * @property {number} order
 * @property {string} dataset
 * @property {string} bulkKey  the key of the bulk answer
 * @property {number | null} batchId  the bulk answer's id on the server; null until that is stored, which is sent first
 * @property {number[]} [boxIds]  the boxes that get their earlier answers again; missing if the page does not know them
 * @property {number[]} [seenRevisions]  the revision of each of these boxes that the person saw
 * @property {AnswerWithComment[]} before  the earlier answer on each of these boxes
 * @property {number[]} [laterIds]  the other boxes of the bulk answer: this person has given a later answer on them
 * @property {number} count  of boxes
 */

/** @typedef {BulkAnswer | BulkUndo} BulkItem */
/** @typedef {SingleAnswer | BulkItem} OutboxItem */
/**
 * @typedef {Pick<SingleAnswer, "boxId" | "frameId" | "verdict" | "comment" | "seenRevision" | "lookedMs">} NewAnswer
 */
/** @typedef {Omit<BulkAnswer, "key" | "tab" | "person" | "order" | "attempted">} NewBulkAnswer */
/** @typedef {Omit<BulkUndo, "key" | "tab" | "person" | "order">} NewBulkUndo */

/** @param {OutboxItem} item @returns {item is SingleAnswer} */
export const isSingle = (item) => "boxId" in item;

/** @param {OutboxItem} item @returns {item is BulkUndo} */
export const isBulkUndo = (item) => "bulkKey" in item;

/** @param {OutboxItem} item @returns {item is BulkItem} */
export const isBulk = (item) => !isSingle(item);

/** @param {OutboxItem} item @returns {item is BulkAnswer} */
export const isBulkAnswer = (item) => isBulk(item) && !isBulkUndo(item);

/**
 * Whether it may have reached the server: a retry must send exactly the same. (The request of an undo has only the id
 * of a bulk answer, so it is always the same.)
 * @param {OutboxItem} item
 */
export const wasAttempted = (item) => !isBulkUndo(item) && item.attempted === true;

/** Retries of an answer have the same key on the server, but not after `renew`. @param {SingleAnswer} item */
export const idempotencyKey = ({ key, renewed }) => (renewed ? `${key}.${renewed}` : key);

/**
 * How many answers these are: boxes with an answer on one box, and the boxes of each bulk item.
 * @param {readonly OutboxItem[]} items
 */
export function countAnswers(items) {
  const inBulk = items.filter(isBulk).reduce((sum, { count }) => sum + count, 0);
  return new Set(items.filter(isSingle).map(({ boxId }) => boxId)).size + inBulk;
}

/**
 * The seen revision of each box of an item. None for a bulk item on a filter.
 * @param {OutboxItem} item @returns {[boxId: number, revision: number][]}
 */
function seenRevisionsOf(item) {
  if (isSingle(item)) return [[item.boxId, item.seenRevision]];
  return (item.boxIds ?? []).map((boxId, i) => [boxId, item.seenRevisions?.[i] ?? 0]);
}

/**
 * The item with these seen revisions.
 * @template {OutboxItem} T
 * @param {T} item @param {ReadonlyMap<number, number>} revisions  by box; boxes that are missing stay as they are
 * @returns {T}  the same item if it has none of these boxes
 */
function withSeen(item, revisions) {
  if (!seenRevisionsOf(item).some(([boxId]) => revisions.has(boxId))) return item;
  if (isSingle(item)) return { ...item, seenRevision: revisions.get(item.boxId) ?? item.seenRevision };
  const { boxIds = [], seenRevisions = [] } = item;
  return { ...item, seenRevisions: seenRevisions.map((seen, i) => revisions.get(boxIds[i] ?? 0) ?? seen) };
}

/**
 * @param {Storage} storage @param {string} tab  the id of this tab
 * @param {() => string} who  returns the person who is signed in
 * @param {() => string} [newKey]
 */
export function createOutbox(storage, tab, who, newKey = randomId) {
  /** @param {OutboxItem} item */
  const write = (item) => storage.setItem(nameOf(item), JSON.stringify(item));

  /** @param {OutboxItem} item */
  const remove = (item) => storage.removeItem(nameOf(item));

  /** @param {OutboxItem} item */
  const isOfThisTab = (item) => item.tab === tab;

  /** The items of this person in any tab, in their order. */
  const itemsOfAllTabs = () => storedItems(storage).filter((item) => item.person === who());

  /** The items of this person and this tab, in their order. */
  const items = () => itemsOfAllTabs().filter(isOfThisTab);

  /** Now, or just after the last item of this tab. */
  const nextOrder = () =>
    Math.max(Date.now(), ...storedItems(storage).flatMap((item) => (isOfThisTab(item) ? item.order + 1 : [])));

  /**
   * Add an item. Where another one waits on the same box, it gets that one's seen revision.
   * @param {OutboxItem} item
   */
  const add = (item) => write(withSeen(item, new Map(itemsOfAllTabs().flatMap(seenRevisionsOf))));

  /** @param {string} key */
  const answer = (key) =>
    items()
      .filter(isSingle)
      .find((item) => item.key === key);

  /** @param {NewAnswer & Pick<SingleAnswer, "key" | "undoes">} item */
  const addSingle = (item) => add({ ...item, person: who(), tab, order: nextOrder(), attempted: false });

  return {
    items,
    itemsOfAllTabs,
    isOfThisTab,
    remove,

    /** Boxes with an answer of this person that another tab has to send. */
    boxesOfOtherTabs: () =>
      new Set(
        itemsOfAllTabs()
          .filter((item) => !isOfThisTab(item))
          .flatMap((item) => (isSingle(item) ? [item.boxId] : (item.boxIds ?? []))),
      ),

    /**
     * This person's last answer on each box, from whichever tab it is sent: a tab that is loaded again may find that
     * another one has taken over its answers. Bulk answers on a filter are left out: the page does not know which boxes
     * they select.
     * @returns {Map<number, AnswerWithComment>}
     */
    lastAnswers() {
      /** @type {Map<number, AnswerWithComment>} */
      const last = new Map();
      for (const item of itemsOfAllTabs()) {
        if (isSingle(item)) last.set(item.boxId, item.earlier ?? { verdict: item.verdict, comment: item.comment });
        else if (isBulkUndo(item))
          item.boxIds?.forEach((boxId, i) => last.set(boxId, item.before[i] ?? { verdict: "clear", comment: "" }));
        else item.boxIds?.forEach((boxId) => last.set(boxId, { verdict: item.verdict, comment: "" }));
      }
      return last;
    },

    /** Add an answer on one box. @param {NewAnswer} newAnswer @returns {GivenAnswer} */
    addAnswer(newAnswer) {
      const key = newKey();
      addSingle({ ...newAnswer, key });
      return { key, revision: null };
    },

    /**
     * Undo an answer on one box.
     * @param {GivenAnswer} given @param {NewAnswer} earlier  what its box gets again
     * @returns {boolean} false: this tab does not know what has become of the answer, as another tab has sent it
     */
    undoAnswer({ key, revision }, earlier) {
      const item = answer(key);
      if (item) {
        const { verdict, comment } = earlier;
        // If it was sent, it may be stored: `finish` makes the undo of it then.
        if (item.attempted) write({ ...item, earlier: { verdict, comment } });
        else remove(item); // it was never sent: as if it had not been given
        return true;
      }
      if (revision === null) return false;
      addSingle({ ...earlier, key: newKey(), undoes: revision });
      return true;
    },

    /** Whether an answer that is being sent was undone meanwhile. @param {OutboxItem} item */
    wasUndone: ({ key }) => answer(key)?.earlier !== undefined,

    /** @param {NewBulkAnswer} bulk @param {string} [key] */
    addBulkAnswer: (bulk, key = newKey()) =>
      add({ ...bulk, key, person: who(), tab, order: nextOrder(), attempted: false }),

    /** @param {NewBulkUndo} undo */
    addBulkUndo: (undo) => add({ ...undo, key: newKey(), person: who(), tab, order: nextOrder() }),

    /** @param {string} key @returns {BulkAnswer | undefined} */
    bulkAnswer: (key) =>
      items()
        .filter(isBulkAnswer)
        .find((bulk) => bulk.key === key),

    /** The undo of this bulk answer, if there is one. @param {string} key */
    undoOf: (key) =>
      items()
        .filter(isBulkUndo)
        .find((undo) => undo.bulkKey === key),

    /** @param {SingleAnswer | BulkAnswer} item */
    markAttempted: (item) => write({ ...item, attempted: true }),

    /**
     * Remove an item that is stored now, and give its boxes' new revisions to the later items of this tab. An item
     * that may have reached the server keeps its own: it must be sent again exactly as it was. If an answer was undone
     * while it was being sent, its undo takes its place.
     * @param {OutboxItem} stored
     * @param {{leftOut?: readonly number[], revision?: number}} outcome  the boxes that a bulk item did not change; the
     *   box's revision after an answer on one box
     */
    finish(stored, { leftOut = [], revision }) {
      const kept = answer(stored.key); // it may have been undone since `stored` was read
      remove(stored);
      // First the undo: it has room where the answer was, also if the storage is full.
      // (An answer that changed nothing has left the revision as it was, and there is nothing to undo.)
      if (kept?.earlier && revision && revision !== kept.seenRevision) {
        const { earlier, ...answered } = kept;
        const { verdict, comment } = earlier; // what the box gets again
        const undo = { ...answered, verdict, comment, key: newKey(), undoes: revision, attempted: false };
        write({ ...undo, seenRevision: revision }); // with the answer's `order`: it is sent before the later items
      }
      // The response to a bulk item names no revisions: each is the next one.
      const revisions = new Map(seenRevisionsOf(stored).map(([boxId, seen]) => [boxId, revision ?? seen + 1]));
      for (const boxId of leftOut) revisions.delete(boxId);
      for (const item of items()) {
        if (item.order <= stored.order || wasAttempted(item)) continue;
        const raised = withSeen(item, revisions);
        if (raised !== item) write(raised);
      }
    },

    /**
     * Make an answer a new one, with this seen revision. The server has not stored it as it was.
     * @param {SingleAnswer} item @param {number} revision
     */
    renew(item, revision) {
      // The item must not grow, because the storage may be full. So `attempted` goes (JSON leaves out what is
      // undefined)
      // when `renewed` comes.
      write({ ...item, seenRevision: revision, renewed: (item.renewed ?? 0) + 1, attempted: undefined });
    },

    /**
     * A bulk answer was stored: put the server's id into its undo, and remove the boxes that it has left out.
     * @param {BulkAnswer} bulk @param {number} batchId @param {readonly number[]} leftOut
     */
    completeUndo(bulk, batchId, leftOut) {
      const undo = items()
        .filter(isBulkUndo)
        .find(({ bulkKey }) => bulkKey === bulk.key);
      if (!undo) return;
      const { boxIds, seenRevisions, before } = undo;
      const left = new Set(leftOut);
      /** @type {<T>(values: T[]) => T[]} */
      const rest = (values) => values.filter((_, i) => !left.has(boxIds?.[i] ?? 0));
      const boxes = boxIds && seenRevisions ? { boxIds: rest(boxIds), seenRevisions: rest(seenRevisions) } : {};
      write({ ...undo, ...boxes, batchId, before: rest(before) });
    },

    /** Take over the items of closed tabs, of all people. @param {OpenTabs} openTabs */
    takeOver(openTabs) {
      for (const item of storedItems(storage)) if (item.tab !== tab && !openTabs.has(item.tab)) write({ ...item, tab });
    },

    /** How many answers of each person are kept in this browser, by any tab. @returns {Map<string, number>} */
    countByPerson() {
      const all = storedItems(storage);
      const people = new Set(all.map(({ person }) => person));
      return new Map([...people].map((name) => [name, countAnswers(all.filter(({ person }) => person === name))]));
    },
  };
}

/** @typedef {ReturnType<typeof createOutbox>} Outbox */

// What is kept in localStorage. Names and fields stay as they are: later versions of the page read and write them too,
// perhaps in another tab at the same time.

const ANSWER_PREFIX = "unghost.outbox.v1.";
const BULK_PREFIX = "unghost.bulk.v1.";
const UNDO_PREFIX = "unghost.undo.v1.";

/** @param {OutboxItem} item */
function nameOf(item) {
  if (isSingle(item)) return ANSWER_PREFIX + item.key;
  return (isBulkUndo(item) ? UNDO_PREFIX : BULK_PREFIX) + item.key;
}

/**
 * Whether an item of the outbox may be stored under this name.
 * @param {string | null} name  as of a storage event; null: all was removed
 */
export const isItemName = (name) =>
  name === null || [ANSWER_PREFIX, BULK_PREFIX, UNDO_PREFIX].some((prefix) => name.startsWith(prefix));

/** @param {Storage} storage @returns {OutboxItem[]} in their order */
function storedItems(storage) {
  const names = Array.from({ length: storage.length }, (_, i) => storage.key(i) ?? "").filter(isItemName);
  const items = names.flatMap((name) => parsed(name, storage.getItem(name)) ?? []);
  return items.sort((a, b) => a.order - b.order);
}

/** @param {string} name @param {string | null} text @returns {OutboxItem | null} null: it is no item */
function parsed(name, text) {
  try {
    const item = JSON.parse(text ?? "");
    if (name.startsWith(ANSWER_PREFIX)) return typeof item?.boxId === "number" ? item : null;
    return typeof item?.key === "string" && typeof item.count === "number" ? item : null;
  } catch {
    return null;
  }
}
