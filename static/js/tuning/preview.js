// @ts-check
// Previews of a configuration that is tried out: requested from the server one at a time; the address is updated to
// match.

import { FILTER_KEYS } from "../boxes/filters.js";
import { get, post } from "../core/api.js";
import { useActions, useLoaded } from "../core/hooks.js";
import { useCallback, useEffect, useLayoutEffect, useMemo, useRef, useState } from "../core/html.js";
import { linkTo } from "../core/router.js";
import { OWN_SHARE, THRESHOLD, configQuery, editsOf, effectiveEdits, queryOf, withEdits } from "./config.js";

/** @import { App } from "../core/app.js" */
/** @import { ConfigVersion, FilterConfigIn, Histogram, Preview, PreviewIn } from "../core/openapi.js" */
/** @import { Query } from "../core/router.js" */
/** @import { Edits } from "./config.js" */

/** How long nothing may change before boxes are listed and the address is updated. */
const SETTLE_MS = 220;
const FEW = 60;
const MANY = 1000;

/** Parts of the address that are about what is shown, not about the configuration. */
const VIEW_KEYS = ["class", "scale", "flips", "by", "truth", ...FILTER_KEYS];

/** A text that is equal for equal queries, whatever their order. @param {Record<string, string>} query */
const textOf = (query) => JSON.stringify(Object.entries(query).sort(([a], [b]) => (a < b ? -1 : 1)));

/** Changes of the same keys that follow each other faster are parts of one drag. */
const ONE_CHANGE_MS = 400;

/** @param {Query} query */
const viewOf = (query) => Object.fromEntries(VIEW_KEYS.flatMap((key) => (query[key] ? [[key, query[key]]] : [])));

/** @param {App} app @param {string} dataset @param {ConfigVersion} active @param {Query} query */
export function useTuning(app, dataset, active, query) {
  const [edits, setEdits] = useState(() => editsOf(active.config, query));
  const [showsMany, setShowsMany] = useState(false);
  const tried = useMemo(() => withEdits(active.config, edits), [active, edits]);
  useAddress(app, dataset, query, active, edits, setEdits);
  const truths = useTruths(dataset, active);
  const truth = truths.find((known) => known.truth === query.truth) ?? truths[0];
  const question = { config: tried, limit: showsMany || query.class ? MANY : FEW, truth: truth?.truth ?? null };
  const asked = usePreviews(dataset, active, question);

  /**
   * The edits before each change, the newest last; a drag is one change.
   * @type {{current: {before: Edits, keys: string, at: number}[]}}
   */
  const past = useRef([]);
  const change = useCallback(
    (/** @type {Edits} */ some) =>
      setEdits((held) => {
        const at = performance.now();
        const keys = Object.keys(some).join();
        const last = past.current.at(-1);
        if (last?.keys === keys && at - last.at < ONE_CHANGE_MS) last.at = at;
        else past.current.push({ before: held, keys, at });
        return effectiveEdits(active.config, { ...held, ...some });
      }),
    [active],
  );
  const actions = useMemo(() => ({ undo: () => setEdits((held) => past.current.pop()?.before ?? held) }), []);
  useActions(app, actions);
  /** @param {Query} view */
  const look = (view) =>
    app.router.replace(linkTo("thresholds", { dataset }, { ...viewOf(query), ...view, ...queryOf(edits) }));
  const share = shareOf(asked.preview?.histograms ? asked.preview : asked.baseline, query.by);
  const showMany = () => setShowsMany(true);
  return { ...asked, share, truths, truth, active, edits, tried, change, setEdits, look, showsMany, showMany };
}

/** With what verdicts can be compared, the strongest first. */
const TRUTHS = /** @type {const} */ (["instances", "people"]);

/**
 * How the filter agrees with each truth that is known of some boxes.
 * @param {string} dataset @param {ConfigVersion} active
 */
function useTruths(dataset, active) {
  const path = { dataset };
  const { value } = useLoaded(
    (signal) =>
      Promise.all(TRUTHS.map((truth) => get("/api/v1/datasets/{dataset}/quality", { path, query: { truth }, signal }))),
    [dataset, active],
  );
  return (value ?? []).filter(
    ({ confusion: c }) => c.kept_keep + c.kept_reject + c.rejected_keep + c.rejected_reject > 0,
  );
}

