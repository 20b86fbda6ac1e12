// @ts-check
// The content of the upload dialog: how the server understands the dropped files, and the dataset that they go to.

import { ApiError } from "../core/api.js";
import { useFields, useMeasuredClasses } from "../core/form.js";
import { useDatasets, useLoaded, useTask } from "../core/hooks.js";
import { html, useEffect, useRef, useState } from "../core/html.js";
import { countOf, sizeText } from "../core/numbers.js";
import { Command, FailureLine, FileList, RecordingDownload } from "../core/parts.js";
import { hasImages, pack, sizesOf } from "./archive.js";
import { corrected, correctionOf, descriptionOf, streamsWith } from "./corrections.js";
import { readFolder, topOf, visibleEntries, withSizes } from "./folder.js";
import {
  Classes,
  Columns,
  Corrections,
  Facts,
  LayoutChoice,
  Notes,
  PaintedFrames,
  Remarks,
  Streams,
  layoutAs,
} from "./understood.js";

/** @typedef {import("./uploader.js").UploadApp} App */
/** @typedef {import("./corrections.js").Correction} Correction */
/** @typedef {import("./folder.js").Entry} Entry */
/** @typedef {import("./folder.js").Plan} Plan */
/** @typedef {import("./folder.js").Reading} Reading */
/** @typedef {import("../core/openapi.js").FolderRemark} Remark */

/** With more frames than this, the dialog recommends the command line. */
const MANY_FRAMES = 2000;

/** More frames that cannot be read are listed on request. */
const FEW_PROBLEMS = 20;

/** The names that a dataset may have. */
export const DATASET_NAME = /^[A-Za-z0-9](?:[A-Za-z0-9._-]{0,98}[A-Za-z0-9])?$/;

const NAME_RULE = "Use letters (a to z), digits, dots, dashes and underscores; begin and end with a letter or digit.";

/** @param {{app: App, dropped: Promise<Entry[]>, close: () => void}} props */
export function FoundFiles({ app, dropped, close }) {
  const found = useFound(dropped);
  const { plan, error } = found;
  if (plan) return html`<${Review} app=${app} found=${found} plan=${plan} close=${close} />`;
  return error
    ? html`<${NotRead} found=${found} error=${error} close=${close} />`
    : html`<${Progress} found=${found} close=${close} />`;
}

/**
 * @typedef {object} Found
 * @property {readonly Entry[] | null} entries
 * @property {string} top  the name of the one folder, or ""
 * @property {Plan | null} plan  while the files are read again, the one from before
 * @property {import("./archive.js").Sizes | null} sizes  asked for once the files are understood, which need none
 * @property {readonly import("./corrections.js").Stream[]} streams
 * @property {boolean} isReading
 * @property {Reading | null} reading
 * @property {Error | null} error
 * @property {readonly Correction[]} corrections
 * @property {(...next: Correction[]) => void} correct
 * @property {(correction: Correction) => void} undo
 * @property {() => void} retry
 */

/** @param {Promise<Entry[]>} dropped @returns {Found} */
function useFound(dropped) {
  const [corrections, setCorrections] = useState(/** @type {readonly Correction[]} */ ([]));
  const [reading, setReading] = useState(/** @type {Reading | null} */ (null));
  const packed = useRef(/** @type {import("./archive.js").Packed | null} */ (null));
  /** Before anything was corrected. */
  const base = useRef(/** @type {Plan["inspection"] | null} */ (null));
  const { value: entries, error: notListed } = useLoaded(() => dropped.then(listed), [dropped]);
  const top = entries ? topOf(entries) : "";
  const read = useLoaded(
    async (signal) => {
      if (!entries) return null;
      const tell = (/** @type {Reading} */ now) => signal.aborted || setReading(now);
      packed.current ??= await pack(entries, top, signal, (done, of) => tell({ step: "labels", done, of }));
      const { given, streams } = base.current ?? { given: {}, streams: [] };
      const description = corrections.length > 0 ? descriptionOf(given, streams, corrections) : null;
      const layout = correctionOf(corrections, ["layout"]) ?? "auto";
      const plan = await readFolder(entries, packed.current, { layout, description }, signal, tell);
      base.current ??= plan.inspection;
      return plan;
    },
    [entries, corrections],
  );
  const isRead = read.value !== null;
  const sizes = useLoaded(async (signal) => (isRead && entries ? sizesOf(entries, signal) : null), [entries, isRead]);
  return {
    entries,
    top,
    plan: read.value && sizes.value ? withSizes(read.value, sizes.value) : read.value,
    sizes: sizes.value,
    streams: streamsWith(base.current?.streams ?? [], read.value?.inspection.streams ?? [], corrections),
    isReading: read.state === "loading",
    reading,
    error: notListed ?? read.error ?? sizes.error,
    corrections,
    correct: (...next) => setCorrections(next.reduce(corrected, corrections)),
    undo: (correction) => setCorrections(corrections.filter((other) => other !== correction)),
    retry: read.reload,
  };
}

