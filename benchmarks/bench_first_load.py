"""How long is the way from a login link to the first question over a slow line?

    python -m benchmarks.bench_first_load [--data FOLDER] [--repeats 3] [--json]

The demo on a real server, and a real Chromium, 1440 x 900, over a line of 60 ms and
9 Mbit/s (Chromium's own throttling). Each repeat is a new window with nothing cached,
in which no time is lost for thinking: the login link, the demo, "Start review", until
the first question is painted; ten answers, one every 0.7 s; the grid, for whose crops
nothing was drawn before; the grid loaded again. Medians are printed. `--data` keeps the
rendered demo for the next time. Of the first fifty questions it also says how many
are about errors of the filter: by the truth that is rendered with the street, for which
an object of which one pixel is seen is visible.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from http import HTTPStatus
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

import numpy as np
from playwright.sync_api import Browser, Page, ViewportSize

from tests.support.page.windows import launched
from tests.support.servers import RunningServer, running_server
from unghost import Client

LATENCY_MS: Final = 60
BYTES_PER_S: Final = 9_000_000 / 8
SIZE: Final[ViewportSize] = {"width": 1440, "height": 900}
ANSWERS: Final = 10
PAUSE_MS: Final = 700
QUIET_TIMES: Final = 5
CROPS: Final = 32
QUESTIONS: Final = 50
DATASETS: Final = ("demo", "demo-by-tags")
PAINTED: Final = """() => {
  const stage = document.querySelector(".stage");
  return stage?.dataset.box && stage.dataset.painted === stage.dataset.box;
}"""
ANSWERED: Final = (
    "(count) => performance.getEntriesByName('queue:next').length >= count"
)
TIMES: Final = (
    "performance.getEntriesByName('queue:next').map((entry) => entry.duration)"
)
CROPS_SHOWN: Final = """(count) => {
  const shown = [...document.querySelectorAll(".cell__image")];
  return shown.filter((image) => image.complete && image.naturalWidth).length >= count;
}"""
AIMS: Final = {
    "link to the first question [s]": 2.5,
    "link to the first question, requests": 40.0,
    "answer to the next question, longest [ms]": 150.0,
    "grid of 32 crops, nothing drawn yet [s]": 0.6,
    "grid loaded again, files and pictures fetched": 0.0,
}


class Traffic:
    """What a page asks the server for, as Chromium counts it."""

    def __init__(self, page: Page) -> None:
        self._session = page.context.new_cdp_session(page)
        self.sent: dict[str, dict[str, Any]] = {}
        self._session.send("Network.enable")
        conditions = {
            "offline": False,
            "latency": LATENCY_MS,
            "downloadThroughput": BYTES_PER_S,
            "uploadThroughput": BYTES_PER_S,
        }
        self._session.send("Network.emulateNetworkConditions", conditions)
        self._session.on("Network.requestWillBeSent", self._begin)
        self._session.on("Network.requestServedFromCache", self._skip)
        self._session.on("Network.responseReceived", self._receive)
        self._session.on("Network.loadingFinished", self._end)
        self._session.on("Network.loadingFailed", self._fail)

    def _begin(self, event: dict[str, Any]) -> None:
        if not event["request"]["url"].startswith(("blob:", "data:")):
            self.sent[event["requestId"]] = {
                "url": event["request"]["url"],
                "began": event["timestamp"],
            }

    def _skip(self, event: dict[str, Any]) -> None:
        self.sent.pop(event["requestId"], None)

    def _receive(self, event: dict[str, Any]) -> None:
        if event["requestId"] in self.sent:
            response = event["response"]
            if response.get("fromDiskCache") or response.get("fromPrefetchCache"):
                del self.sent[event["requestId"]]
                return
            self.sent[event["requestId"]]["status"] = response["status"]

    def _end(self, event: dict[str, Any]) -> None:
        if event["requestId"] in self.sent:
            self.sent[event["requestId"]] |= {
                "ended": event["timestamp"],
                "bytes": event["encodedDataLength"],
            }

    def _fail(self, event: dict[str, Any]) -> None:
        if event["requestId"] in self.sent:
            self.sent[event["requestId"]]["failed"] = True

    def is_quiet(self) -> bool:
        """Whether no request is under way."""
        return all("ended" in one or "failed" in one for one in self.sent.values())

    def taken(self) -> list[dict[str, Any]]:
        """The requests since the last call, in their order."""
        requests = list(self.sent.values())
        self.sent.clear()
        return requests


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder of the rendered demo")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--waterfall", action="store_true", help="print each request")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        data = options.data or Path(folder, "data")
        render(data)
        with running_server(data, anew=True) as server, launched() as browser:
            found = {
                f"errors among the first {QUESTIONS} questions of {name}": errors_found(
                    server, name
                )
                for name in DATASETS
            }
            draw(server)
            runs = [
                measured(server, browser, options.waterfall)
                for _ in range(options.repeats)
            ]
    figures = {name: float(np.median([run[name] for run in runs])) for name in runs[0]}
    figures |= found
    figures |= {f"{name}: aim, at most": most for name, most in AIMS.items()}
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        for name, value in figures.items():
            print(f"{name:62} {value:8.2f}")
    return 0


def render(data: Path) -> None:
    words = ["demo", "--data", str(data), "--port", "0", "--exit-when-ready"]
    subprocess.run(
        [sys.executable, "-m", "unghost.cli", *words], check=True, stdout=sys.stderr
    )


def draw(server: RunningServer) -> None:
    """Let the service draw a picture, as one that has run for a while has done."""
    with Client(server.url, server.token) as client:
        frame = next(iter(client.frames(DATASETS[0])))
        client.thumbnail(frame.id)


def errors_found(server: RunningServer, dataset: str) -> float:
    """How many of the first questions are about boxes that are decided wrongly."""
    (truth,) = server.data.glob("demo/*/truth.jsonl")
    rows = map(json.loads, truth.read_text().splitlines())
    visible: dict[tuple[str, str], bool] = {
        (row["key"], row["id"]): row["visible_pixels"] > 0 for row in rows
    }
    with Client(server.url, server.token) as client:
        asked = client.queue(dataset, limit=QUESTIONS, filters={"bin": "ask"})
    return sum(
        (box.verdict == "kept") != visible[box.frame, box.id] for box in asked.items
    )


def measured(
    server: RunningServer, browser: Browser, is_listed: bool
) -> dict[str, float]:
    """The way of one visitor."""
    shutil.rmtree(server.data / "pictures", ignore_errors=True)
    context = browser.new_context(viewport=SIZE, reduced_motion="reduce")
    page = context.new_page()
    traffic = Traffic(page)
    found: dict[str, float] = {}

    def timed(name: str, act: Callable[[], object]) -> list[dict[str, Any]]:
        began = time.perf_counter()
        act()
        found[f"{name} [s]"] = time.perf_counter() - began
        found[f"{name}, requests"] = len(traffic.sent)
        settle(page, traffic)
        requests = traffic.taken()
        found[f"{name}, requests with those ahead"] = len(requests)
        found[f"{name} [kB]"] = sum(one.get("bytes", 0) for one in requests) / 1000
        if is_listed:
            show(name, requests)
        return requests

    link = server.login_link
    timed("link to the first question", lambda: open_first_question(page, link))
    times = answered(page)
    found["answer to the next question, median [ms]"] = float(np.median(times))
    found["answer to the next question, longest [ms]"] = max(times)
    found["answers a minute at that pace"] = 60_000 / (PAUSE_MS + float(np.mean(times)))
    page.locator(".savestate--saved").wait_for()
    settle(page, traffic)
    traffic.taken()
    first = timed("grid of 32 crops, nothing drawn yet", lambda: open_grid(page))
    again = timed("grid loaded again", lambda: load_again(page))
    known = {one["url"] for one in first}
    twice = [one for one in again if one.get("status") == HTTPStatus.OK]
    files = [one for one in twice if is_file(one["url"], known)]
    found["grid loaded again, files and pictures fetched"] = len(files)
    context.close()
    return found


def settle(page: Page, traffic: Traffic) -> None:
    """Wait until nothing was under way for a while."""
    quiet = 0
    while quiet < QUIET_TIMES:
        page.wait_for_timeout(LATENCY_MS)
        quiet = quiet + 1 if traffic.is_quiet() else 0


def open_first_question(page: Page, link: str) -> None:
    page.goto(link, wait_until="commit")
    page.locator("a[href='#/datasets/demo']").first.click()
    page.get_by_role("link", name="Start review").click()
    page.wait_for_function(PAINTED)


def answered(page: Page) -> list[float]:
    """Milliseconds from each of some answers to the next box; they are undone."""
    page.wait_for_timeout(PAUSE_MS)
    lesson = page.get_by_role("button", name="Skip the lesson")
    if lesson.count():  # for whoever answers his first box
        lesson.click()
        page.wait_for_function(PAINTED)
    for number in range(ANSWERS):
        page.wait_for_timeout(PAUSE_MS)
        page.keyboard.press("a" if number % 3 else "x")
        page.wait_for_function(ANSWERED, arg=number + 1)
    times: list[float] = page.evaluate(TIMES)
    for _ in range(ANSWERS):
        page.keyboard.press("z")
    return times


def open_grid(page: Page) -> None:
    page.evaluate("location.hash = '#/datasets/demo/grid?verdict=rejected'")
    page.wait_for_function(CROPS_SHOWN, arg=CROPS)


def load_again(page: Page) -> None:
    page.reload(wait_until="commit")
    page.wait_for_function(CROPS_SHOWN, arg=CROPS)


def is_file(url: str, known: set[str]) -> bool:
    """Whether an address is of a file of the page, or of a picture that was there."""
    path = urlsplit(url).path
    return path.startswith("/static/") or (url in known and "v=" in url)


def show(name: str, requests: list[dict[str, Any]]) -> None:
    print(name, file=sys.stderr)
    begin = min((one["began"] for one in requests), default=0)
    for one in requests:
        ms = [1000 * (one[key] - begin) for key in ("began", "ended") if key in one]
        times = " to ".join(f"{value:5.0f}" for value in ms)
        size = one.get("bytes", 0) / 1000
        print(f"  {times} ms {size:7.1f} kB  {one['url'][:110]}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
