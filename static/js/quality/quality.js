// @ts-check
// The quality view, and how far people agree with each other.

import { get } from "../core/api.js";
import { useLoaded, useTopBar } from "../core/hooks.js";
import { html } from "../core/html.js";
import { Icon } from "../core/icons.js";
import { countOf, countText } from "../core/numbers.js";
import { Failure, Notice, Segments, WideTable, numeric } from "../core/parts.js";
import { linkTo } from "../core/router.js";
import { EvidenceSwitch } from "../tuning/evidence.js";
import { Channels } from "./channels.js";
import { ConfusionPanel, PerGroup } from "./comparison.js";
import { Experiment } from "./experiment.js";
import { TRUTHS, WORDS, answersIn, kappaText, planText, refusalText } from "./measures.js";
import { Suggestions } from "./suggestions.js";

/** @import { App } from "../core/app.js" */
/** @import { Agreement, Quality, Reviewer } from "../core/openapi.js" */
/** @import { Route } from "../core/router.js" */

/** @param {{app: App, route: Route}} props */
export function QualityView({ app, route }) {
  const name = route.params.dataset ?? "";
  useTopBar(app, { title: `Quality · ${name}`, dataset: name });
  const target = route.query.target === "recall" ? "recall" : "f1";
  const against = route.query.against === "instances" ? "instances" : "people";
  /** @param {Record<string, string>} some  an empty value means the default, which addresses leave out */
  const change = (some) => app.router.replace(linkTo("quality", { dataset: name }, { ...route.query, ...some }));
  const loaded = useLoaded(
    async (signal) => {
      const [quality, active] = await Promise.all([
        get("/api/v1/datasets/{dataset}/quality", {
          path: { dataset: name },
          query: { truth: against, target },
          signal,
        }),
        get("/api/v1/datasets/{dataset}/config", { path: { dataset: name }, signal }),
      ]);
      return { quality, active, target };
    },
    [name, target, against],
  );
  const quality = loaded.value?.quality;
  const known = quality ? answersIn(quality.confusion) : 0;
  const truth = quality?.truth ?? against;
  const setAgainst = (/** @type {string} */ wanted) => change({ against: wanted === "people" ? "" : wanted });
  return html`<main id="main" class="page" tabindex="-1" aria-busy=${loaded.state === "loading"}>
    <div class="page__head">
      <h1>Quality</h1>
      ${
        quality &&
        html`<span class="faint">the filter against ${WORDS[truth].head(known)}
          ${truth === "people" && quality.unsure > 0 ? `, and ${countText(quality.unsure)} unsure` : ""}</span>`
      }
      <span class="page__settings">
        <${Segments} label="Compare the filter with" value=${against} choices=${TRUTHS} onChange=${setAgainst} /></span>
    </div>
    ${
      loaded.state === "error"
        ? html`<${Failure} error=${loaded.error} onRetry=${loaded.reload} />`
        : !quality || !loaded.value
          ? html`<div class="quality" aria-hidden="true">
            ${[0, 1, 2].map(
              () => html`<div class="panelbox"><div class="skeleton skeleton--tall shimmer"></div></div>`,
            )}</div>
          <p class="sr-only" role="status">Loading quality</p>`
          : html`<${EvidenceSwitch} key=${loaded.value.active.digest} app=${app} dataset=${name}
            active=${loaded.value.active} onApplied=${loaded.reload} />
          <div class="quality">
            ${
              known === 0
                ? html`<${Empty} dataset=${name} truth=${truth} unsure=${quality.unsure}
                  onInstances=${() => setAgainst("instances")} />`
                : html`<${SampleNote} dataset=${name} quality=${quality} />
                <${ConfusionPanel} dataset=${name} quality=${quality} />
                <${PerGroup} dataset=${name} quality=${quality} />
                <${Suggestions} app=${app} dataset=${name} truth=${truth} suggested=${quality.suggested}
                  active=${loaded.value.active} target=${loaded.value.target}
                  onTarget=${(/** @type {string} */ wanted) => change({ target: wanted === "f1" ? "" : wanted })}
                  onOutdated=${loaded.reload} />
                <${Reviewers} agreement=${quality.agreement} reviewers=${quality.reviewers} />`
            }
            <${Channels} app=${app} dataset=${name} active=${String(loaded.value.active.config.evidence ?? "")}
              truth=${route.query.truth === "people" ? "people" : "instances"}
              onTruth=${(/** @type {string} */ wanted) => change({ truth: wanted === "people" ? wanted : "" })}
              onMeasured=${loaded.reload} />
            <${Experiment} dataset=${name} />
          </div>`
    }
  </main>`;
}

/**
 * Whether the answers can say how good the filter is, and how many random ones can.
 * @param {{dataset: string, quality: Quality}} props
 */