/** @param {readonly Entry[]} all */
function listed(all) {
  const entries = visibleEntries(all);
  if (entries.length === 0) throw new Error("There are no files in it.");
  return entries;
}

/** @param {{found: Found, close: () => void}} props */
function Progress({ found: { entries, reading }, close }) {
  const share = reading?.of ? Math.floor((100 * reading.done) / reading.of) : null;
  return html`<p class="upload__reading"
    role="status"><span class="spinner" aria-hidden="true"></span>${progressText(entries, reading)}</p>
  ${
    share !== null &&
    html`<div class="progress__track" role="progressbar" aria-label="Read" aria-valuemin="0"
      aria-valuemax="100" aria-valuenow=${share}><span class="progress__fill" style=${{ width: `${share}%` }} /></div>`
  }
  <footer class="dialog__foot"><button type="button" class="button" onClick=${close}>Cancel</button></footer>`;
}

/** @param {readonly Entry[] | null} entries @param {Reading | null} reading */
function progressText(entries, reading) {
  if (!entries || !reading) return "Listing the files";
  const files = countOf(entries.length, "file");
  if (reading.step === "labels") return `Collecting the labels of ${files}`;
  if (reading.step === "waiting") return `The server is reading ${files}; nothing is stored yet`;
  return `${countOf(reading.done, "frame")} found`;
}

/**
 * Why the files could not be read, and what to do about it.
 * @param {{found: Found, error: Error, close: () => void}} props
 */
function NotRead({ found: { entries, top, corrections, undo, retry }, error, close }) {
  const isRefused = error instanceof ApiError && !error.isTemporary;
  return html`<div class="upload">
    <${Corrections} corrections=${corrections} undo=${undo} />
    <${FailureLine} error=${error} />
    ${
      error instanceof ApiError &&
      error.status === 413 &&
      html`
        <p>The command line takes folders of any size:</p><${Command} text=${commandOf(top, "")} />`
    }
    <footer class="dialog__foot">
      <button type="button" class="button" onClick=${close}>Cancel</button>
      ${
        entries &&
        !isRefused &&
        html`
          <button type="button" class="button button--primary" onClick=${retry}>Try again</button>`
      }
    </footer>
  </div>`;
}

/** @param {string} top @param {string} name */
const commandOf = (top, name) => `unghost push ${top || "FOLDER"} --dataset ${name || "NAME"}`;

const IMAGES_ONLY = { pairs: "images only" };

