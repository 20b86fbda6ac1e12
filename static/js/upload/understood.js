// @ts-check
// How dropped files are understood, part by part, with a control for each thing that a person may correct.

import { StrokeSwatch, VerdictBar } from "../boxes/signs.js";
import { Control } from "../core/form.js";
import { html, useEffect, useRef, useState } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf, countText, percentText } from "../core/numbers.js";
import { MiddleCut, Segments } from "../core/parts.js";
import { NOTATIONS, ROLES, columnsOf, correctionOf, likelyFields, tableWith } from "./corrections.js";

/** @typedef {import("./corrections.js").Correction} Correction */
/** @typedef {import("./folder.js").Entry} Entry */
/** @typedef {import("./folder.js").Plan} Plan */
/** @typedef {import("../core/openapi.js").FolderStream} Stream */
/** @typedef {import("../core/openapi.js").FolderClass} ClassFacts */
/** @typedef {import("../core/openapi.js").FolderRemark} Remark */
/** @typedef {import("../core/openapi.js").PaintedFrame} Painted */
/** @typedef {import("../core/form.js").Field} Field */
/** @typedef {(...next: Correction[]) => void} Correct */
/** @typedef {{currentTarget: HTMLSelectElement}} Chosen */

/**
 * What is corrected so far, each with an undo.
 * @param {{corrections: readonly Correction[], undo: (correction: Correction) => void}} props
 */
export function Corrections({ corrections, undo }) {
  if (corrections.length === 0) return null;
  return html`<section class="corrections" aria-label="Your corrections">
    <span class="faint">Your corrections</span>
    <ul>${corrections.map(
      (correction) => html`<li key=${correction.place.join("\n")} class="chip">${correction.text}
        <button type="button" class="chip__undo" aria-label=${`Undo: ${correction.text}`} title="Undo"
          onClick=${() => undo(correction)}><${Icon} name="cross" /></button></li>`,
    )}</ul>
  </section>`;
}

/** @param {{plan: Plan, correct: Correct}} props */
function LayoutSegments({ plan: { layout, layouts, titles }, correct }) {
  const choices = layouts.map((value) => ({ value, text: titles[value] ?? value }));
  return html`<${Segments} label="Layout" value=${layout ?? ""} choices=${choices}
    onChange=${(/** @type {string} */ value) => correct(layoutAs(value, titles))} />`;
}

/** Whether a remark asks for the layout, of which it names the one that was taken. @param {Remark} remark */
const asksForLayout = ({ remedies }) => remedies.some(({ place }) => place[0] === "layout");

/**
 * The layout, if the files may have several, and no remark asks for it.
 * @param {{plan: Plan, correct: Correct}} props
 */
export function LayoutChoice({ plan, correct }) {
  if (plan.layouts.length < 2 || plan.inspection.remarks.some(asksForLayout)) return null;
  return html`<${LayoutSegments} plan=${plan} correct=${correct} />`;
}

/** @param {string} layout @param {Readonly<Record<string, string>>} titles @returns {Correction} */
export const layoutAs = (layout, titles) => ({
  place: ["layout"],
  value: layout,
  text: `Layout: ${titles[layout] ?? layout}`,
});

/** @typedef {{remarks: readonly Remark[], plan: Plan, top: string, correct: Correct}} RemarksProps */

/** What must be looked at, each with what can be done about it. @param {RemarksProps} props */
export function Remarks({ remarks, plan, top, correct }) {
  const serious = remarks.filter(({ is_serious: isSerious }) => isSerious);
  if (serious.length === 0) return null;
  return html`<ul class="remarks" aria-label="What to look at">
    ${serious.map(
      (remark) => html`<li key=${remark.text} class="remark">
        <${Icon} name="warn" /><${Sentence} remark=${remark} plan=${plan} top=${top} correct=${correct} />
      </li>`,
    )}
  </ul>`;
}

/** Other sentences. @param {RemarksProps} props */
export function Notes({ remarks, plan, top, correct }) {
  const notes = remarks.filter(({ is_serious: isSerious }) => !isSerious);
  if (notes.length === 0) return null;
  return html`<section aria-labelledby="notes-title">
    <header class="part__head"><h3 id="notes-title">Notes</h3></header>
    <ul class="notes">${notes.map(
      (remark) => html`<li key=${remark.text}>
        <${Sentence} remark=${remark} plan=${plan} top=${top} correct=${correct} />
      </li>`,
    )}</ul>
  </section>`;
}

