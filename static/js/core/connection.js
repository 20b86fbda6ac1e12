// @ts-check
// Who is signed in, in this browser. It is kept in localStorage: unlike a cookie it is shown to no
// other port and no other site, and nothing sends it that this page does not send. All tabs share it.

import { showSession } from "./api.js";
import { createValue } from "./observable.js";

/** @typedef {import("./openapi.js").NewSession} NewSession */

export const SESSION_KEY = "unghost.session.v1";

/** @param {Storage} storage */
export function createSession(storage) {
  const current = createValue(stored(storage));
  showSession(current.get()?.session ?? "");
  /** Whose answers this page holds: the first person who was signed in here. */
  let owner = current.get()?.name ?? "";

  /** @param {NewSession | null} next @returns {boolean} false: another person's, for whom the page has to start anew */
  function take(next) {
    if (next && owner && next.name !== owner) return false;
    owner ||= next?.name ?? "";
    showSession(next?.session ?? "");
    current.set(next);
    return true;
  }

  return {
    current,

    /** The person whose answers this page sends; empty before anybody has signed in. */
    owner: () => owner,

    /** Sign this browser in. @param {NewSession} next @returns {boolean} as `follow` */
    keep(next) {
      storage.setItem(SESSION_KEY, JSON.stringify(next));
      return take(next);
    },

    /** Another tab has signed in or out. @returns {boolean} false: as another person; nothing of this page may be sent any more */
    follow: () => take(stored(storage)),

    /** The server takes it no more. One that another tab has got meanwhile stays. @returns {boolean} as `follow` */
    end() {
      if (stored(storage)?.session === current.get()?.session) storage.removeItem(SESSION_KEY);
      return take(stored(storage));
    },
  };
}

/** @typedef {ReturnType<typeof createSession>} Session */

/** @param {Storage} storage @returns {NewSession | null} */
function stored(storage) {
  try {
    const found = JSON.parse(storage.getItem(SESSION_KEY) ?? "null");
    return typeof found?.session === "string" && typeof found.name === "string" ? found : null;
  } catch {
    return null;
  }
}

/** @type {Record<string, string>} by what the server says of a session that opens nothing any more */
const ENDED = {
  session_expired: "Your session has ended.",
  token_expired: "Your token has expired. Ask an admin for a new one.",
  token_revoked: "Your token was revoked. Ask an admin for a new one.",
};

/** @param {string | undefined} code */
export const endedText = (code) => ENDED[code ?? ""] ?? "";