/** @param {{app: App, found: Found, plan: Plan, close: () => void}} props */
function Review({ app, found, plan, close }) {
  const { entries, top, sizes, streams, isReading, error: notRead, corrections, correct, undo } = found;
  const datasets = useDatasets();
  const known = datasets.value?.items ?? [];
  // Until the list is loaded it is not known whether a dataset of this name exists.
  const isKnown = datasets.value !== null;
  const [typed, setTyped] = useState(/** @type {string | null} */ (null));
  const name = typed ?? (app.topBar.get().dataset || slugOf(top));
  const [replace, setReplace] = useState(false);
  /** What is wrong with the name. */
  const [fault, setFault] = useState("");
  const field = useRef(/** @type {HTMLInputElement | null} */ (null));
  useEffect(() => field.current?.focus(), []);
  const there = known.find((dataset) => dataset.name === name);
  const { frames, inspection } = plan;
  const count = frames.length;
  const fields = useFields("DatasetIn");
  const measured = useMeasuredClasses();

  const {
    run: start,
    isBusy,
    error,
  } = useTask(async () => {
    const { classes, config } = plan;
    const settings = { ...plan.settings, recording: inspection.read_with };
    const reading = /** @type {import("./uploader.js").Order["reading"]} */ (settings);
    await app.uploads.start({ dataset: name, isNew: !there, classes, reading, config, frames, replace });
    close();
  });
  /** @param {{currentTarget: HTMLInputElement}} event */
  const onName = ({ currentTarget }) => {
    setTyped(currentTarget.value.trim());
    setFault("");
  };
  /** @param {SubmitEvent} event */
  const submit = (event) => {
    event.preventDefault();
    if (DATASET_NAME.test(name)) void start();
    else setFault(name ? NAME_RULE : "Give the dataset a name.");
  };
  const remarks = remarksOf(plan, Boolean(there));
  const these = entries?.length === 1 ? "this file" : `these ${countOf(entries?.length ?? 0, "file")}`;
  const unreadable = plan.problems.map(({ key, why }) => ({ name: key, why: withoutName(why, key) }));
  const unmatched = plan.unmatched.map(({ path, why }) => ({ name: path, why }));
  const readAgain = corrections.length > 0 ? `Read again: ${summary(plan, sizes)}` : "";
  const button = isReading ? "Reading again" : count === 0 ? "Nothing to upload" : `Upload ${countOf(count, "frame")}`;

  return html`<form class="upload understood" onSubmit=${submit} novalidate>
    ${
      plan.layout === null
        ? html`<${FailureLine} error=${{ message: `No frames were recognised in ${these}.` }} />`
        : html`<header class="understood__head">
          <p class="upload__sum"><b>${titleOf(plan)}</b> · ${summary(plan, sizes)}</p>
          <p class="faint">${inspection.why}</p>
          <${LayoutChoice} plan=${plan} correct=${correct} />
        </header>`
    }
    <${Corrections} corrections=${corrections} undo=${undo} />
    ${notRead && html`<${FailureLine} error=${notRead} />`}
    <div class="understood__parts" aria-busy=${isReading}>
      <${Remarks} remarks=${remarks} plan=${plan} top=${top} correct=${correct} />
      <${Columns} plan=${plan} entries=${entries ?? []} top=${top} corrections=${corrections} correct=${correct} />
      ${
        count > MANY_FRAMES &&
        html`<div>
          <p class="faint">For this many frames the command line is faster, and resumes where it stopped:</p>
          <${Command} text=${commandOf(top, name)} />
        </div>`
      }
      <${PaintedFrames} frames=${inspection.painted} />
      <${Classes} classes=${inspection.classes} lookedAt=${inspection.looked_at} choices=${measured}
        correct=${correct} />
      <${Streams} streams=${streams} entries=${entries ?? []} top=${top} layout=${plan.layout}
        corrections=${corrections} correct=${correct} />
      <${Facts} plan=${plan} fields=${fields.value ?? []} corrections=${corrections} correct=${correct} />
      <${Notes} remarks=${remarks} plan=${plan} top=${top} correct=${correct} />
      <${FileList} title="Cannot be read" items=${unreadable} isOpen=${unreadable.length <= FEW_PROBLEMS} />
      <${FileList} title="Did not match" items=${unmatched} isOpen=${count === 0} />
      ${
        plan.layout !== null &&
        html`<${RecordingDownload} text=${inspection.recording}
          about="Beside the data, it lets every command read them like this." />`
      }
    </div>
    <footer class="dialog__foot understood__foot">
      <div class="understood__where">
        <label class="field">
          <span>Dataset</span>
          <input ref=${field} name="dataset" list="upload-datasets" value=${name} spellcheck=${false} autocomplete="off"
            maxlength="100" aria-invalid=${fault !== ""} aria-describedby="upload-where upload-error"
            onInput=${onName} />
          <datalist id="upload-datasets">${known.map((dataset) => html`<option value=${dataset.name} />`)}</datalist>
        </label>
        ${
          datasets.error
            ? html`<${FailureLine} what="List of datasets" error=${datasets.error} onRetry=${datasets.reload} />`
            : html`<p id="upload-where" class="faint">
              ${isKnown ? whereText(there) : "Loading the list of datasets …"}</p>`
        }
        ${
          there &&
          html`<label class="switch">
            <input type="checkbox" checked=${replace} onChange=${() => setReplace(!replace)} />
            <span>Replace frames whose content has changed; answers on boxes that changed are set aside</span>
          </label>`
        }
        <p id="upload-error" class="field__error" role="alert">${fault}</p>
        ${error && html`<${FailureLine} error=${error} />`}
      </div>
      <div class="understood__do">
        <button type="button" class="button" onClick=${close}>Cancel</button>
        ${
          plan.layout === null &&
          hasImages(entries ?? []) &&
          html`
            <button type="button" class="button" disabled=${isReading}
              onClick=${() => correct(layoutAs("pairs", IMAGES_ONLY))}>Upload the images only</button>`
        }
        <button class="button button--primary"
          disabled=${isBusy || isReading || notRead !== null || !isKnown || !sizes || count === 0}>
          ${isReading && html`<span class="spinner" aria-hidden="true"></span>`}${button}
        </button>
      </div>
      <p class="sr-only" role="status">${isReading ? "The server reads the files again." : readAgain}</p>
    </footer>
  </form>`;
}

