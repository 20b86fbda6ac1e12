// @ts-check
// The frame around every view: which view a route shows (most are loaded when first opened), messages, sign-in.

import { useActions, useLazy, useTask, useTitle, useTopBar, useValue } from "../core/hooks.js";
import { html, useEffect, useRef, useState } from "../core/html.js";
import { Icon, Mark } from "../core/icons.js";
import { HelpDialog } from "../core/keymap.js";
import { countOf } from "../core/numbers.js";
import { createLazy } from "../core/observable.js";
import { Dialog, Failure, Notice, useDialog } from "../core/parts.js";
import { linkTo, loginOf } from "../core/router.js";
import { DatasetsView } from "../datasets/datasets.js";
import { FramesView } from "../datasets/frames.js";
import { Uploads } from "../upload/upload.js";
import { TopBar, hasTabs } from "./topbar.js";

/** @typedef {ReviewApp & UploadApp} App */
/** @import { Lazy } from "../core/observable.js" */
/** @import { Route } from "../core/router.js" */
/** @import { ReviewApp } from "../review/answers.js" */
/** @import { UploadApp } from "../upload/uploader.js" */
/** @typedef {(props: {app: App, route: Route}) => unknown} View */

/**
 * The views that are ready at once; the others are imported when they are opened, from the script that is there already
 * or from the later one.
 * @type {Record<string, View>}
 */
const VIEWS = { datasets: DatasetsView, frames: FramesView };

/** @type {Record<string, Lazy<View>>} */
const LOADED_WHEN_OPENED = {
  home: createLazy(async () => (await import("../datasets/home.js")).HomeView),
  compare: createLazy(async () => (await import("../datasets/home.js")).CompareView),
  frame: createLazy(async () => (await import("../review/frame.js")).FrameView),
  grid: createLazy(async () => (await import("../grid/grid.js")).GridView),
  queue: createLazy(async () => (await import("../queue/queue.js")).QueueView),
  thresholds: createLazy(async () => (await import("../tuning/thresholds.js")).ThresholdsView),
  runs: createLazy(async () => (await import("../runs/runs.js")).RunsView),
  quality: createLazy(async () => (await import("../quality/quality.js")).QualityView),
};

/**
 * The key of a view makes sure that no state of another view or another dataset is kept.
 * @param {{app: App, linkError: string}} props
 */
export function Shell({ app, linkError }) {
  const route = useValue(app.router.route);
  const isSignedIn = useValue(app.isSignedIn);
  const announcement = useValue(app.announcement);
  const newcomer = useValue(app.newcomer);
  const streak = useValue(app.streak);
  const [isHelpOpen, setHelpOpen] = useState(false);
  const [actions] = useState(() => ({ help: () => setHelpOpen(true) }));
  useActions(app, actions);
  const shell = useRef(/** @type {HTMLDivElement | null} */ (null));
  /** @param {FocusOptions} [options] */
  const focusMain = (options) => shell.current?.querySelector("main")?.focus(options);
  useFocusOnMove(route, focusMain);

  const View = VIEWS[route.name] ?? (LOADED_WHEN_OPENED[route.name] ? LateView : UnknownView);
  // The address belongs to the router: the skip link must not change it.
  return html`<div class="shell" ref=${shell} data-view=${isSignedIn ? route.name : "signin"}
    data-tabs=${(isSignedIn && hasTabs(route)) || undefined}>
    <a class="skip" href="#main"
      onClick=${(/** @type {Event} */ event) => (event.preventDefault(), focusMain())}>Skip to content</a>
    ${
      isSignedIn
        ? html`<${TopBar} app=${app} />
        <${View} key=${`${route.name} ${route.params.dataset ?? ""}`} app=${app} route=${route} />`
        : html`<${SignIn} app=${app} linkError=${linkError} />`
    }
    ${isSignedIn && html`<${Uploads} app=${app} />`}
    ${newcomer && html`<${Newcomer} app=${app} newcomer=${newcomer} />`}
    ${streak && html`<${Streak} app=${app} boxIds=${streak} />`}
    <${Toasts} app=${app} />
    <div class="sr-only" role="status" aria-live="polite">${announcement}</div>
    ${isHelpOpen && html`<${HelpDialog} app=${app} onClose=${() => setHelpOpen(false)} />`}
  </div>`;
}

/**
 * After a change of view, move the focus to it, for keyboards and screen readers.
 * @param {Route} route @param {(options: FocusOptions) => void} focusMain
 */
function useFocusOnMove(route, focusMain) {
  const isFirst = useRef(true);
  const place = `${route.name} ${Object.values(route.params).join(" ")}`;
  useEffect(() => {
    if (!isFirst.current) {
      scrollTo(0, 0);
      focusMain({ preventScroll: true });
    }
    isFirst.current = false;
  }, [place]);
}

/** A view whose modules are loaded when it is opened. @param {{app: App, route: Route}} props */
function LateView({ app, route }) {
  const { value: View, error, retry } = useLazy(LOADED_WHEN_OPENED[route.name] ?? null);
  if (View) return html`<${View} app=${app} route=${route} />`;
  return html`<${Coming} app=${app} error=${error} onRetry=${retry} />`;
}

/** @param {{app: App, error: Error | null, onRetry: () => void}} props */
function Coming({ app, error, onRetry }) {
  useTopBar(app, { title: "", crumbs: [] });
  return html`<main id="main" class="page" tabindex="-1"
    aria-busy=${error === null}>${error && html`<${Failure} error=${error} onRetry=${onRetry} />`}</main>`;
}