/**
 * A remark, with a control for each remedy.
 * @param {{remark: Remark, plan: Plan, top: string, correct: Correct}} props
 */
function Sentence({ remark, plan, top, correct }) {
  const { text, finding, remedies, unknown_classes: unknown } = remark;
  const { streams } = plan.inspection;
  const isLayout = plan.layouts.length > 1 && asksForLayout(remark);
  const offered = remedies.filter(({ place }) => place[0] !== "layout");
  const auxiliary = streams.filter(({ pattern, role }) => pattern && role in ROLES && role !== "image");
  const apart = auxiliary.find(({ example }) => plan.layout === "pairs" && text.includes(withoutTop(example, top)));
  const hasControl = isLayout || offered.length + unknown.length > 0;
  return html`<p><${Coded} text=${sentence(hasControl ? finding : text)} /></p>
  ${
    (hasControl || apart) &&
    html`<span class="remark__do">
      ${isLayout && html`<${LayoutSegments} plan=${plan} correct=${correct} />`}
      ${offered.map(
        (remedy) => html`
          <${SmallButton} text=${remedyText(remedy)} onClick=${() => correct(remedyAs(remedy))} />`,
      )}
      ${unknown.slice(0, MOST_OFFERED).map(
        (name) => html`
          <${SmallButton} text=${`Choose for ${name}`} onClick=${() => focusOn(name)} />`,
      )}
      ${
        apart &&
        html`<${SmallButton} text="Match them by name"
          onClick=${() => correct(roleAs(apart, apart.role))} />`
      }
    </span>`
  }`;
}

const MOST_OFFERED = 4;

const TABLE = /\.(csv|tsv)$/i;
const HEADER_BYTES = 4096;

/** @type {Readonly<Record<string, string>>} */
const FIELDS = {
  x1: "Left",
  y1: "Top",
  x2: "Right",
  y2: "Bottom",
  cx: "Centre x",
  cy: "Centre y",
  width: "Width",
  height: "Height",
  class: "Class",
  frame: "Image",
};

/**
 * Which columns of a table hold what, where no reader knows their names.
 * @param {{plan: Plan, entries: readonly Entry[], top: string, corrections: readonly Correction[], correct: Correct}}
 *   props
 */
export function Columns({ plan, entries, top, corrections, correct }) {
  const path = plan.unmatched.find((file) => TABLE.test(file.path))?.path;
  const entry = entries.find((one) => path && withoutTop(one.path, top) === path);
  const [columns, setColumns] = useState(/** @type {readonly string[]} */ ([]));
  const [notation, setNotation] = useState("xyxy");
  const [chosen, setChosen] = useState(/** @type {Record<string, string>} */ ({}));
  useEffect(() => {
    const show = (/** @type {readonly string[]} */ names) => (setColumns(names), setChosen(likelyFields(names)));
    if (entry)
      entry
        .open()
        .then((blob) => blob.slice(0, HEADER_BYTES).text())
        .then(columnsOf)
        .then(show, () => show([]));
    else setColumns([]);
  }, [entry]);
  if (columns.length === 0 || correctionOf(corrections, ["layout"]) === "table") return null;
  const needed = NOTATIONS.find(({ value }) => value === notation)?.fields ?? [];
  const asked = [...needed, ...["class", "frame"]];
  const said = Object.fromEntries(asked.flatMap((field) => (chosen[field] ? [[field, chosen[field] ?? ""]] : [])));
  return html`<section aria-labelledby="columns-title" class="columns">
    <header class="part__head">
      <h3 id="columns-title">Boxes in ${path}?</h3><span class="faint">what its columns hold</span>
    </header>
    <${Segments} label="A box is" value=${notation} choices=${NOTATIONS} onChange=${setNotation} />
    <div class="columns__fields">${asked.map(
      (field) => html`<label key=${field} class="field">
        <span>${FIELDS[field]}</span>
        <span class="select"><select value=${chosen[field] ?? ""}
            onChange=${(/** @type {Chosen} */ { currentTarget: { value } }) =>
              setChosen({ ...chosen, [field]: value })}>
            <option value="">${needed.includes(field) ? "choose a column" : "none"}</option>
            ${columns.map((name) => html`<option value=${name}>${name}</option>`)}
          </select></span>
      </label>`,
    )}
      <button type="button" class="button button--small" disabled=${!needed.every((field) => said[field])}
        onClick=${() => correct(...tableWith(said))}>Read its boxes</button></div>
  </section>`;
}

