// @ts-check
// The home of a dataset: what a ghost is, one frame before and after, and a report: how many, of what, how far, why,
// and what a person should look at.

import { NearPicture } from "../boxes/crops.js";
import { bandText } from "../boxes/filter_bar.js";
import { BINS } from "../boxes/filters.js";
import { VerdictBar } from "../boxes/signs.js";
import { EVIDENCE, evidenceText, reasonText } from "../boxes/wording.js";
import { get, pictureUrl, post } from "../core/api.js";
import { useDataset, useGrowth, useLazy, useLoaded, useTask, useTopBar, useValue } from "../core/hooks.js";
import { html, useEffect, useRef, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { agoText, capital, countOf, countText, percentText, sizeText } from "../core/numbers.js";
import { BAR, Failure, FailureLine, Notice, WideTable, isInClipboard, numeric, useCopy } from "../core/parts.js";
import { linkTo, loginLink } from "../core/router.js";
import { useMedia } from "../stage/media.js";

/** @typedef {import("../core/app.js").App & {boxes: Boxes}} App */
/** @import { Boxes } from "../boxes/store.js" */
/** @import { DistanceBand, FrameSummary as FrameItem, Measure, Stats } from "../core/openapi.js" */
/** @import { Route } from "../core/router.js" */

/** The words of the trade, explained where one points at them. */
const WORDS = {
  ghost:
    "A box of an object of which the camera sees nothing, or next to nothing: " +
    "behind a wall, behind a car, behind the camera.",
  segmentation: "An image in which the simulator says for every pixel what it shows: car, road, building.",
  evidence:
    "What tells whether an object is seen: its own pixels (instances), depth, the order of the boxes, " +
    "or the pixels of its class.",
  doubt: "The filter may be wrong about it, and an eye can decide.",
};

/** A word that explains itself. @param {{name: keyof typeof WORDS, children?: unknown}} props */
const Term = ({ name, children }) =>
  html`<abbr class="term" title=${WORDS[name]} tabindex="0" aria-description=${WORDS[name]}>${children}</abbr>`;

/** @param {{app: App, route: Route}} props */
export function HomeView({ app, route }) {
  const name = route.params.dataset ?? "";
  useTopBar(app, { title: name, dataset: name });
  const dataset = useDataset(name);
  useGrowth(dataset, dataset.value?.counts.frames ?? 0, dataset.value?.created_at);
  const path = { dataset: name };
  const frames = dataset.value?.counts.frames;
  // The report is asked for together with the dataset, and again when frames have come in since.
  const framesAtFirst = useRef(frames);
  framesAtFirst.current ??= frames;
  const loaded = useLoaded(
    (signal) =>
      Promise.all([
        get("/api/v1/datasets/{dataset}/stats", { path, signal }),
        get("/api/v1/datasets/{dataset}/report", { path, signal }),
      ]),
    [name, frames === framesAtFirst.current ? null : frames],
  );
  const [stats, report] = loaded.value ?? [null, null];
  const failed = dataset.state === "error" && !dataset.value;
  if (failed)
    return html`<main id="main" class="page" tabindex="-1">
      <${Failure} error=${dataset.error} onRetry=${dataset.reload} />
    </main>`;
  const worst = report?.worst_frames.filter(({ has_image }) => has_image) ?? [];
  // One that has much to show on both sides of the line.
  const [best] = [...worst].sort(({ counts: a }, { counts: b }) => b.kept * b.rejected - a.kept * a.rejected);
  // While frames come in, the picture that somebody looks at stays.
  const first = useRef(best);
  first.current ??= best;
  const shown = first.current;
  const counts = dataset.value?.counts;
  return html`<main id="main" class="page home" tabindex="-1" aria-busy=${!stats}>
    <div class="page__head">
      <h1>${name}</h1>
      ${
        counts &&
        html`<span class="faint">${countOf(counts.frames, "frame")} · ${countOf(counts.boxes, "box", "boxes")}</span>`
      }
      <button class="button home__print" onClick=${() => print()}>Print</button>
    </div>
    ${loaded.error && html`<${FailureLine} error=${loaded.error} onRetry=${loaded.reload} />`}
    ${
      counts &&
      html`<section class="home__start">
        <div class="home__words">
          <p>The simulator gives a box for every object, also for those that the camera cannot see:
            ${" "}<${Term} name="ghost">ghosts<//>. Unghost compares each box with
            the ${" "}<${Term} name="segmentation">images<//> of its frame, keeps what is seen and rejects the rest,
            and says why. You look at the boxes that are ${" "}<${Term} name="doubt">in doubt<//>, one at a time;
            every answer is saved at once and can be undone.</p>
          ${
            counts.boxes > 0 &&
            html`<div class="home__buttons">
              <a class="button button--primary button--large" href=${linkTo("queue", path)}>
                Start review${counts.to_review > 0 && html` <span class="num">${countText(counts.to_review)}</span>`}
              </a>
              <a class="button button--large" href=${linkTo("frames", path)}>Look at the frames</a>
            </div>`
          }
        </div>
        ${
          counts.boxes === 0 &&
          html`<${Notice} title="No boxes yet">
            <p>Frames, boxes and ghosts are shown here as soon as they come in.</p>
          <//>`
        }
        ${shown && html`<${BeforeAfter} key=${shown.id} app=${app} id=${shown.id} />`}
      </section>`
    }
    ${
      stats &&
      stats.boxes > 0 &&
      html`<div class="home__report">
        <${ByClass} dataset=${name} stats=${stats} />
        <${ByDistance} dataset=${name} bands=${report?.by_distance ?? []} />
        <${ByPlace} dataset=${name} what="map" places=${report?.by_map ?? []} />
        <${ByPlace} dataset=${name} what="weather" places=${report?.by_weather ?? []} />
        <${ByCause} dataset=${name} stats=${stats} />
        <${ForPeople} dataset=${name} stats=${stats} evidence=${dataset.value?.evidence ?? ""} />
        <${Evidence} dataset=${name} frames=${stats.frames} />
        <${Exports} dataset=${name} />
      </div>
      ${
        worst.length > 0 &&
        html`<section class="panelbox" aria-labelledby="worst-title">
          <header class="panelbox__head"><h2 id="worst-title">Frames with the most ghosts</h2></header>
          <ul class="thumbs">${worst.map((frame) => html`<li key=${frame.id}><${Worst} frame=${frame} /></li>`)}</ul>
        </section>`
      }`
    }
  </main>`;
}

/**
 * A frame before and after the filter: all boxes left of the line, the kept ones right of it.
 * @param {{app: App, id: number}} props
 */
function BeforeAfter({ app, id }) {
  const media = useMedia(app.boxes).of(id);
  const { value: frame, error, retry } = useLazy(media.frame);
  const { value: picture } = useLazy(media.picture);
  const canvas = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  const [at, setAt] = useState(50);
  const width = frame?.width ?? 16;
  const height = frame?.height ?? 9;
  useEffect(() => {
    if (!canvas.current || !picture) return;
    canvas.current.width = width;
    canvas.current.height = height;
    canvas.current.getContext("2d")?.drawImage(picture, 0, 0, width, height);
  }, [picture, width, height]);
  if (error) return html`<${FailureLine} error=${error} onRetry=${retry} />`;
  const boxes = (frame ? app.boxes.all(frame.boxIds) : []).filter(({ xyxy }) => xyxy);
  const kept = boxes.filter(({ effective_verdict: verdict }) => verdict === "kept");
  /** @param {typeof boxes} some @param {string} verdict */
  const drawn = (some, verdict) =>
    some.map(({ box_id, xyxy }) => {
      const [x0 = 0, y0 = 0, x1 = 0, y1 = 0] = xyxy ?? [];
      const place = { x: x0, y: y0, width: x1 - x0, height: y1 - y0 };
      return html`<rect key=${box_id} class="compare__box compare__box--${verdict}" ...${place} />`;
    });
  const line = (at * width) / 100;
  return html`<figure class="compare" style=${{ aspectRatio: `${width} / ${height}`, "--ratio": width / height }}>
    <canvas ref=${canvas} role="img" aria-label=${frame ? `Frame ${frame.key}` : "Loading a frame"}></canvas>
    <svg viewBox=${`0 0 ${width} ${height}`} aria-hidden="true">
      <clipPath id="compare-before"><rect x="0" y="0" width=${line} height=${height} /></clipPath>
      <clipPath id="compare-after"><rect x=${line} y="0" width=${width - line} height=${height} /></clipPath>
      <g clip-path="url(#compare-before)">${drawn(boxes, "raw")}</g>
      <g clip-path="url(#compare-after)">${drawn(kept, "kept")}</g>
      <line class="compare__line" x1=${line} x2=${line} y1="0" y2=${height} />
    </svg>
    <span class="compare__grip" style=${{ left: `${at}%` }} aria-hidden="true"><${Icon} name="slide" /></span>
    <input class="compare__range" type="range" min="0" max="100" value=${at}
      aria-label="Before the filter on the left, after it on the right"
      onInput=${(/** @type {{currentTarget: HTMLInputElement}} */ event) => setAt(Number(event.currentTarget.value))} />
    <figcaption><span>Before: ${countOf(boxes.length, "box", "boxes")}</span>
      <span>After: ${countText(kept.length)}</span></figcaption>
  </figure>`;
}

/**
 * A frame before and after, as a page of its own: a link to it is for everybody who may read.
 * @param {{app: App, route: Route}} props
 */
export function CompareView({ app, route }) {
  const id = Number(route.params.id);
  const {
    value: loaded,
    error,
    reload,
  } = useLoaded((signal) => get("/api/v1/frames/{frame_id}", { path: { frame_id: id }, signal }), [id]);
  const frame = loaded?.id === id ? loaded : null;
  const { dataset = "", key = "" } = frame ?? loaded ?? {};
  const link = useCopy(location.href);
  useTopBar(app, {
    title: key ? `${key} · before and after` : "Before and after",
    dataset,
    crumbs: [
      { text: "Datasets", href: linkTo("datasets") },
      ...(dataset ? [{ text: dataset, href: linkTo("frames", { dataset }) }, { text: key }] : []),
    ],
  });
  if (error)
    return html`<main id="main" class="page" tabindex="-1"><${Failure} error=${error} onRetry=${reload} /></main>`;
  return html`<main id="main" class="page" tabindex="-1" aria-busy=${!frame}>
    <div class="page__head">
      <h1>${key || "Before and after"}</h1>
      <div class="compare__buttons">
        <${Neighbour} id=${frame?.previous_id ?? null} icon="left" text="Previous frame" />
        <${Neighbour} id=${frame?.next_id ?? null} icon="right" text="Next frame" />
        <button class="button" onClick=${link.copy}>
          <${Icon} name=${link.isCopied ? "check" : "copy"} />${link.isCopied ? "Copied" : "Copy link"}
        </button>
        <${GuestLink} app=${app} view=${linkTo("compare", { id })} />
        <a class="button" href=${linkTo("frame", { id })}>All about this frame</a>
      </div>
    </div>
    ${
      frame?.has_image === false
        ? html`<${Notice}
          title="This frame has no image"><p>There is no picture on which its boxes could be compared.</p><//>`
        : html`<div class="compare__page"><${BeforeAfter} key=${id} app=${app} id=${id} /></div>`
    }
  </main>`;
}

const GUEST_DAYS = 7;

/**
 * A button for admins: a login link of a new viewer, which leads to a view.
 * @param {{app: App, view: string}} props
 */
function GuestLink({ app, view }) {
  const person = useValue(app.person);
  const { run, isBusy } = useTask(async () => {
    const name = `guest-${Math.random().toString(36).slice(2, 8)}`;
    const body = /** @type {const} */ ({ name, role: "viewer", expires_in_days: GUEST_DAYS });
    const { token } = await post("/api/v1/tokens", { body });
    const { code } = await post("/api/v1/login-codes", { session: token });
    const link = loginLink(code, view);
    const isCopied = await isInClipboard(link);
    app.toasts.show(
      `${isCopied ? "Link copied" : link}. It works once, within ten minutes; ${name} can look around for a week.`,
    );
  }, app.toasts.fail);
  if (person?.role !== "admin") return null;
  return html`<button class="button" disabled=${isBusy} onClick=${() => run()}
    title="A link that signs a guest in, who can look but not answer">Link for a guest</button>`;
}

/** @param {{id: number | null, icon: string, text: string}} props */
function Neighbour({ id, icon, text }) {
  if (id === null) return null;
  return html`<a class="button button--icon" href=${linkTo("compare", { id })} aria-label=${text} title=${text}>
    <${Icon} name=${icon} />
  </a>`;
}

/** @typedef {{kept: number, rejected: number, unmeasured: number}} Counts */

/**
 * Rows of kept and rejected boxes.
 * @param {{title: string, head: string, rows: readonly {name: unknown, counts: Counts}[]}} props
 */
function Table({ title, head, rows }) {
  return html`<section class="panelbox" aria-label=${title}>
    <header class="panelbox__head"><h2>${title}</h2></header>
    <${WideTable} label=${title} heads=${[head, numeric("Boxes"), numeric("Ghosts"), BAR]}>
      ${rows.map(({ name, counts }) => {
        const boxes = counts.kept + counts.rejected + counts.unmeasured;
        const drawn = { ...counts, boxes, reviewed: 0, to_review: 0 };
        return html`<tr>
            <th scope="row">${name}</th>
            <td class="is-num num">${countText(boxes)}</td>
            <td class="is-num num">${countText(counts.rejected)}</td>
            <td class="table__bar" aria-hidden="true"><${VerdictBar} counts=${drawn} /></td>
          </tr>`;
      })}<//>
  </section>`;
}

/** @param {{dataset: string, stats: Stats}} props */
function ByClass({ dataset, stats }) {
  const rows = Object.entries(stats.by_class).sort(([, a], [, b]) => b.rejected - a.rejected);
  const linked = rows.map(([name, counts]) => ({
    counts,
    name: html`<a href=${linkTo("grid", { dataset }, { class: name, verdict: "rejected" })}>${name}</a>`,
  }));
  return html`<${Table} title="By class" head="Class" rows=${linked} />`;
}

/** @param {{dataset: string, bands: readonly import("../core/openapi.js").DistanceBand[]}} props */
function ByDistance({ dataset, bands }) {
  if (bands.length === 0) return null;
  /** @param {DistanceBand} band */
  const name = ({ distance_from: from, distance_to: to }) => {
    if (from === null) return "not known";
    const query = { verdict: "rejected", distance_min: `${from}`, distance_max: to === null ? "" : `${to}` };
    return html`<a href=${linkTo("grid", { dataset }, query)}>${bandText(from, to)}</a>`;
  };
  const rows = bands.map((band) => ({ name: name(band), counts: band }));
  return html`<${Table} title="By distance" head="Distance" rows=${rows} />`;
}

/**
 * Nothing where no frame names a map or a weather.
 * @param {{dataset: string, what: "map" | "weather", places: readonly import("../core/openapi.js").PlaceCounts[]}}
 *   props
 */
function ByPlace({ dataset, what, places }) {
  if (places.length === 0) return null;
  /** @param {string | null} name */
  const link = (name) =>
    name === null
      ? "not known"
      : html`<a href=${linkTo("grid", { dataset }, { [what]: name, verdict: "rejected" })}>${name}</a>`;
  const rows = places.map((counts) => ({ name: link(counts.name), counts }));
  return html`<${Table} title=${`By ${what}`} head=${capital(what)} rows=${rows} />`;
}

/** @param {{dataset: string, stats: Stats}} props */
function ByCause({ dataset, stats }) {
  const rows = Object.entries(stats.by_reason)
    .filter(([reason]) => reason !== "visible")
    .sort(([, a], [, b]) => b - a);
  return html`<section class="panelbox" aria-labelledby="cause-title">
    <header class="panelbox__head"><h2 id="cause-title">By cause</h2></header>
    <${WideTable} label="By cause" heads=${["Why not kept", numeric("Boxes")]}>
      ${rows.map(
        ([reason, boxes]) => html`<tr key=${reason}>
          <th scope="row"><a href=${linkTo("grid", { dataset }, { reason })}>${reasonText(reason)}</a></th>
          <td class="is-num num">${countText(boxes)}</td>
        </tr>`,
      )}<//>
  </section>`;
}

/**
 * How right each kind of evidence is, where instance images tell the truth.
 * @param {{dataset: string, frames: number}} props
 */
function Evidence({ dataset, frames }) {
  const path = { dataset };
  const { value } = useLoaded(
    (signal) => get("/api/v1/datasets/{dataset}/evaluations", { path, query: { truth: "instances" }, signal }),
    [dataset, frames],
  );
  const measured = Object.entries(value?.channels ?? {});
  if (measured.length === 0) return null;
  return html`<section class="panelbox" aria-labelledby="evidence-title">
    <header class="panelbox__head"><h2 id="evidence-title">Evidence</h2></header>
    <${WideTable} label="Evidence" heads=${["Right by the instances", numeric("Precision"), numeric("Recall")]}>
      ${measured.map(
        ([name, score]) => html`<tr key=${name}>
          <th scope="row">${evidenceText(name)}</th>
          <td class="is-num num">${percentText(shareOf(score.precision))}</td>
          <td class="is-num num">${percentText(shareOf(score.recall))}</td>
        </tr>`,
      )}<//>
    <p class="home__buttons"><a class="button" href=${linkTo("quality", path)}>Quality</a></p>
  </section>`;
}

/** In percent. @param {Measure | null} measure */
const shareOf = (measure) => (measure ? 100 * measure.value : null);

const NEWEST_EXPORTS = 5;

/** @param {{dataset: string}} props */
function Exports({ dataset }) {
  const path = { dataset };
  const { value } = useLoaded(
    (signal) => get("/api/v1/datasets/{dataset}/exports", { path, query: { limit: NEWEST_EXPORTS }, signal }),
    [dataset],
  );
  const items = value?.items ?? [];
  return html`<section class="panelbox" aria-labelledby="exports-title">
    <header class="panelbox__head"><h2 id="exports-title">Exports</h2></header>
    <dl class="facts">${items.map(
      ({ id, name, format, state, created_at, size_bytes: size }) => html`<div key=${id}>
        <dt>${name ? `${name}, ${format}` : format}</dt>
        <dd>${state === "done" && size ? sizeText(size) : state} <span class="faint">${agoText(created_at)}</span></dd>
      </div>`,
    )}</dl>
    ${value && items.length === 0 && html`<p class="faint">No labels have been exported yet.</p>`}
    <p class="home__buttons"><a class="button" href=${linkTo("runs", path)}>Exports and runs</a></p>
  </section>`;
}

/** @param {{dataset: string, stats: Stats, evidence: string}} props */
function ForPeople({ dataset, stats, evidence }) {
  return html`<section class="panelbox" aria-labelledby="people-title">
    <header class="panelbox__head"><h2 id="people-title">What needs a person</h2></header>
    <dl class="facts">
      ${BINS.map(
        ({ value, text }) => html`<div key=${value}>
          <dt><a href=${linkTo("grid", { dataset }, { bin: value })}>${text}</a></dt>
          <dd class="num">${countText(stats.bins?.[value] ?? 0)}</dd>
        </div>`,
      )}
      <div><dt>Answered</dt><dd class="num">${countText(stats.reviewed)}</dd></div>
      <div><dt>The filter and a person disagree</dt><dd class="num">${countText(stats.conflicts)}</dd></div>
      <div><dt><${Term} name="evidence">Evidence<//></dt><dd>${EVIDENCE[evidence]?.text ?? evidence}</dd></div>
    </dl>
    <p class="faint">As a file: <code>unghost report ${dataset} -o report.html</code></p>
  </section>`;
}

/** @param {{frame: FrameItem}} props */
function Worst({ frame: { id, key, counts } }) {
  const url = pictureUrl("/api/v1/frames/{frame_id}/thumbnail", { path: { frame_id: id } });
  return html`<a class="thumb" href=${linkTo("compare", { id })} title=${key}>
    <div class="thumb__picture"><${NearPicture} url=${url} /></div>
    <div class="thumb__text">
      <span class="thumb__key">${key}</span><span class="faint num">${countOf(counts.rejected, "ghost")}</span>
    </div>
    <${VerdictBar} counts=${counts} />
  </a>`;
}