/** @param {import("../core/openapi.js").Dataset | undefined} dataset  of this name */
const whereText = (dataset) =>
  dataset
    ? `Adds to a dataset that has ${countOf(dataset.counts.frames, "frame")}. ` +
      "Frames that are already stored are not stored again."
    : "A new dataset will be created.";

const GIVEN = "The description also gives";
const TO_NEW_DATASETS = "the page gives them to new datasets only; this one keeps its configuration";

/**
 * What is to be said about the files, and about this dataset.
 * @param {Plan} plan @param {boolean} isThere @returns {Remark[]}
 */
function remarksOf({ frames, settings, config, inspection }, isThere) {
  const bare = frames.filter(({ files }) => !files.segmentation).length;
  const empty = frames.filter((frame) => boxesOf(frame) === 0).length;
  const keys = Object.keys({ ...settings, ...config }).join(" and ");
  const remarks = [...inspection.remarks];
  // Of all frames, the server says it.
  if (bare > 0 && bare < frames.length)
    remarks.push(remarkOf(`${countOf(bare, "frame")} without a segmentation, whose boxes are unmeasured`, false));
  if (empty > 0 && empty < frames.length) remarks.push(remarkOf(`${countOf(empty, "frame")} without boxes`, false));
  if (keys && isThere) remarks.push(remarkOf(`${GIVEN} ${keys}: ${TO_NEW_DATASETS}`, true));
  return remarks;
}

/** A remark without remedies. @param {string} text @param {boolean} isSerious @returns {Remark} */
const remarkOf = (text, isSerious) => ({
  text,
  finding: text,
  remedies: [],
  unknown_classes: [],
  is_serious: isSerious,
});

/** How many boxes a frame has. @param {import("./folder.js").ReadFrame} frame */
const boxesOf = ({ annotation }) => /** @type {unknown[] | undefined} */ (annotation.boxes)?.length ?? 0;

/** @param {Plan} plan */
const titleOf = ({ layout, titles }) => titles[layout ?? ""] ?? layout;

/** @param {Plan} plan @param {Found["sizes"]} sizes */
function summary({ frames, problems }, sizes) {
  if (frames.length === 0 && problems.length > 0)
    return `${countOf(problems.length, "frame")}, of which none can be uploaded as it is`;
  const boxes = frames.reduce((sum, frame) => sum + boxesOf(frame), 0);
  const texts = [countOf(frames.length, "frame"), countOf(boxes, "box", "boxes")];
  if (sizes) {
    const files = frames.flatMap((frame) => Object.values(frame.files));
    texts.push(sizeText(files.reduce((sum, file) => sum + (sizes.get(file) ?? 0), 0)));
  }
  return texts.join(" · ");
}

/** A problem without the name of its frame, which the list shows already. @param {string} why @param {string} name */
const withoutName = (why, name) => (why.startsWith(`${name}: `) ? why.slice(name.length + 2) : why);

/** @param {string} text */
const slugOf = (text) =>
  text
    .toLowerCase()
    .replace(/[^a-z0-9._-]+/g, "-")
    .replace(/^[^a-z0-9]+|[^a-z0-9]+$/g, "")
    .slice(0, 100);