/** @param {{text: string, onClick: () => void}} props */
const SmallButton = ({ text, onClick }) =>
  html`<button type="button" class="button button--small" onClick=${onClick}>${text}</button>`;

/** @type {Readonly<Record<string, string>>} */
const REMEDIES = { unit: "Read as", corners: "Read as", origin: "Count pixels from", lossy: "Match colours to the" };

/** @param {Remark["remedies"][number]} remedy */
const remedyText = ({ place: [section = "", key = ""], value }) =>
  `${REMEDIES[key] ?? `${(key || section).replaceAll("_", " ")}:`} ${value}`;

/** @param {Remark["remedies"][number]} remedy @returns {Correction} */
function remedyAs({ place, value }) {
  const [section = "", key = ""] = place;
  return { place, value, text: `${capitalized(section)}: ${key.replaceAll("_", " ")} ${value}` };
}

/** @param {string} word */
const capitalized = (word) => `${word[0]?.toUpperCase()}${word.slice(1)}`;

/** Text with its parts in backticks as code. @param {{text: string}} props */
const Coded = ({ text }) => text.split("`").map((part, at) => (at % 2 === 1 ? html`<code>${part}</code>` : part));

/** A name at the beginning stays as it is. @param {string} text */
const sentence = (text) =>
  `${text.replace(/^[a-z](?=[a-z]* )/, (letter) => letter.toUpperCase())}${/[.!?]$/.test(text) ? "" : "."}`;

const VERDICTS = /** @type {const} */ (["kept", "rejected", "unmeasured"]);

/** @param {{frames: readonly Painted[]}} props */
export function PaintedFrames({ frames }) {
  if (frames.length === 0) return null;
  const all = frames.flatMap(({ boxes }) => boxes);
  const verdicts = VERDICTS.filter((verdict) => all.some((box) => box.verdict === verdict));
  return html`<section aria-labelledby="painted-title">
    <header class="part__head">
      <h3 id="painted-title">
        ${frames.length === 1 ? "A frame" : `${countText(frames.length)} of the frames`}
        ${verdicts.length > 0 ? ", as the filter decides" : ""}
      </h3>
      <span class="legend">${verdicts.map(
        (verdict) => html`<span key=${verdict}><${StrokeSwatch} verdict=${verdict} />${verdict}</span>`,
      )}</span>
    </header>
    <div class="painted">${frames.map((frame) => html`<${PaintedFrame} key=${frame.key} frame=${frame} />`)}</div>
  </section>`;
}

/** @param {Painted["boxes"][number]} box */
const areaOf = ({ xyxy: [x0, y0, x1, y1] }) => (x1 - x0) * (y1 - y0);

/** @type {Readonly<Record<string, number>>} */
const STEPS = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1, Home: -Infinity, End: Infinity };

/** With more boxes than this, their lines are thin. */
const CROWD = 40;

/**
 * A frame with its boxes; the one under the pointer, or with the focus, is explained.
 * @param {{frame: Painted}} props
 */
