"""How fast is the review page with 500 boxes in a frame, and with 10,000 frames?

    python -m benchmarks.bench_page [--boxes 500] [--frames 10000] [--json]

A real server and a real Chromium without a graphics card, 1440 x 900. Panning and
zooming are done with the mouse; their figure is processor time of the page's main
thread per animation frame, from Chromium's own trace. The list of frames is opened in a
browser without any cached part of the page.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from playwright.sync_api import Browser, Page, StorageState, ViewportSize
from sqlalchemy import insert, select

from app.catalog.datasets import DatasetRepository
from app.db.tables import Frame, FrameFile
from benchmarks.measuring import (
    client_of,
    opened,
    parser_of,
    served,
    show,
    store_million,
    store_pictures,
)
from tests.support.large_datasets import BOXES_PER_FRAME, NAME
from tests.support.page.windows import launched
from tests.support.servers import RunningServer

MOVES: Final = 90
REPEATS: Final = 5
FRAME_EVENT: Final = "FireAnimationFrame"
TASK_EVENTS: Final = ("ThreadControllerImpl::RunTask", "RunTask")
OVER_THE_STAGE: Final = (720, 540)
SIZE: Final[ViewportSize] = {"width": 1440, "height": 900}
READY = """() => document.querySelector(".stage")?.dataset.picture === "shown"
  && document.querySelector(".stage").dataset.view !== undefined"""
CARDS = (
    """() => document.querySelectorAll("a.thumb").length >= 60 && performance.now()"""
)
IMAGES_IN_VIEW = """() => {
  const shown = [...document.querySelectorAll("a.thumb img")].filter((image) =>
    image.getBoundingClientRect().top < innerHeight);
  const isThere = shown.length > 0 && shown.every((image) => image.complete);
  return isThere && performance.now();
}"""


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--boxes", type=int, default=500)
    parser.add_argument("--frames", type=int, default=10_000)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        boxes = [options.boxes, *[1] * 23]
        with served(data) as server:
            ids = store_pictures(server, "crowd", boxes)
            with client_of(server) as client:
                frames = [client.get(f"/frames/{frame_id}").json() for frame_id in ids]
            digests = [frame["files"]["image"]["sha256"] for frame in frames]
            fill_with_images(data, options.frames, digests)
            with launched() as browser:
                page = visit(browser, server)
                figures = {
                    **moved(page, f"{server.url}/#/frames/{ids[0]}"),
                    **first_views(browser, server),
                }
    show(figures, as_json=options.json)


def fill_with_images(data: Path, frames: int, digests: list[str]) -> None:
    """Make a dataset of many frames that share the images."""
    with opened(data) as context:
        store_million(context, frames * BOXES_PER_FRAME)
        with context.database.write() as session:
            dataset = DatasetRepository(session).named(NAME)
            of_dataset = Frame.dataset_id == dataset.id
            rows = [
                {"frame_id": frame_id, "kind": "image", "sha256": digest}
                for frame_id, digest in zip(
                    session.scalars(select(Frame.id).where(of_dataset)),
                    cycle(digests),
                    strict=False,
                )
            ]
            session.execute(insert(FrameFile), rows)


def visit(browser: Browser, server: RunningServer) -> Page:
    """A new window that is signed in and has no cached files."""
    state = cast("StorageState", server.signed_in())
    context = browser.new_context(
        viewport=SIZE, reduced_motion="reduce", storage_state=state
    )
    return context.new_page()


def moved(page: Page, url: str) -> dict[str, float]:
    """Pan and zoom: with nothing selected, with a box, with the mask."""
    page.goto(url)
    page.wait_for_function(READY)
    figures: dict[str, float] = {}
    for name, key in (("", ""), (", a box selected", "j"), (", mask on", "m")):
        if key:
            page.keyboard.press(key)
            page.wait_for_timeout(500)
        for what, gesture in (("pan", pan), ("zoom", zoom)):
            times = milliseconds_per_frame(page, partial(gesture, page))
            middle, high = np.percentile(times, [50, 95]).tolist()
            figures[f"{what}{name}, main thread per frame, median [ms]"] = middle
            figures[f"{what}{name}, main thread per frame, 95 % [ms]"] = high
        page.keyboard.press("f")
    return figures


def milliseconds_per_frame(page: Page, interact: Callable[[], None]) -> np.ndarray:
    """Processor time of the page's main thread while `interact` runs, frame by frame.

    It comes from Chromium's own trace. Everything counts that runs there from one
    animation frame to the next: events, scripts, layout, recording and, without a
    graphics card, painting of canvases.
    """
    events = traced(page, interact)
    mains = {
        (e["pid"], e["tid"])
        for e in events
        if e["name"] == "thread_name" and e["args"]["name"] == "CrRendererMain"
    }
    drawn = [(e["pid"], e["tid"]) for e in events if e["name"] == FRAME_EVENT]
    # The thread that draws: of all pages' main threads the busiest.
    thread = max(mains, key=drawn.count)
    own = [e for e in events if (e["pid"], e["tid"]) == thread]
    starts = np.array(sorted(e["ts"] for e in own if e["name"] == FRAME_EVENT))
    sums = np.zeros(len(starts) + 1)
    for task in own:
        if task["name"] in TASK_EVENTS and task["ph"] == "X":
            ends = task["ts"] + task["dur"]
            sums[np.searchsorted(starts, ends)] += task.get("tdur", task["dur"])
    # What lies before the first frame and after the last belongs to no frame.
    return sums[1:-1] / 1000


def traced(page: Page, interact: Callable[[], None]) -> list[dict[str, Any]]:
    """The events of Chromium's trace; their times are in microseconds."""
    session = page.context.new_cdp_session(page)
    config = {"includedCategories": ["toplevel", "devtools.timeline", "__metadata"]}
    streams: list[str] = []
    session.on("Tracing.tracingComplete", lambda done: streams.append(done["stream"]))
    session.send(
        "Tracing.start", {"transferMode": "ReturnAsStream", "traceConfig": config}
    )
    interact()
    session.send("Tracing.end")
    while not streams:
        page.wait_for_timeout(20)
    pieces, is_over = [], False
    while not is_over:
        piece = session.send("IO.read", {"handle": streams[0], "size": 1 << 22})
        pieces.append(piece["data"])
        is_over = piece["eof"]
    events: list[dict[str, Any]] = json.loads("".join(pieces))["traceEvents"]
    return events