/** @param {{app: App, route: Route}} props */
function UnknownView({ app, route }) {
  useTopBar(app, { title: "Not found", crumbs: [] });
  return html`<main id="main" class="page" tabindex="-1">
    <${Notice} icon="question" title="Page not found"
      actions=${html`<a class="button" href=${linkTo("datasets")}>All datasets</a>`}>
      <p>${route.params.path}</p>
    <//>
  </main>`;
}

/**
 * Asks whether the person of an opened login link is to be signed in.
 * @param {{app: App, newcomer: {name: string, role: string}}} props
 */
function Newcomer({ app, newcomer: { name, role } }) {
  const now = useValue(app.person)?.name ?? "";
  const dialog = useDialog();
  return html`<${Dialog} dialog=${dialog} id="newcomer-title" title="Sign in as ${name} instead of ${now}?"
    onClose=${() => app.admit(false)}>
    <p>You opened a login link of <b>${name}</b> (${role}). If you sign in, your answers are stored under that name.</p>
    <p>If you did not ask for this link, stay ${now}
      . Answers of ${now} that are not saved yet stay in this browser until ${now} is back.</p>
    <footer class="dialog__foot">
      <button class="button" onClick=${() => app.admit(true)}>Sign in as ${name}</button>
      <button class="button button--primary" autofocus onClick=${dialog.close}>Stay ${now}</button>
    </footer>
  <//>`;
}

/**
 * Asks once about answers that were faster than people look.
 * @param {{app: ReviewApp, boxIds: readonly number[]}} props
 */
function Streak({ app, boxIds }) {
  const { dataset } = useValue(app.topBar);
  const dialog = useDialog();
  const again = () => {
    dialog.close();
    app.router.go(linkTo("queue", { dataset }, { boxes: boxIds.join(",") }));
  };
  return html`<${Dialog} dialog=${dialog} id="streak-title" title="${boxIds.length} answers in two seconds"
    onClose=${() => app.streak.set(null)}>
    <p>
      That is faster than people look. The answers are saved, and each says for how long its box was on the screen. This
      question comes once.</p>
    <footer class="dialog__foot">
      <button class="button" onClick=${dialog.close}>I looked at each</button>
      <button class="button button--primary" autofocus onClick=${again}>Look at them again</button>
    </footer>
  <//>`;
}

/** @param {{app: ReviewApp, linkError: string}} props */
function SignIn({ app, linkError }) {
  useTitle("Sign in");
  const kept = [...app.kept()];
  const ended = useValue(app.ended);
  const { run, isBusy, error } = useTask(async (/** @type {string} */ text) => {
    if (!text) throw new Error("Paste the token or the link first.");
    // A code, in a link or alone; else a token.
    const code = loginOf(text.slice(Math.max(0, text.indexOf("#"))))?.code || (text.startsWith("uc_") && text);
    await app.signIn(code ? { code } : { token: text });
  });
  const refusal = error?.message ?? (isBusy ? "" : linkError);

  /** @param {SubmitEvent & {currentTarget: HTMLFormElement}} event */
  const submit = (event) => {
    event.preventDefault();
    void run(String(new FormData(event.currentTarget).get("token") ?? "").trim());
  };

  return html`<main id="main" class="signin" tabindex="-1">
    <form class="signin__card" onSubmit=${submit} novalidate>
      <${Mark} />
      <h1>Sign in to Unghost</h1>
      ${ended && html`<p class="signin__note" role="status">${ended}</p>`}
      <p>
        Open a login link, or paste it or a token here. <code>unghost login
        </code> prints a link; so does the server when it starts.</p>
      ${kept.map(
        ([name, count]) => html`<p key=${name} class="signin__note" role="status">
          ${countOf(count, "answer")} of ${name} kept in this browser will be saved when ${name} signs in.</p>`,
      )}
      <label class="field">
        <span>Token or login link</span>
        <input name="token" type="password" autocomplete="current-password" spellcheck=${false}
          aria-invalid=${refusal !== ""} aria-describedby="token-error" autofocus />
      </label>
      <p id="token-error" class="field__error" role="alert">${refusal}</p>
      <button class="button button--primary" disabled=${isBusy}>${isBusy ? "Signing in…" : "Sign in"}</button>
      <p class="faint">
        A link works once, within ten minutes. Without one, ask whoever runs this server: <code>unghost login
        </code> prints another link, and <code>unghost token create NAME</code> makes a token for a guest. The <a
          href="/docs">description of the API</a> is open to all.</p>
    </form>
  </main>`;
}

/** @param {{app: ReviewApp & UploadApp}} props */
function Toasts({ app }) {
  const toasts = useValue(app.toasts.list);
  return html`<div class="toasts">
    ${toasts.map(
      ({
        id,
        kind,
        text,
        action,
      }) => html`<div key=${id} class="toast toast--${kind}" role=${kind === "error" ? "alert" : "status"}>
        <${Icon} name=${kind === "error" ? "warn" : "check"} />
        <span class="toast__text">${text}</span>
        ${
          action?.href &&
          html`<a class="button button--small" href=${action.href}
            onClick=${() => app.toasts.dismiss(id)}>${action.text}</a>`
        }
        ${
          action?.run &&
          html`<button class="button button--small"
            onClick=${() => (app.toasts.dismiss(id), action.run?.())}>${action.text}</button>`
        }
        <button class="button button--quiet button--icon" aria-label="Dismiss"
          onClick=${() => app.toasts.dismiss(id)}><${Icon} name="cross" /></button>
      </div>`,
    )}
  </div>`;
}