function PaintedFrame({ frame: { key, width, height, jpeg, boxes } }) {
  const drawing = useRef(/** @type {SVGSVGElement | null} */ (null));
  /** The box that Tab leads to. */
  const [current, setCurrent] = useState(0);
  const [shown, setShown] = useState(/** @type {number | null} */ (null));
  // The smaller ones are drawn last, where the pointer reaches them.
  const ordered = [...boxes].sort((a, b) => areaOf(b) - areaOf(a));
  const box = shown === null ? null : ordered[shown];
  /** @param {KeyboardEvent} event */
  const onKeyDown = (event) => {
    const step = STEPS[event.key];
    if (step === undefined) return;
    event.preventDefault();
    const next = Math.min(Math.max(current + step, 0), ordered.length - 1);
    setCurrent(next);
    drawing.current?.querySelectorAll("g")[next]?.focus();
  };
  return html`<figure class="paintedframe ${boxes.length > CROWD ? "is-crowded" : ""}">
    <div class="paintedframe__picture" style=${{ aspectRatio: `${width} / ${height}` }}>
      ${jpeg && html`<img src=${`data:image/jpeg;base64,${jpeg}`} alt="" />`}
      <svg ref=${drawing} viewBox=${`0 0 ${width} ${height}`} role="group"
        aria-label=${`${countOf(boxes.length, "box", "boxes")} of ${key}`}
        onKeyDown=${onKeyDown} onMouseLeave=${() => setShown(null)}>
        ${ordered.map(
          ({ verdict, class_name: name, explanation, xyxy }, at) => html`<g key=${at} role="img"
            class="pbox pbox--${verdict} ${at === shown ? "is-shown" : ""}"
            tabindex=${at === Math.min(current, ordered.length - 1) ? 0 : -1} aria-label=${`${name}, ${explanation}`}
            onMouseEnter=${() => setShown(at)} onFocus=${() => (setCurrent(at), setShown(at))}
            onBlur=${() => setShown(null)}>
            <${Rectangle} kind="pbox__casing" xyxy=${xyxy} /><${Rectangle} kind="pbox__line" xyxy=${xyxy} />
          </g>`,
        )}
      </svg>
    </div>
    <figcaption>${
      box
        ? html`<${StrokeSwatch} verdict=${box.verdict} /><span><b>${box.class_name}</b> ${box.explanation}</span>`
        : html`<span class="faint"><${MiddleCut} text=${key} />
          ${verdictsText(verdictCounts(boxes)) || "no boxes"}</span>`
    }</figcaption>
  </figure>`;
}

/** @param {{kind: string, xyxy: Painted["boxes"][number]["xyxy"]}} props */
const Rectangle = ({ kind, xyxy: [x0, y0, x1, y1] }) =>
  html`<rect class=${kind} x=${x0} y=${y0} width=${Math.max(0, x1 - x0)} height=${Math.max(0, y1 - y0)} />`;

/** @typedef {Readonly<Record<(typeof VERDICTS)[number], number>>} VerdictCounts */

/** @param {Painted["boxes"]} boxes @returns {VerdictCounts} */
function verdictCounts(boxes) {
  const counts = { kept: 0, rejected: 0, unmeasured: 0 };
  for (const { verdict } of boxes) counts[verdict] += 1;
  return counts;
}

/** "2 kept · 1 rejected"; empty without any. @param {VerdictCounts} counts */
const verdictsText = (counts) =>
  VERDICTS.flatMap((verdict) => (counts[verdict] > 0 ? `${countText(counts[verdict])} ${verdict}` : [])).join(" · ");

/** What a class measures as where it is passed on unmeasured. */
const PASS = "pass";
const MOST_CLASSES = 20;

/** @param {string} name */
const idOfClass = (name) => `class-${encodeURIComponent(name)}`;

/** Go to the choice of what a class is measured as. @param {string} name */
const focusOn = (name) => document.getElementById(idOfClass(name))?.focus();

/**
 * @param {{classes: readonly ClassFacts[], lookedAt: number, choices: readonly string[], correct: Correct}} props
 *   `choices`: what a class may measure as
 */