def pan(page: Page) -> None:
    page.mouse.move(*OVER_THE_STAGE)
    page.mouse.down()
    for n in range(MOVES):
        page.mouse.move(720 + 160 * np.sin(n / 9), 450 + 90 * np.cos(n / 7))
        page.wait_for_timeout(8)
    page.mouse.up()


def zoom(page: Page) -> None:
    page.mouse.move(*OVER_THE_STAGE)
    for n in range(MOVES):
        page.mouse.wheel(0, -60 if n % 30 < 15 else 60)
        page.wait_for_timeout(8)


def first_views(browser: Browser, server: RunningServer) -> dict[str, float]:
    """Open the list of frames without a cache; at first there are no thumbnails."""
    link = f"{server.url}/#/datasets/{NAME}/frames"
    cold, *warm = [first_view(visit(browser, server), link) for _ in range(REPEATS)]
    cards, images = np.median(warm, axis=0).tolist()
    return {
        "first view of the frames, cards [ms]": cards,
        "first view, with the visible thumbnails [ms]": images,
        "the first one, which makes the thumbnails [ms]": cold[1],
    }


def first_view(page: Page, link: str) -> tuple[float, float]:
    page.goto(link, wait_until="commit")
    cards, images = (
        page.wait_for_function(condition).json_value()
        for condition in (CARDS, IMAGES_IN_VIEW)
    )
    page.context.close()
    return cards, images


if __name__ == "__main__":
    main()
