"""How long does it take in the queue from an answer until the next box is shown?

    python -m benchmarks.bench_page_queue [--answers 100] [--pause-ms 300] [--json]

A real server, a real Chromium without a graphics card, 1440 x 900, in random order:
nearly every box is on another frame of 1280 x 720 than the one before. The page marks
the moment of the key press and the one after the next box was drawn with its image;
these are the page's own performance measures. `--pause-ms` is the pause before each
answer; with 0 the key is pressed as soon as the next box is shown.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any, Final, cast

import cv2
import httpx
import numpy as np
from playwright.sync_api import Page, StorageState, ViewportSize

from benchmarks.street import HEIGHT, WIDTH, street
from tests.support.page.windows import launched
from tests.support.servers import RunningServer, running_server

DATASET: Final = "queue"
FRAMES: Final = 60
BOXES_PER_FRAME: Final = 30
WARM_UP: Final = 5
AIM_MS: Final = 100.0
SIZE: Final[ViewportSize] = {"width": 1440, "height": 900}
SHOWN: Final = "() => document.querySelector('.stage')?.dataset.picture === 'shown'"
MEASURED: Final = (
    "(count) => performance.getEntriesByName('queue:next').length >= count"
)
TIMES: Final = (
    "performance.getEntriesByName('queue:next').map((entry) => entry.duration)"
)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--answers", type=int, default=100)
    parser.add_argument("--pause-ms", type=int, default=300)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with (
        tempfile.TemporaryDirectory() as folder,
        running_server(Path(folder) / "data", anew=True) as server,
    ):
        upload(server)
        times = answered(server, options.answers, options.pause_ms)
    figures = summary(times)
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        for name, value in figures.items():
            print(f"{name:58} {value:8.1f}")
    return 0


def upload(server: RunningServer) -> None:
    """Store frames with different images."""
    base = f"{server.url}/api/v1"
    with httpx.Client(base_url=base, headers=server.headers, timeout=60) as client:
        client.post("/datasets", json={"name": DATASET}).raise_for_status()
        segmentation = street().png
        for number in range(FRAMES):
            files: dict[str, tuple[str, bytes | str, str]] = {
                "image": ("image.png", photograph(number), "image/png"),
                "segmentation": ("seg.png", segmentation, "image/png"),
                "annotation": ("a.json", annotation(number), "application/json"),
            }
            path = f"/datasets/{DATASET}/frames/{number:06d}"
            client.put(path, files=files).raise_for_status()


def photograph(number: int) -> bytes:
    """Soft shapes under noise: as hard to decode as a rendered street."""
    rng = np.random.default_rng(number)
    small = rng.integers(40, 220, (HEIGHT // 24, WIDTH // 24, 3)).astype(np.uint8)
    smooth = cv2.resize(small, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    noisy = smooth + rng.normal(0, 3, smooth.shape)
    return cv2.imencode(".png", noisy.clip(0, 255).astype(np.uint8))[1].tobytes()


def annotation(number: int) -> str:
    rng = np.random.default_rng(1000 + number)
    sides = np.exp(rng.uniform(np.log(16), np.log(240), (BOXES_PER_FRAME, 2)))
    corners = rng.uniform(0, 1, sides.shape) * (np.array([WIDTH, HEIGHT]) - sides)
    xyxy = np.hstack([corners, corners + sides]).round(2).tolist()
    boxes: list[dict[str, Any]] = [
        {"id": str(n), "class": "car", "xyxy": one} for n, one in enumerate(xyxy, 1)
    ]
    return json.dumps({"boxes": boxes})


def answered(server: RunningServer, count: int, pause_ms: int) -> list[float]:
    """Milliseconds from each of the answers to the next box."""
    with launched() as browser:
        state = cast("StorageState", server.signed_in())
        page = browser.new_context(viewport=SIZE, storage_state=state).new_page()
        page.goto(f"{server.url}/#/datasets/{DATASET}/queue?order=random")
        page.wait_for_function(SHOWN)
        times = answer_all(page, count + WARM_UP, pause_ms)
    return times[WARM_UP:]


def answer_all(page: Page, count: int, pause_ms: int) -> list[float]:
    for number in range(count):
        page.wait_for_timeout(pause_ms)
        page.keyboard.press("a" if number % 3 else "x")
        page.wait_for_function(MEASURED, arg=number + 1)
    times: list[float] = page.evaluate(TIMES)
    return times


def summary(times: list[float]) -> dict[str, float]:
    middle, high = np.percentile(times, [50, 95])
    return {
        "answers": float(len(times)),
        "answer to next box, median [ms]": float(middle),
        "answer to next box, 95th percentile [ms]": float(high),
        "answer to next box, longest [ms]": float(max(times)),
        "answer to next box, 95th percentile: aim, at most [ms]": AIM_MS,
    }


if __name__ == "__main__":
    sys.exit(main())
