// @ts-check
// The frame around every view: what is on show, messages, dialogs, the way in.

import { html, useEffect, useRef, useState } from "../html.js";
import { linkTo } from "../router.js";
import { DatasetsView } from "./datasets.js";
import { FramesView } from "./frames.js";
import { HelpDialog } from "./help.js";
import { useActions, useTitle, useValue } from "./hooks.js";
import { Failure, Notice } from "./parts.js";
import { SignIn } from "./signin.js";
import { Newcomer } from "./newcomer.js";
import { hasTabs } from "./tabs.js";
import { Toasts } from "./toast.js";
import { TopBar } from "./topbar.js";
import { Uploads } from "./upload.js";

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../router.js").Route} Route */

/** @typedef {(props: {app: App, route: Route}) => unknown} View */

/** The views that people arrive at; the others come when they are asked for. @type {Record<string, View>} */
const VIEWS = { datasets: DatasetsView, frames: FramesView };

/** @type {Record<string, () => Promise<View>>} */
const LATER = {
  frame: async () => (await import("./frame.js")).FrameView,
  grid: async () => (await import("./grid.js")).GridView,
  queue: async () => (await import("./queue.js")).QueueView,
  thresholds: async () => (await import("./thresholds.js")).ThresholdsView,
  runs: async () => (await import("./runs.js")).RunsView,
  quality: async () => (await import("./quality.js")).QualityView,
};

/** @param {{app: App, linkError: string}} props */
export function Shell({ app, linkError }) {
  const route = useValue(app.router.route);
  const isSignedIn = useValue(app.isSignedIn);
  const announcement = useValue(app.announcement);
  const [isHelpOpen, setHelpOpen] = useState(false);
  const [actions] = useState(() => ({ help: () => setHelpOpen(true) }));
  useActions(app, actions);
  useFocusOnMove(route);

  const View = VIEWS[route.name] ?? (LATER[route.name] ? LateView : UnknownView);
  return html`<div class="shell" data-view=${isSignedIn ? route.name : "signin"} data-tabs=${(isSignedIn && hasTabs(route)) || undefined}>
    <a class="skip" href="#main" onClick=${skipToMain}>Skip to content</a>
    ${isSignedIn
      ? html`<${View} key=${route.name} app=${app} route=${route} />`
      : html`<${SignIn} app=${app} linkError=${linkError} />`}
    ${isSignedIn && html`<${Uploads} app=${app} />`}
    <${Newcomer} app=${app} />
    <${Toasts} app=${app} />
    <div class="sr-only" role="status" aria-live="polite">${announcement}</div>
    ${isHelpOpen && html`<${HelpDialog} app=${app} onClose=${() => setHelpOpen(false)} />`}
  </div>`;
}

/** The address belongs to the router: a skip link must not change it. @param {Event} event */
function skipToMain(event) {
  event.preventDefault();
  document.getElementById("main")?.focus();
}

/** After a move to another view, reading starts there. @param {Route} route */
function useFocusOnMove(route) {
  const isFirst = useRef(true);
  const place = `${route.name} ${Object.values(route.params).join(" ")}`;
  useEffect(() => {
    if (!isFirst.current) {
      scrollTo(0, 0);
      document.getElementById("main")?.focus({ preventScroll: true });
    }
    isFirst.current = false;
  }, [place]);
}

/** Those that have come. @type {Record<string, View>} */
const arrived = {};

/** A view whose modules come when it is asked for. @param {{app: App, route: Route}} props */
function LateView({ app, route }) {
  const { name } = route;
  const [error, setError] = useState(/** @type {Error | null} */ (null));
  const [, setArrived] = useState("");
  const fetchView = () => {
    setError(null);
    LATER[name]?.().then((view) => ((arrived[name] = view), setArrived(name)), setError);
  };
  useEffect(() => void (arrived[name] ?? fetchView()), [name]);
  const View = arrived[name];
  if (View) return html`<${View} app=${app} route=${route} />`;
  return html`<${TopBar} app=${app} crumbs=${[]} />
    <main id="main" class="page" tabindex="-1" aria-busy=${error === null}>${error && html`<${Failure} error=${error} onRetry=${fetchView} />`}</main>`;
}

/** @param {{app: App, route: Route}} props */
function UnknownView({ app, route }) {
  useTitle("Not found");
  return html`<${TopBar} app=${app} crumbs=${[]} />
    <main id="main" class="page" tabindex="-1">
      <${Notice} icon="question" title="There is nothing at this address"
        actions=${html`<a class="button" href=${linkTo("datasets")}>All datasets</a>`}>
        <p>${route.params.path}</p>
      <//>
    </main>`;
}
