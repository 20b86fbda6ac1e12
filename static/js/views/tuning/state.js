// @ts-check
// What is being tried, and what the server says about it. Tried values live in the address.

import { useCallback, useEffect, useLayoutEffect, useMemo, useRef, useState } from "../../html.js";
import { FILTER_KEYS } from "../../boxfilter.js";
import { jobs } from "../../calls/jobs.js";
import { createLatest } from "../../latest.js";
import { linkTo } from "../../router.js";
import { configQuery, editsOf, effectiveEdits, queryOf, withEdits } from "../../tuning.js";

/** @typedef {import("../../types_jobs.js").ConfigVersion} ConfigVersion */
/** @typedef {import("../../types_jobs.js").Preview} Preview */
/** @typedef {import("../../tuning.js").Edits} Edits */

/** How long nothing may move before boxes are listed and the address is written. */
const SETTLE_MS = 220;
const FEW = 60;
const MANY = 1000;

/** Parts of the address that are about looking, not about the configuration. */
const VIEW_KEYS = ["class", "scale", "flips", ...FILTER_KEYS];

/** The same for the same content. @param {Record<string, string>} query */
const textOf = (query) => JSON.stringify(Object.entries(query).sort(([a], [b]) => (a < b ? -1 : 1)));

/** @param {import("../../router.js").Query} query */
const viewOf = (query) => Object.fromEntries(VIEW_KEYS.flatMap((key) => (query[key] ? [[key, query[key]]] : [])));

/**
 * @param {import("../../app.js").App} app @param {string} dataset @param {ConfigVersion} active
 * @param {import("../../router.js").Query} query
 */
export function useTuning(app, dataset, active, query) {
  const [edits, setEdits] = useState(() => editsOf(active.config, query));
  const [showsMany, setShowsMany] = useState(false);
  const tried = useMemo(() => withEdits(active.config, edits), [active, edits]);
  useAddress(app, dataset, query, active, edits, setEdits);
  const asked = usePreviews(app, dataset, active, tried, showsMany || query.class ? MANY : FEW);

  const change = useCallback(
    (/** @type {Edits} */ some) => setEdits((held) => effectiveEdits(active.config, { ...held, ...some })),
    [active],
  );
  /** @param {import("../../router.js").Query} view */
  const look = (view) => app.router.replace(linkTo("thresholds", { dataset }, { ...viewOf(query), ...view, ...queryOf(edits) }));
  return { ...asked, active, edits, tried, change, setEdits, look, showsMany, showMany: () => setShowsMany(true) };
}

/** @typedef {ReturnType<typeof useTuning>} Tuning */

/**
 * The address follows the edits after a pause; an address from elsewhere is obeyed at once.
 * @param {import("../../app.js").App} app @param {string} dataset @param {import("../../router.js").Query} query
 * @param {ConfigVersion} active @param {Edits} edits @param {(edits: Edits) => void} setEdits
 */
function useAddress(app, dataset, query, active, edits, setEdits) {
  const here = textOf(configQuery(active.config, query));
  const wanted = textOf(queryOf(edits));
  const known = useRef(here);
  useEffect(() => {
    if (here !== known.current) setEdits(editsOf(active.config, query));
    known.current = here;
  }, [here]);
  useEffect(() => {
    if (wanted === here) return undefined;
    const timer = setTimeout(() => {
      known.current = wanted;
      app.router.replace(linkTo("thresholds", { dataset }, { ...viewOf(query), ...queryOf(edits) }));
    }, SETTLE_MS);
    return () => clearTimeout(timer);
  }, [wanted, here]);
}

/** @typedef {{config: import("../../types_jobs.js").ConfigBody, limit: number}} Question */

/**
 * Counts at once, the list of flips when nothing moves any more.
 * @param {import("../../app.js").App} app @param {string} dataset @param {ConfigVersion} active
 * @param {import("../../types_jobs.js").ConfigBody} tried @param {number} limit
 */
function usePreviews(app, dataset, active, tried, limit) {
  const [baseline, setBaseline] = useState(/** @type {Preview | null} */ (null));
  const [preview, setPreview] = useState(/** @type {Preview | null} */ (null));
  const [counted, setCounted] = useState(/** @type {import("../../types_jobs.js").ConfigBody | null} */ (null));
  const [listed, setListed] = useState(/** @type {Preview | null} */ (null));
  const [error, setError] = useState(/** @type {Error | null} */ (null));
  const [isBusy, setBusy] = useState(false);
  const [attempt, setAttempt] = useState(0);
  const ask = useMemo(
    () =>
      createLatest(
        (/** @type {Question} */ question, signal) => jobs.preview(dataset, question, signal),
        {
          onAnswer: (answer, { config, limit: most }) => {
            setPreview(answer);
            setCounted(config);
            setError(null);
            if (most > 0) setListed(answer);
          },
          onError: (failure) => {
            app.notice(failure);
            setError(failure instanceof Error ? failure : new Error(String(failure)));
          },
          onBusy: setBusy,
        },
      ),
    [dataset, active],
  );
  useEffect(() => () => ask.stop(), [ask]);
  useEffect(() => {
    const stop = new AbortController();
    jobs.preview(dataset, { config: active.config, limit: 0 }, stop.signal).then(
      (answer) => !stop.signal.aborted && setBaseline(answer),
      () => {},
    );
    return () => stop.abort();
  }, [ask, attempt]);
  // Before the frame is painted: the server can count meanwhile.
  useLayoutEffect(() => {
    ask.ask({ config: tried, limit: 0 });
    const timer = setTimeout(() => ask.ask({ config: tried, limit }), SETTLE_MS);
    return () => clearTimeout(timer);
  }, [ask, tried, limit]);
  const retry = () => {
    setAttempt((n) => n + 1);
    ask.ask({ config: tried, limit });
  };
  return { baseline, preview, counted, listed, error, isBusy, retry, isListed: listed !== null && listed.config === preview?.config };
}
