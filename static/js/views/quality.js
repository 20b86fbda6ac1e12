// @ts-check
// The filter against people or instances: where they agree, how surely, and which thresholds would do better.

import { html } from "../html.js";
import { jobs } from "../calls/jobs.js";
import { loadQuality } from "../calls/quality.js";
import { FEW_ANSWERS, answersIn } from "../measures.js";
import { ROUTES, linkTo } from "../router.js";
import { countOf, countText } from "../wording.js";
import { useLoaded, useTitle } from "./hooks.js";
import { Icon } from "./icons.js";
import { Failure, Notice, Segments } from "./parts.js";
import { Channels } from "./quality/channels.js";
import { ConfusionPanel } from "./quality/confusion.js";
import { Reviewers } from "./quality/reviewers.js";
import { Suggestions } from "./quality/suggestions.js";
import { PerGroup } from "./quality/groups.js";
import { TRUTHS, WORDS } from "./quality/truths.js";
import { TopBar } from "./topbar.js";

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../types_quality.js").Quality} Quality */

/** Where answers are given. @param {string} dataset @param {Record<string, string>} [query] */
export const queueLink = (dataset, query = {}) => linkTo(ROUTES.some(({ name }) => name === "queue") ? "queue" : "frames", { dataset }, query);

/** @param {{app: App, route: import("../router.js").Route}} props */
export const QualityView = ({ app, route }) => html`<${QualityOf} key=${route.params.dataset} app=${app} route=${route} />`;

/** One dataset: nothing of another one is left over. @param {{app: App, route: import("../router.js").Route}} props */
function QualityOf({ app, route }) {
  const name = route.params.dataset ?? "";
  useTitle(`Quality · ${name}`);
  const target = route.query.target === "recall" ? "recall" : "f1";
  const against = route.query.against === "instances" ? "instances" : "people";
  /** @param {Record<string, string>} some  an empty value is the usual one, which links leave out */
  const change = (some) => app.router.replace(linkTo("quality", { dataset: name }, { ...route.query, ...some }));
  const loaded = useLoaded(app, async (signal) => {
    const [quality, active] = await Promise.all([loadQuality(name, { truth: against, target }, signal), jobs.activeConfig(name, signal)]);
    return { quality, active };
  }, [name, target, against]);
  const quality = loaded.value?.quality;
  const known = quality ? answersIn(quality.confusion) : 0;
  const truth = quality?.truth ?? against;
  const setAgainst = (/** @type {string} */ wanted) => change({ against: wanted === "people" ? "" : wanted });
  return html`<${TopBar} app=${app} crumbs=${[{ text: "Datasets", href: linkTo("datasets") }, { text: name }]} />
    <main id="main" class="page" tabindex="-1" aria-busy=${!quality}>
      <div class="page__head">
        <h1>Quality</h1>
        ${quality && html`<span class="faint">the filter against ${WORDS[truth].head(known)}${truth === "people" && quality.unsure > 0 ? `, ${countText(quality.unsure)} unsure besides` : ""}</span>`}
        <span class="page__settings"><${Segments} label="Compare the filter with" value=${against} choices=${TRUTHS} onChange=${setAgainst} /></span>
      </div>
      ${loaded.state === "error" && !quality
        ? html`<${Failure} error=${loaded.error} onRetry=${loaded.reload} />`
        : !quality || !loaded.value
          ? html`<${Skeleton} />`
          : html`<div class="quality">
              ${known === 0
                ? html`<${Empty} dataset=${name} truth=${truth} unsure=${quality.unsure} onInstances=${() => setAgainst("instances")} />`
                : html`${truth === "people" && known < FEW_ANSWERS && html`<${Few} dataset=${name} answers=${known} />`}
                    <${ConfusionPanel} dataset=${name} truth=${truth} confusion=${quality.confusion} />
                    <${PerGroup} dataset=${name} quality=${quality} />
                    <${Suggestions} app=${app} dataset=${name} truth=${truth} suggested=${quality.suggested} active=${loaded.value.active} target=${target}
                      onTarget=${(/** @type {string} */ wanted) => change({ target: wanted === "f1" ? "" : wanted })} />
                    <${Reviewers} agreement=${quality.agreement} reviewers=${quality.reviewers} />`}
              <${Channels} app=${app} dataset=${name} active=${String(loaded.value.active.config.evidence ?? "")} truth=${route.query.truth === "people" ? "people" : "instances"}
                onTruth=${(/** @type {string} */ wanted) => change({ truth: wanted === "people" ? wanted : "" })} onMeasured=${loaded.reload} />
            </div>`}
    </main>`;
}

/** @param {{dataset: string, answers: number}} props */
const Few = ({ dataset, answers }) => html`<p class="fewanswers"><${Icon} name="warn" />
  <span><strong>${countOf(answers, "answer")} say little.</strong> Read the intervals rather than the numbers; from about ${FEW_ANSWERS} answers on they become narrow.</span>
  <a class="button button--small" href=${queueLink(dataset)}>Answer more</a></p>`;

/** @param {{dataset: string, truth: string, unsure: number, onInstances: () => void}} props */
const Empty = ({ dataset, truth, unsure, onInstances }) =>
  truth === "instances"
    ? html`<${Notice} icon="question" title="No instances have been measured">
  <p>Instance images that came with frames say what is visible. "Measure every channel" below reads them.</p>
<//>`
    : html`<${Notice} icon="question" title="Nobody has answered yet"
  actions=${html`<a class="button button--primary" href=${queueLink(dataset)}>Answer boxes</a><button class="button" onClick=${onInstances}>Compare with instances</button>`}>
  <p>How well the filter does is told by people: keep or reject some boxes, kept and rejected ones, and this page compares.</p>
  ${unsure > 0 && html`<p class="faint">${countOf(unsure, "box", "boxes")} flagged as unsure ${unsure === 1 ? "does" : "do"} not count.</p>`}
<//>`;

const Skeleton = () => html`<div class="quality" aria-hidden="true">${[0, 1, 2].map(() => html`<div class="panelbox"><div class="bone bone--tall shimmer"></div></div>`)}</div>
  <p class="sr-only" role="status">Loading quality</p>`;
