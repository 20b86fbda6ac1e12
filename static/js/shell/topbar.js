// @ts-check
// The top bar: breadcrumb, tabs of the dataset, whether all answers are saved, menu. Views set its content by
// useTopBar.

import { filtersOf } from "../boxes/filters.js";
import { isReached, json } from "../core/api.js";
import { useClosing, useValue } from "../core/hooks.js";
import { html, useEffect, useLayoutEffect, useRef, useState } from "../core/html.js";
import { Icon, Mark } from "../core/icons.js";
import { perform, useKeyText } from "../core/keymap.js";
import { countOf } from "../core/numbers.js";
import { ROUTES, linkTo } from "../core/router.js";

/** @import { Route } from "../core/router.js" */
/** @import { ReviewApp as App } from "../review/answers.js" */

/** @param {{app: App}} props */
export function TopBar({ app }) {
  const { crumbs, tools } = useValue(app.topBar);
  return html`<header class="topbar">
    <a class="topbar__home" href=${linkTo("datasets")}
      aria-label="Unghost: all datasets"><${Mark} /><span class="topbar__name">Unghost</span></a>
    <nav class="crumbs" aria-label="Breadcrumb">
      <ol>
        ${crumbs.map(
          ({ text, href }) =>
            html`<li>
              ${href ? html`<a href=${href}>${text}</a>` : html`<span aria-current="page" title=${text}>${text}</span>`}
            </li>`,
        )}
      </ol>
    </nav>
    <${DatasetTabs} app=${app} />
    <div class="topbar__middle">${tools}</div>
    <${SaveState} app=${app} />
    <${PersonName} app=${app} />
    <${Menu} app=${app} />
  </header>`;
}

/** The name that answers are stored under. @param {{app: App}} props */
function PersonName({ app }) {
  const person = useValue(app.person);
  if (!person) return null;
  return html`<span class="who" title=${`Signed in as ${person.name}, ${person.role}`}>
    <span class="who__letter" aria-hidden="true">${[...person.name][0]?.toUpperCase() ?? ""}</span>
    <span class="who__name">${person.name}</span>
  </span>`;
}

const PHASES = {
  saved: { icon: "check", text: "All answers saved" },
  lost: { icon: "warn", text: "not saved: somebody else answered first" },
  away: { icon: "cloud", text: "The server does not answer" },
  saving: { icon: "check", text: "Saving…" },
  offline: { icon: "cloud", text: "offline, kept here" },
  busy: { icon: "cloud", text: "server busy, trying again" },
  "signed-out": { icon: "cloud", text: "signed out, kept here" },
};

/** How often a server that does not answer is asked whether it is back. */
const ASK_MS = 3000;

/** @param {{app: App}} props */
function SaveState({ app }) {
  const { phase, count } = useValue(app.sender.state);
  const lost = useValue(app.overtaken).size;
  const isAway = !useValue(isReached);
  useEffect(() => {
    if (!isAway) return;
    const asking = setInterval(() => void json("/healthz").catch(() => {}), ASK_MS);
    return () => clearInterval(asking);
  }, [isAway]);
  // That nothing waits here says that all answers are saved only if none was refused and the server is there.
  const shown = phase !== "saved" ? phase : lost > 0 ? "lost" : isAway ? "away" : "saved";
  const isWaiting = phase !== "saved" && phase !== "saving";
  const { icon, text } = PHASES[shown];
  const words = isWaiting
    ? `${countOf(count, "answer")} waiting: ${text}`
    : shown === "lost"
      ? `${countOf(lost, "answer")} ${text}`
      : text;
  return html`<div class="savestate savestate--${shown}" role="status" title=${words}>
    <${Icon} name=${icon} /><span class="savestate__text">${words}</span>
    ${isWaiting && html`<button class="button button--small" onClick=${app.resume}>Retry</button>`}
  </div>`;
}

const THEMES = /** @type {const} */ ([
  { value: "system", text: "System", icon: "system" },
  { value: "light", text: "Light", icon: "sun" },
  { value: "dark", text: "Dark", icon: "moon" },
]);

/** @param {{app: App}} props */
function Menu({ app }) {
  const [isOpen, setOpen] = useState(false);
  const root = useRef(/** @type {HTMLDivElement | null} */ (null));
  useClosing(root, isOpen, () => setOpen(false));
  return html`<div class="menu" ref=${root}>
    <button class="button button--quiet button--icon" aria-expanded=${isOpen} aria-label="Settings" title="Settings"
      onClick=${() => setOpen(!isOpen)}>
      <${Icon} name="dots" class="icon--bold" />
    </button>
    ${isOpen && html`<${MenuPanel} app=${app} close=${() => setOpen(false)} />`}
  </div>`;
}

/** @param {{app: App, close: () => void}} props */
function MenuPanel({ app, close }) {
  const prefs = useValue(app.prefs);
  const helpKey = useKeyText(app, "help");
  return html`<div class="menu__panel" role="group" aria-label="Settings">
    <div class="menu__label" id="theme-label">Appearance</div>
    <div class="segments segments--wide" role="group" aria-labelledby="theme-label">
      ${THEMES.map(
        ({ value, text, icon }) => html`<button class="segments__item" aria-pressed=${prefs.theme === value}
          onClick=${() => app.prefs.change({ theme: value })}>
          <${Icon} name=${icon} />${text}
        </button>`,
      )}
    </div>
    <button class="menu__item" onClick=${() => (close(), perform(app, "help"))}>
      <${Icon} name="keyboard" />Keys${helpKey && html`<kbd aria-hidden="true">${helpKey}</kbd>`}</button>
    <button class="menu__item" onClick=${() => app.signOut().catch(app.toasts.fail)}>
      <${Icon} name="exit" />Sign out
    </button>
  </div>`;
}

/** Whether the tabs of the dataset are shown above this view. @param {Route} route */
export const hasTabs = (route) => ROUTES.some(({ name, nav }) => (nav || ofFrame(name)) && name === route.name);

/** Views of one frame, whose address does not name its dataset. @param {string} name */
const ofFrame = (name) => name === "frame" || name === "compare";

/** The tabs of a dataset. Their links keep the filters. @param {{app: App}} props */
function DatasetTabs({ app }) {
  const route = useValue(app.router.route);
  const list = useRef(/** @type {HTMLUListElement | null} */ (null));
  useLayoutEffect(
    () => list.current?.querySelector("[aria-current]")?.scrollIntoView({ block: "nearest", inline: "center" }),
    [route.name],
  );
  const { dataset: shown } = useValue(app.topBar);
  if (!hasTabs(route)) return null;
  const dataset = route.params.dataset ?? shown;
  const tabs = dataset ? ROUTES.filter(({ nav }) => nav) : [];
  /** @param {string} name */
  const current = (name) =>
    name === route.name ? "page" : name === "frames" && ofFrame(route.name) ? "true" : undefined;
  return html`<nav class="tabs" aria-label="Dataset">
    <ul class="tabs__list" ref=${list}>
      ${tabs.map(
        ({ name, nav }) => html`<li key=${name}>
          <a class="tabs__item" href=${linkTo(name, { dataset }, filtersOf(route.query))}
            aria-current=${current(name)}>${nav}</a>
        </li>`,
      )}
    </ul>
  </nav>`;
}