export function Classes({ classes, lookedAt, choices, correct }) {
  const [isAll, setAll] = useState(false);
  if (classes.length === 0) return null;
  const ordered = [...classes].sort((a, b) => Number(isUnknown(b)) - Number(isUnknown(a)));
  const listed = isAll ? ordered : ordered.slice(0, MOST_CLASSES);
  const rest = classes.length - listed.length;
  const isMeasured = classes.some(({ kept, rejected, unmeasured }) => kept + rejected + unmeasured > 0);
  return html`<section aria-labelledby="classes-title">
    <header class="part__head">
      <h3 id="classes-title">Classes</h3>
      ${isMeasured && html`<span class="faint">verdicts in ${countOf(lookedAt, "frame")} that were looked at</span>`}
    </header>
    <table class="table classes" role="table">
      <thead role="rowgroup"><tr role="row">
          <th role="columnheader" scope="col">Class</th>
          <th role="columnheader" scope="col" class="is-num">Boxes</th>
          <th role="columnheader" scope="col">Measured as</th>
          <th role="columnheader" scope="col">Tags that count</th>
          <th role="columnheader" scope="col">Verdicts</th>
          <th role="columnheader" scope="col" class="is-num">Unknown pixels</th>
        </tr></thead>
      <tbody role="rowgroup">${listed.map(
        (facts) => html`<${ClassRow} key=${facts.name} facts=${facts} choices=${choices} correct=${correct} />`,
      )}</tbody>
    </table>
    ${rest > 0 && html`<${SmallButton} text=${`Show ${countText(rest)} more classes`} onClick=${() => setAll(true)} />`}
  </section>`;
}

/** @param {ClassFacts} facts */
const isUnknown = ({ measured_as: measuredAs, boxes }) => measuredAs === null && boxes > 0;

/** @param {{facts: ClassFacts, choices: readonly string[], correct: Correct}} props */
function ClassRow({ facts, choices, correct }) {
  const { name, boxes, measured_as: measuredAs, nearest, tags, kept, rejected, unmeasured } = facts;
  const { unknown_percent: unknownPercent } = facts;
  const shade = !unknownPercent ? "faint is-none" : unknownPercent > 1 ? "warn" : "faint";
  const all = kept + rejected + unmeasured;
  const counts = { kept, rejected, unmeasured };
  /** @param {string} value */
  const measure = (value) => {
    const how = value === PASS ? "left unmeasured" : `measured as ${value}`;
    correct({ place: ["classes", name], value, text: `Classes: ${name} ${how}` });
  };
  const options = choices.includes(measuredAs ?? "") || measuredAs === null ? choices : [measuredAs, ...choices];
  /** @param {Chosen} event */
  const onChange = ({ currentTarget: { value } }) => value && measure(value);
  return html`<tr role="row" class=${isUnknown(facts) ? "is-unknown" : ""}>
    <th role="rowheader" scope="row">${name}</th>
    <td role="cell" class="is-num num classes__boxes">
      ${countText(boxes)}<span class="only-narrow"> ${boxes === 1 ? "box" : "boxes"}</span>
    </td>
    <td role="cell" class="classes__as">
      <span class="select ${isUnknown(facts) ? "is-wrong" : ""}"><select id=${idOfClass(name)}
          aria-label=${`Measure ${name} as`} value=${measuredAs ?? ""} onChange=${onChange}>
          ${measuredAs === null && html`<option value="">not known</option>`}
          ${options.map(
            (value) => html`
              <option value=${value}>${value === PASS ? "pass: leave unmeasured" : value}</option>`,
          )}
        </select></span>
      ${
        measuredAs === null &&
        nearest &&
        html`
          <${SmallButton} text=${`Is it ${nearest}?`} onClick=${() => (focusOn(name), measure(nearest))} />`
      }
    </td>
    <td role="cell" class="faint classes__tags">${tags.join(" + ") || "–"}</td>
    <td role="cell" class="classes__verdicts">${
      all > 0
        ? html`<${VerdictBar} counts=${{ boxes: all, ...counts }} />
        <span class="faint num" aria-hidden="true">${verdictsText(counts)}</span>`
        : html`<span class="faint">–</span>`
    }</td>
    <td role="cell" class="is-num num classes__unknown ${shade}">
      ${percentText(unknownPercent)}<span class="only-narrow"> unknown pixels</span>
    </td>
  </tr>`;
}

const MOST_STREAMS = 12;

/**
 * @typedef {object} OfStreams
 * @property {readonly Entry[]} entries
 * @property {string} top
 * @property {string | null} layout
 * @property {readonly Correction[]} corrections
 * @property {Correct} correct
 */

