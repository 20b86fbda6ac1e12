// @ts-check
// The list of datasets as cards; if there are none, how to upload one.

import { NearPicture } from "../boxes/crops.js";
import { ReviewProgress, StrokeSwatch, VerdictBar } from "../boxes/signs.js";
import { pictureUrl } from "../core/api.js";
import { useDatasets, useGrowth, useTopBar, useValue } from "../core/hooks.js";
import { html } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf, countText } from "../core/numbers.js";
import { Command, Failure, Notice } from "../core/parts.js";
import { linkTo } from "../core/router.js";
import { UploadButtons } from "../upload/upload.js";

/** @import { Dataset } from "../core/openapi.js" */
/** @import { UploadApp as App } from "../upload/uploader.js" */

/** @param {{app: App}} props */
export function DatasetsView({ app }) {
  useTopBar(app, { title: "Datasets", crumbs: [] });
  const uploads = useValue(app.uploads.ended);
  const loaded = useDatasets(uploads);
  const datasets = loaded.value?.items;
  const newest = datasets
    ?.map(({ created_at }) => created_at)
    .sort()
    .at(-1);
  useGrowth(loaded, datasets?.reduce((sum, { counts }) => sum + counts.frames, 0) ?? 0, newest);
  return html`<main id="main" class="page" tabindex="-1" aria-busy=${loaded.state === "loading"}>
    ${loaded.state === "error" && html`<${Failure} error=${loaded.error} onRetry=${loaded.reload} />`}
    ${loaded.state === "loading" && !datasets && html`<${Skeleton} />`}
    ${datasets?.length === 0 && html`<${Empty} app=${app} />`}
    ${
      datasets &&
      datasets.length > 0 &&
      html`<div class="page__head"><h1>Datasets</h1><span class="faint">${countText(datasets.length)}</span>
        <${UploadButtons} app=${app} /></div>
      <ul class="cards">
        ${datasets.map((dataset) => html`<li key=${dataset.name}><${Card} app=${app} dataset=${dataset} /></li>`)}
      </ul>`
    }
  </main>`;
}

/** @param {{app: App, dataset: Dataset}} props */
function Card({ app, dataset }) {
  const { name, description, counts, thumbnail_frame_id: thumbnail } = dataset;
  return html`<a class="card" href=${linkTo("home", { dataset: name })}>
    <div class="card__picture">
      ${
        thumbnail
          ? html`<${NearPicture}
            url=${pictureUrl("/api/v1/frames/{frame_id}/thumbnail", { path: { frame_id: thumbnail } })} />`
          : html`<${Icon} name="image" class="card__none" />`
      }
    </div>
    <div class="card__body">
      <h2 class="card__title">${name}</h2>
      ${description && html`<p class="card__text">${description}</p>`}
      <p class="card__counts">${countOf(counts.frames, "frame")} · ${countOf(counts.boxes, "box", "boxes")}
        ${counts.problems > 0 && html` · <span class="warn">${countOf(counts.problems, "refused frame")}</span>`}</p>
      <${VerdictBar} counts=${counts} />
      <div class="legend">
        <span><${StrokeSwatch} verdict="kept" /><b>${countText(counts.kept)}</b> kept</span>
        <span><${StrokeSwatch} verdict="rejected" /><b>${countText(counts.rejected)}</b> rejected</span>
        ${
          counts.unmeasured > 0 &&
          html`<span><${StrokeSwatch} verdict="unmeasured" /><b>${countText(counts.unmeasured)}</b> unmeasured</span>`
        }
      </div>
      <${ReviewProgress} counts=${counts} />
    </div>
  </a>`;
}

/** @param {{app: App}} props */
function Empty({ app }) {
  const curl = `curl -X PUT -H "Authorization: Bearer $TOKEN" -F image=@000000.png -F segmentation=@seg/000000.png -F annotation=@000000.json ${location.origin}/api/v1/datasets/NAME/frames/000000`;
  return html`<${Notice} icon="layers" title="No datasets yet">
    <p>Drop a folder of frames here: images, segmentations and boxes, in any supported layout.</p>
    <${UploadButtons} app=${app} isPrimary=${true} />
    <p>Large folders upload faster from the command line. Frames that are already stored are not sent again.</p>
    <${Command} text="unghost push FOLDER --dataset NAME" />
    <p>Frame by frame, from any program:</p>
    <${Command} text=${curl} />
    <p>Or try a small synthetic dataset with known ground truth:</p>
    <${Command} text="unghost demo" />
  <//>`;
}

function Skeleton() {
  return html`<div class="page__head"><h1>Datasets</h1></div>
  <div class="cards" aria-hidden="true">
    ${[0, 1, 2].map(
      () => html`<div class="card card--skeleton"><div class="card__picture shimmer" />
        <div class="card__body"><div class="skeleton" /><div class="skeleton skeleton--short" /><div class="skeleton" />
        </div></div>`,
    )}</div>
  <p class="sr-only" role="status">Loading datasets</p>`;
}