function SampleNote({ dataset, quality }) {
  const { sample, plan, confusion } = quality;
  if (!sample || !plan) return null;
  const { answered, unanswered } = sample;
  const isRefused = confusion.refused !== null;
  return html`<p class="fewanswers"><${Icon} name=${isRefused ? "warn" : "question"} />
    <span>${isRefused && html`<strong>${refusalText(answersIn(confusion), answered)}</strong> `}
      ${planText(plan, answered)}
      ${answered > 0 && html` <b class="num">${countText(answered)}</b> of ${countText(plan.boxes)} are answered.`}
      ${
        unanswered > 0 &&
        html` ${countOf(unanswered, "box", "boxes")} that the random order has passed ${unanswered === 1 ? "has" : "have"} no answer, and may be anything; it begins with ${unanswered === 1 ? "it" : "them"}.`
      }</span>
    <a class="button ${isRefused ? "button--primary" : ""} button--small"
      href=${linkTo("queue", { dataset }, { order: "random" })}>Answer random boxes</a></p>`;
}

/** @param {{dataset: string, truth: string, unsure: number, onInstances: () => void}} props */
const Empty = ({ dataset, truth, unsure, onInstances }) =>
  truth === "instances"
    ? html`<${Notice} icon="question" title="No instances have been measured">
      <p>
        Instance images show what is visible. "Measure every kind" below reads those that were uploaded with the frames.
      </p>
    <//>`
    : html`<${Notice} icon="question" title="Nobody has answered yet"
      actions=${html`<a class="button button--primary" href=${linkTo("queue", { dataset })}>Answer boxes</a>
      <button class="button" onClick=${onInstances}>Compare with instances</button>`}>
      <p>
        This page compares the filter's verdicts with people's answers. Keep or reject some boxes first, both kept and
        rejected ones.</p>
      ${
        unsure > 0 &&
        html`<p class="faint">
          ${countOf(unsure, "box", "boxes")} flagged as unsure ${unsure === 1 ? "does" : "do"} not count.</p>`
      }
    <//>`;

const PEOPLE_HEADS = ["Reviewer", numeric("Answers"), numeric("Keep"), numeric("Reject"), numeric("Unsure")];

/** @param {{agreement: Agreement, reviewers: readonly Reviewer[]}} props */
function Reviewers({ agreement, reviewers }) {
  return html`<section class="panelbox quality__wide" aria-labelledby="reviewers-title">
    <header class="panelbox__head"><h2 id="reviewers-title">People</h2>
      <span class="faint">${countOf(reviewers.length, "reviewer")}</span></header>
    <div class="quality__split quality__split--top">
      <${WideTable} label="People" heads=${PEOPLE_HEADS}>
        ${reviewers.map(
          (one) => html`<tr key=${one.name}><th scope="row">${one.name}</th>
            ${[one.answers, one.keep, one.reject, one.unsure].map(
              (n) => html`<td class="is-num num">${countText(n)}</td>`,
            )}</tr>`,
        )}<//>
      <${AgreementTable} agreement=${agreement} />
    </div>
  </section>`;
}

/** @param {{agreement: Agreement}} props */
function AgreementTable({ agreement }) {
  const { boxes, percent, kappa, interval, pairs } = agreement;
  if (boxes === 0)
    return html`<p class="panelbox__empty">
      No box has been answered by two people yet. The queue's audit shows everybody the boxes that others have answered:
      nobody audits himself.</p>`;
  return html`<div class="together">
    <dl class="together__figures">
      <div><dt>agree on</dt><dd class="num">${percent === null ? "–" : `${Math.round(10 * percent) / 10} %`}</dd>
        <dd class="faint">of ${countOf(boxes, "box", "boxes")} answered twice</dd></div>
      <div><dt>Cohen's kappa</dt><dd class="num">${kappaNumber(kappa)}</dd>
        <dd class="faint">${kappaText(kappa)}
          ${interval ? `, 95 %: ${kappaNumber(interval[0])} to ${kappaNumber(interval[1])}` : ""}</dd></div>
    </dl>
    <${WideTable} label="Pairs of people" heads=${["Pair", numeric("Boxes"), numeric("Agree"), numeric("Kappa")]}>
      ${pairs.map(
        (pair) => html`<tr key=${`${pair.a} ${pair.b}`}><th scope="row">${pair.a} and ${pair.b}</th>
          <td class="is-num num">${countText(pair.boxes)}</td><td class="is-num num">${countText(pair.agreed)}</td>
          <td class="is-num num">${kappaNumber(pair.kappa)}</td></tr>`,
      )}<//>
  </div>`;
}

/** @param {number | null} kappa */
const kappaNumber = (kappa) => (kappa === null ? "–" : kappa.toFixed(2).replace("-", "−"));
