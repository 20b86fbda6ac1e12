"""How fast is the review page with 500 boxes in a frame, and with 10,000 frames?

    python -m benchmarks.bench_page [--boxes 500] [--frames 10000] [--json]

A real server and a real Chromium without a graphics card, 1440 x 900. Panning and
zooming are done with the mouse; their figure is processor time of the page's main
thread per animation frame, from Chromium's own trace. The list of frames is opened in a
browser without any cached part of the page.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any, Final, cast

import cv2
import httpx
import numpy as np
from playwright.sync_api import (
    Browser,
    Page,
    StorageState,
    ViewportSize,
)
from sqlalchemy import insert, select

from app.catalog.datasets import DatasetRepository
from app.db.tables import Frame, FrameFile
from benchmarks.page_trace import milliseconds_per_frame
from benchmarks.street import HEIGHT, WIDTH, street
from tests.support.large_datasets import BOXES_PER_FRAME, NAME, fill, open_context
from tests.support.page.windows import launched
from tests.support.servers import RunningServer, running_server

IMAGES: Final = 24
MOVES: Final = 90
REPEATS: Final = 5
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boxes", type=int, default=500)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        with running_server(
            data, {"UNGHOST_LOG_LEVEL": "warning"}, anew=True
        ) as server:
            crowd, digests = upload_images(server, options.boxes)
            fill_with_images(data, options.frames, digests)
            figures = measured(server, crowd)
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        for name, value in figures.items():
            print(f"{name:64} {value:8.2f}")
    return 0


def upload_images(server: RunningServer, boxes: int) -> tuple[int, list[str]]:
    """Store a frame full of boxes, and different images: its id, and their digests."""
    base = f"{server.url}/api/v1"
    with httpx.Client(base_url=base, headers=server.headers, timeout=60) as client:
        client.post("/datasets", json={"name": "crowd"}).raise_for_status()
        ids = [_put(client, n, boxes if n == 0 else 1) for n in range(IMAGES)]
        frames = [client.get(f"/frames/{one}").json() for one in ids]
    return ids[0], [frame["files"]["image"]["sha256"] for frame in frames]


def _put(client: httpx.Client, number: int, boxes: int) -> int:
    annotation = json.dumps({"boxes": _boxes(boxes)})
    files: dict[str, tuple[str, bytes | str, str]] = {
        "image": ("image.png", _photograph(number), "image/png"),
        "segmentation": ("seg.png", street().png, "image/png"),
        "annotation": ("a.json", annotation, "application/json"),
    }
    answer = client.put(f"/datasets/crowd/frames/{number:06d}", files=files)
    answer.raise_for_status()
    found: int = answer.json()["frame"]["id"]
    return found


def _boxes(count: int) -> list[dict[str, Any]]:
    """From a handful of large ones to crowds of small ones, as a long street has."""
    rng = np.random.default_rng(11)
    sides = np.exp(rng.uniform(np.log(12), np.log(280), (count, 2)))
    corners = rng.uniform(0, 1, (count, 2)) * (np.array([WIDTH, HEIGHT]) - sides)
    xyxy = np.hstack([corners, corners + sides]).round(2).tolist()
    return [
        {"id": str(n), "class": "car", "xyxy": one} for n, one in enumerate(xyxy, 1)
    ]


def _photograph(number: int) -> bytes:
    rng = np.random.default_rng(number)
    small = rng.integers(40, 220, (HEIGHT // 24, WIDTH // 24, 3)).astype(np.uint8)
    smooth = cv2.resize(small, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    noisy = smooth + rng.normal(0, 3, smooth.shape)
    return cv2.imencode(".png", noisy.clip(0, 255).astype(np.uint8))[1].tobytes()


def fill_with_images(data: Path, frames: int, digests: list[str]) -> None:
    """Make a dataset of many frames that share the images."""
    context = open_context(data)
    fill(context, frames * BOXES_PER_FRAME, lambda _: None)
    with context.database.write() as session:
        dataset = DatasetRepository(session).named(NAME)
        ids = session.scalars(select(Frame.id).where(Frame.dataset_id == dataset.id))
        rows = [
            {"frame_id": id_, "kind": "image", "sha256": digests[n % len(digests)]}
            for n, id_ in enumerate(ids)
        ]
        session.execute(insert(FrameFile), rows)
    context.close()
    context.database.close()


def measured(server: RunningServer, crowd: int) -> dict[str, float]:
    with launched() as browser:
        return {
            **moved(visit(browser, server), f"{server.url}/#/frames/{crowd}"),
            **first_views(browser, server),
        }


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
            figures[f"{what}{name}, main thread per frame, median [ms]"] = float(
                np.median(times)
            )
            figures[f"{what}{name}, main thread per frame, 95 % [ms]"] = float(
                np.percentile(times, 95)
            )
        page.keyboard.press("f")
    return figures


def pan(page: Page) -> None:
    _over_the_stage(page)
    page.mouse.down()
    for n in range(MOVES):
        page.mouse.move(720 + 160 * np.sin(n / 9), 450 + 90 * np.cos(n / 7))
        page.wait_for_timeout(8)
    page.mouse.up()


def zoom(page: Page) -> None:
    _over_the_stage(page)
    for n in range(MOVES):
        page.mouse.wheel(0, -60 if n % 30 < 15 else 60)
        page.wait_for_timeout(8)


def _over_the_stage(page: Page) -> None:
    page.mouse.move(720, 540)


def first_views(browser: Browser, server: RunningServer) -> dict[str, float]:
    """Open the list of frames without a cache; at first there are no thumbnails."""
    link = f"{server.url}/#/datasets/{NAME}/frames"
    cold, *warm = [first_view(visit(browser, server), link) for _ in range(REPEATS)]
    return {
        "first view of the frames, cards [ms]": float(np.median([w[0] for w in warm])),
        "first view, with the visible thumbnails [ms]": float(
            np.median([w[1] for w in warm])
        ),
        "the first one, which makes the thumbnails [ms]": cold[1],
    }


def first_view(page: Page, link: str) -> tuple[float, float]:
    page.goto(link, wait_until="commit")
    cards = _when(page, CARDS)
    images = _when(page, IMAGES_IN_VIEW)
    page.context.close()
    return cards, images


def _when(page: Page, condition: str) -> float:
    at: float = page.wait_for_function(condition).json_value()
    return at


if __name__ == "__main__":
    sys.exit(main())