/** @param {{streams: readonly Stream[]} & OfStreams} props */
export function Streams({ streams, ...shared }) {
  if (streams.length === 0) return null;
  const rest = streams.length - MOST_STREAMS;
  return html`<section aria-labelledby="streams-title">
    <header class="part__head">
      <h3 id="streams-title">Images</h3><span class="faint">what each kind of image is</span>
    </header>
    <ul class="streams">${streams
      .slice(0, MOST_STREAMS)
      .map(
        (stream) => html`<${StreamCard} key=${stream.pattern ?? stream.example} stream=${stream} ...${shared} />`,
      )}</ul>
    ${rest > 0 && html`<p class="faint">and ${countText(rest)} more</p>`}
  </section>`;
}

/** @param {string} path @param {string} top  the name of the one folder, or "" */
const withoutTop = (path, top) => (top ? path.slice(top.length + 1) : path);

/** @param {Stream} stream @param {string} role  "" is not used @returns {Correction} */
function roleAs({ pattern }, role) {
  const name = pattern?.split("/").slice(-2).join("/");
  const text = `Images: ${name} ${role ? `is ${ROLES[role]}` : "not used"}`;
  return { place: ["files", pattern ?? ""], value: role, text };
}

/** What files of other sensors are; those of no role are not used. @type {Readonly<Record<string, string>>} */
const SENSORS = { lidar: "LiDAR", radar: "radar" };

/** Who says what an image is, whatever folder it is in. */
const FIRM = ["manifest", "description"];

/** @type {Readonly<Record<string, string>>} */
const TOLD_BY = { name: "its name", pixels: "its pixels", description: "the description", manifest: "the manifest" };

/** @param {{stream: Stream} & OfStreams} props */
function StreamCard({ stream, entries, top, layout, corrections, correct }) {
  const { role, images, example, told_by: toldBy, pattern } = stream;
  const entry = entries.find(({ path }) => path === example);
  const recognised = role in ROLES || role in SENSORS ? role : "";
  const value = (pattern && correctionOf(corrections, ["files", pattern])) ?? recognised;
  const told = toldBy.map((word) => TOLD_BY[word] ?? `the ${word}`).join(" and ");
  // Other layouts say where images are, but for the folder of their segmentations.
  const isFree = pattern !== null && (layout === "pairs" || layout === null);
  const path = withoutTop(example, top);
  const folder = path.slice(0, Math.max(0, path.lastIndexOf("/")));
  const isFirm = folder === "" || role in SENSORS || toldBy.some((word) => FIRM.includes(word));
  const offered = isFree ? [...Object.keys(ROLES), ""] : [...new Set([value, ...(isFirm ? [] : ["segmentation"])])];
  /** @param {Chosen} event */
  const onChange = ({ currentTarget: { value: next } }) => {
    const text = `Images: ${folder} is ${ROLES[next]}`;
    correct(isFree ? roleAs(stream, next) : { place: ["segmentation", "folder"], value: folder, text });
  };
  return html`<li class="stream">
    <${Thumbnail} entry=${entry} isPhoto=${role === "image"} />
    <div class="stream__text">
      <div class="stream__head">
        <span class="select"><select aria-label=${`Role of ${path}`} value=${value} disabled=${offered.length < 2}
            onChange=${onChange}>
            ${offered.map((each) => html`<option value=${each}>${ROLES[each] ?? SENSORS[each] ?? "not used"}</option>`)}
          </select></span>
        <span class="num">${countOf(images, "image")}</span>
      </div>
      <span class="stream__path" title=${path}><${MiddleCut} text=${path} /></span>
      <span class="faint">${told ? `told by ${told}` : role === "image" ? "taken for a picture" : "not used"}</span>
    </div>
  </li>`;
}

const THUMBNAIL_PX = 176;

/** The mean level below which an image is too dark to be seen: raw tags, 16-bit depth. */
const DARK = 48;

/** A dropped image, small. @param {{entry: Entry | undefined, isPhoto: boolean}} props */
function Thumbnail({ entry, isPhoto }) {
  const canvas = useRef(/** @type {HTMLCanvasElement | null} */ (null));
  useEffect(() => {
    let isWanted = true;
    const paint = (/** @type {ImageBitmap} */ bitmap) =>
      isWanted && canvas.current && paintThumbnail(canvas.current, bitmap, isPhoto);
    const resizeQuality = isPhoto ? "medium" : "pixelated";
    // What is no image has no thumbnail.
    const small = /** @type {const} */ ({ resizeWidth: THUMBNAIL_PX, resizeQuality });
    const bitmap = entry?.open().then((blob) => createImageBitmap(blob, small));
    bitmap?.then(paint, () => {});
    return () => void (isWanted = false);
  }, [entry, isPhoto]);
  return html`<canvas ref=${canvas} class="thumbnail" aria-hidden="true"
    width=${THUMBNAIL_PX} height=${Math.round(THUMBNAIL_PX / 1.6)}></canvas>`;
}

