// @ts-check
// Who is signed in, in this browser. The session is kept in localStorage: unlike a cookie, it is
// never sent to other ports of this host, and only this page's own requests carry it. All tabs share it.

import { setSession } from "./api.js";
import { createValue } from "./observable.js";

/**
 * @typedef {import("./openapi.js").NewSession & {pictures?: string}} NewSession `pictures`: a word in the addresses of
 *   its pictures
 */

export const SESSION_KEY = "unghost.session.v1";

/** @param {Storage} storage */
export function createLogin(storage) {
  const current = createValue(stored(storage));
  setSession(current.get()?.session ?? "", current.get()?.pictures);
  /** The person whose answers this page holds: the first one who was signed in on it. */
  let owner = current.get()?.name ?? "";

  /**
   * @param {NewSession | null} next
   * @returns {boolean} false: it belongs to another person, and the page has to be loaded again
   */
  function take(next) {
    if (next && owner && next.name !== owner) return false;
    owner ||= next?.name ?? "";
    setSession(next?.session ?? "", next?.pictures);
    current.set(next);
    return true;
  }

  return {
    current,

    /** The person whose answers this page sends; empty before anybody has signed in. */
    owner: () => owner,

    /** Sign this browser in. @param {NewSession} next @returns {boolean} as `follow` */
    keep(next) {
      const opened = { ...next, pictures: Math.random().toString(36).slice(2, 10) };
      storage.setItem(SESSION_KEY, JSON.stringify(opened));
      return take(opened);
    },

    /**
     * Another tab has signed in or out.
     * @returns {boolean} false: as another person; nothing that this page holds may be sent any more
     */
    follow: () => take(stored(storage)),

    /**
     * The server no longer accepts the session. A newer one, from another tab, stays.
     * @returns {boolean} as `follow`
     */
    end() {
      if (stored(storage)?.session === current.get()?.session) storage.removeItem(SESSION_KEY);
      return take(stored(storage));
    },
  };
}

/** @typedef {ReturnType<typeof createLogin>} Login */

/** @param {Storage} storage @returns {NewSession | null} */
function stored(storage) {
  try {
    const found = JSON.parse(storage.getItem(SESSION_KEY) ?? "null");
    return typeof found?.session === "string" && typeof found.name === "string" ? found : null;
  } catch {
    return null;
  }
}

/** @type {Record<string, string>} by the server's error code for a session that is no longer valid */
const ENDED = {
  session_expired: "Your session has ended.",
  token_expired: "Your token has expired. Ask an admin for a new one.",
  token_revoked: "Your token was revoked. Ask an admin for a new one.",
};

/** @param {string | undefined} code */
export const endedText = (code) => ENDED[code ?? ""] ?? "";
