"""How far do counts lag behind a threshold that is dragged, over a million boxes?

    python -m benchmarks.bench_page_thresholds [--boxes 1000000] [--json]

A real server shows the dataset of `bench_runs.py` to a real browser. The handle is
dragged back and forth. For each of its values, the time is from the pointer's event
until the page shows the counts of that value, or of a later one.
"""

from __future__ import annotations

import statistics
from pathlib import Path

from playwright.sync_api import Locator, Page

from benchmarks.measuring import (
    DATA,
    opened,
    parser_of,
    quantile,
    served,
    show,
    store_million,
)
from tests.support.large_datasets import NAME
from tests.support.page.windows import WIDE, launched
from tests.support.servers import RunningServer

SWEEPS = 4
STEPS = 120
FROM, TO = 4, 60
"""The range in which the threshold is dragged, in percent."""

HANDLE = '[role=slider][aria-label="Threshold of all classes"]'

WATCH = """(selector) => {
  const handle = document.querySelector(selector);
  const summary = document.querySelector(".summary");
  const open = [];
  let moved = 0;
  window.lags = [];
  window.answers = 0;
  addEventListener("pointermove", (event) => { moved = event.timeStamp; }, true);
  new MutationObserver(() => {
    open.push({ value: handle.getAttribute("aria-valuenow"), at: moved });
  }).observe(handle, { attributeFilter: ["aria-valuenow"] });
  new MutationObserver(() => {
    const shown = summary.dataset.threshold;
    const known = open.findLastIndex(({ value }) => value === shown);
    const now = performance.now();
    window.answers += 1;
    window.lags.push(...open.splice(0, known + 1).map(({ at }) => now - at));
  }).observe(summary, { attributeFilter: ["data-threshold"] });
  window.waiting = () => open.length;
}"""

PREVIEW = """async ({ url, times }) => {
  const config = (await (await fetch(url + "/config")).json()).config;
  const took = [];
  for (let i = 0; i < times; i++) {
    config.threshold_small_box = 5 + i;
    const body = JSON.stringify({ config, limit: 0, bins: 200 });
    const headers = { "Content-Type": "application/json" };
    const begun = performance.now();
    const answer = await fetch(url + "/preview", { method: "POST", headers, body });
    await answer.json();
    took.push(performance.now() - begun);
  }
  return took;
}"""
SINGLE_PREVIEWS = 40


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--boxes", type=int, default=1_000_000)
    parser.add_argument("--data", type=Path, default=DATA)
    options = parser.parse_args()
    with opened(options.data) as context:
        store_million(context, options.boxes)
    with served(options.data) as server:
        figures = measured(server)
    show(figures, as_json=options.json)


def measured(server: RunningServer) -> dict[str, float]:
    """Lags of all values of all sweeps."""
    with launched() as browser:
        page = browser.new_page(viewport=WIDE)
        page.goto(server.login_link)
        page.goto(f"{server.url}/#/datasets/{NAME}/thresholds")
        handle = page.locator(HANDLE)
        handle.wait_for()
        page.locator('.summary:not([data-threshold=""])').wait_for()
        sweep(page, handle)
        page.evaluate(WATCH, HANDLE)
        for _ in range(SWEEPS):
            sweep(page, handle)
        while page.evaluate("window.waiting()"):
            page.wait_for_timeout(50)
        parameters = {"url": f"/api/v1/datasets/{NAME}", "times": SINGLE_PREVIEWS}
        alone: list[float] = page.evaluate(PREVIEW, parameters)
        lags: list[float] = page.evaluate("window.lags")
        answers: int = page.evaluate("window.answers")
    return {
        "values that the handle took": len(lags),
        "answers that were shown": answers,
        "pointer to counts, median [ms]": statistics.median(lags),
        "pointer to counts, p95 [ms]": quantile(lags, 0.95),
        "pointer to counts, longest [ms]": max(lags),
        "one preview alone, median [ms]": statistics.median(alone),
        "pointer to counts, median / one preview": (
            statistics.median(lags) / statistics.median(alone)
        ),
    }


def sweep(page: Page, handle: Locator) -> None:
    """Drag the handle up and down again, as fast as the page handles events."""
    own, track = handle.bounding_box(), handle.locator("..").bounding_box()
    if own is None or track is None:
        raise RuntimeError("the handle is not visible")
    y = own["y"] + own["height"] / 2
    page.mouse.move(own["x"] + own["width"] / 2, y)
    page.mouse.down()
    for percent in (TO, FROM):
        page.mouse.move(track["x"] + track["width"] * percent / 100, y, steps=STEPS)
    page.mouse.up()


if __name__ == "__main__":
    main()
