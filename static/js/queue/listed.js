// @ts-check
// Boxes that the address names one by one, in the order in which they are looked at. Pure.

/** @typedef {import("../router.js").Query} Query */

const MOST = 50;

/** @param {Query} query @returns {number[]} nonsense is left out */
export function listedOf(query) {
  const ids = (query.boxes ?? "").split(",").map(Number).filter((id) => Number.isSafeInteger(id) && id > 0);
  return [...new Set(ids)].slice(0, MOST);
}

/** @param {readonly number[]} ids @returns {Query} */
export const listQuery = (ids) => ({ boxes: ids.slice(0, MOST).join(",") });

/** @param {Query} query @returns {Query} */
export const withoutList = ({ boxes: _, ...rest }) => rest;
