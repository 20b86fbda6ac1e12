// @ts-check
// The frame around every view: what is on show, messages, dialogs, the way in.

import { html, useEffect, useRef, useState } from "../html.js";
import { linkTo } from "../router.js";
import { DatasetsView } from "./datasets.js";
import { FrameView } from "./frame.js";
import { FramesView } from "./frames.js";
import { HelpDialog } from "./help.js";
import { useActions, useTitle, useValue } from "./hooks.js";
import { Notice } from "./parts.js";
import { SignIn } from "./signin.js";
import { Toasts } from "./toast.js";
import { TopBar } from "./topbar.js";

/** @typedef {import("../app.js").App} App */
/** @typedef {import("../router.js").Route} Route */

/** @type {Record<string, (props: {app: App, route: Route}) => unknown>} */
const VIEWS = { datasets: DatasetsView, frames: FramesView, frame: FrameView };

/** @param {{app: App, linkError: string}} props */
export function Shell({ app, linkError }) {
  const route = useValue(app.router.route);
  const isSignedIn = useValue(app.isSignedIn);
  const announcement = useValue(app.announcement);
  const [isHelpOpen, setHelpOpen] = useState(false);
  const [actions] = useState(() => ({ help: () => setHelpOpen(true) }));
  useActions(app, actions);
  useFocusOnMove(route);

  const View = VIEWS[route.name] ?? UnknownView;
  return html`<div class="shell" data-view=${isSignedIn ? route.name : "signin"}>
    <a class="skip" href="#main" onClick=${skipToMain}>Skip to content</a>
    ${isSignedIn
      ? html`<${View} key=${route.name} app=${app} route=${route} />`
      : html`<${SignIn} app=${app} linkError=${linkError} />`}
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