/**
 * The share of its pixels by which a box is decided, and how many boxes have which: of pixels whose tags fit, or of
 * its own pixels, where instances, depth or the order of boxes tell which are.
 * @param {Preview | null} preview @param {string} [by]  "tags" or "own", where boxes are decided by both
 */
function shareOf(preview, by) {
  const { histograms = null, own_histograms: own = null } = preview ?? {};
  const counts = { own: boxesIn(own), tags: boxesIn(histograms) };
  const isOwn = counts.own > 0 && (by !== "tags" || counts.tags === 0);
  return { isOwn, counts, key: isOwn ? OWN_SHARE : THRESHOLD, histograms: isOwn ? own : histograms };
}

/** @param {Histogram | null} histograms */
const boxesIn = (histograms) =>
  Object.values(histograms?.classes ?? {})
    .flat()
    .reduce((sum, count) => sum + count, 0);

/** @typedef {ReturnType<typeof useTuning>} Tuning */

/**
 * The address follows the edits after a pause; if the address is changed from outside, the edits follow it at once.
 * @param {App} app @param {string} dataset @param {Query} query
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

/** @typedef {Pick<PreviewIn, "config" | "limit" | "truth">} Question */

/** Half a percent each: the step of a threshold. */
const BINS = 200;

/** @param {string} dataset @param {Question} question @param {AbortSignal} signal */
const previewOf = (dataset, question, signal) =>
  post("/api/v1/datasets/{dataset}/preview", { path: { dataset }, body: { ...question, bins: BINS }, signal });

/**
 * Requests counts at once, and the list of flips when nothing has changed for a moment.
 * @param {string} dataset @param {ConfigVersion} active @param {Question} question
 */
function usePreviews(dataset, active, { config: tried, limit, truth }) {
  const baseline = useLoaded(
    (signal) => previewOf(dataset, { config: active.config, limit: 0 }, signal),
    [dataset, active],
  );
  const [preview, setPreview] = useState(/** @type {Preview | null} */ (null));
  const [counted, setCounted] = useState(/** @type {FilterConfigIn | null} */ (null));
  const [listed, setListed] = useState(/** @type {Preview | null} */ (null));
  const [error, setError] = useState(/** @type {Error | null} */ (null));
  const [isBusy, setBusy] = useState(false);
  const ask = useMemo(
    () =>
      createLatest((/** @type {Question} */ question, signal) => previewOf(dataset, question, signal), {
        onAnswer: (answer, { config, limit: most = 0 }) => {
          setPreview(answer);
          setCounted(config);
          setError(null);
          if (most > 0) setListed(answer);
        },
        onError: setError,
        onBusy: setBusy,
      }),
    [dataset, active],
  );
  useEffect(() => () => ask.stop(), [ask]);
  // Before the frame is painted: the server can count meanwhile.
  useLayoutEffect(() => {
    ask.ask({ config: tried, limit: 0, truth });
    const timer = setTimeout(() => ask.ask({ config: tried, limit, truth }), SETTLE_MS);
    return () => clearTimeout(timer);
  }, [ask, tried, limit, truth]);
  const retry = () => {
    baseline.reload();
    ask.ask({ config: tried, limit, truth });
  };
  return {
    baseline: baseline.value,
    preview,
    counted,
    listed,
    error: error ?? baseline.error,
    isBusy,
    retry,
    isListed: listed !== null && listed.config === preview?.config,
  };
}

/**
 * @template Q, A
 * @param {(question: Q, signal: AbortSignal) => Promise<A>} ask
 * @param {{onAnswer: (answer: A, question: Q) => void, onError: (error: Error) => void, onBusy?: (isBusy: boolean) =>
 *   void}} told
 */
export function createLatest(ask, { onAnswer, onError, onBusy = () => {} }) {
  const stop = new AbortController();
  /** @type {{question: Q} | null} */
  let waiting = null;
  let isBusy = false;

  const work = async () => {
    isBusy = true;
    onBusy(true);
    while (waiting && !stop.signal.aborted) {
      const { question } = waiting;
      waiting = null;
      await ask(question, stop.signal).then(
        (answer) => !stop.signal.aborted && onAnswer(answer, question),
        (error) => !stop.signal.aborted && onError(error),
      );
    }
    isBusy = false;
    if (!stop.signal.aborted) onBusy(false);
  };

  return {
    /** Ask next. An earlier question that has not been sent is dropped. @param {Q} question */
    ask(question) {
      waiting = { question };
      if (!isBusy) void work();
    },

    stop: () => stop.abort(),
  };
}