/**
 * @param {HTMLCanvasElement} canvas @param {ImageBitmap} bitmap
 * @param {boolean} isPhoto  a dark one may be of a night
 */
function paintThumbnail(canvas, bitmap, isPhoto) {
  canvas.height = Math.max(1, Math.min(bitmap.height, THUMBNAIL_PX));
  const ctx = canvas.getContext("2d", { willReadFrequently: true });
  ctx?.drawImage(bitmap, 0, 0);
  bitmap.close();
  if (isPhoto) return;
  const pixels = ctx?.getImageData(0, 0, canvas.width, canvas.height);
  if (pixels && stretched(pixels.data)) ctx?.putImageData(pixels, 0, 0);
}

/** Make a dark image grey, up to white. @param {Uint8ClampedArray} data  RGBA @returns {boolean} whether it was dark */
function stretched(data) {
  const pixels = Array.from({ length: data.length / 4 }, (_, at) => data.subarray(4 * at, 4 * at + 3));
  const levels = pixels.map((rgb) => Math.max(...rgb));
  const mean = levels.reduce((sum, level) => sum + level, 0) / levels.length;
  const most = levels.reduce((high, level) => Math.max(high, level), 1);
  if (mean >= DARK) return false;
  for (const [at, level] of levels.entries()) data.fill((255 * level) / most, 4 * at, 4 * at + 3);
  return true;
}

/** Facts with a heading of their own. */
const SHOWN_ELSEWHERE = ["layout", "holds", "segmentation"];

/**
 * How segmentations are read, with the choice of their palette, and other facts.
 * @param {{plan: Plan, fields: readonly Field[], corrections: readonly Correction[], correct: Correct}} props
 *   `fields`: of a new dataset
 */
export function Facts({ plan: { inspection, settings }, fields, corrections, correct }) {
  const { facts, palette, streams } = inspection;
  const reason = facts.find(({ name }) => name === "segmentation")?.text;
  const isLossy = streams.some(({ role, example }) => role === "segmentation" && /\.jpe?g$/i.test(example));
  /** @param {string} key @param {string} name  of the key in the description @param {string} label */
  const ask = (key, name, label) => {
    const field = fields.find((other) => other.key === key);
    if (!field) return null;
    const place = ["segmentation", name];
    const initial = correctionOf(corrections, place) ?? settings[key] ?? field.initial;
    const auto = palette ? { text: `auto: ${palette}` } : {};
    const choices = field.choices.map((choice) => (choice.value === "auto" ? { ...choice, ...auto } : choice));
    /** @param {string} value */
    const onChange = (value) => correct({ place, value, text: `${label}: ${value}` });
    return html`<${Control} field=${{ ...field, choices }} label=${label} value=${initial} onChange=${onChange} />`;
  };
  const others = facts.filter(({ name }) => !SHOWN_ELSEWHERE.includes(name));
  if (!reason && others.length === 0) return null;
  return html`<section aria-labelledby="facts-title">
    <header class="part__head"><h3 id="facts-title">Palette and sizes</h3></header>
    <dl class="understood__facts">
      ${
        reason &&
        html`<div>
          <dt>Palette</dt><dd>${ask("palette", "palette", "Palette")}<span class="faint">${reason}</span></dd>
        </div>`
      }
      ${
        isLossy &&
        html`<div>
          <dt>JPEG segmentations</dt>
          <dd>${ask("lossy_segmentation", "lossy", "JPEG segmentations")}
            <span class="faint">nearest: match each pixel to the nearest colour</span></dd>
        </div>`
      }
      ${others.map(
        ({ name, text }) => html`<div key=${name + text}>
          <dt>${capitalized(name)}</dt><dd>${text}</dd>
        </div>`,
      )}
    </dl>
  </section>`;
}
