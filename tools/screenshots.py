"""Takes the pictures of the review page for the README and the documentation.

    python -m tools.screenshots [--data FOLDER] [NAME ...]

Serves the demo, lets two made-up reviewers answer some boxes, and writes
`docs/pictures/NAME-light.webp` and `NAME-dark.webp`. A picture is a row of `PICTURES`.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal

import cv2
import numpy as np
from playwright.sync_api import Browser, Page, ViewportSize, expect, sync_playwright

from tools.demo_life import DATASET, add_activity
from tools.ensure_chromium import system_chromium
from unghost import Client, Decision

ROOT: Final = Path(__file__).resolve().parents[1]
FOLDER: Final = ROOT / "docs" / "pictures"
WIDE: Final[ViewportSize] = {"width": 1440, "height": 900}
NARROW: Final[ViewportSize] = {"width": 390, "height": 844}
SCHEMES: Final[tuple[Literal["light", "dark"], ...]] = ("light", "dark")
WEBP_QUALITY: Final = 80
_MOSTLY: Final = 80
"""Percent of a box that shows objects of its class."""
PICTURES_SHOWN: Final = """() => !document.querySelector("[aria-busy=true]")
  && [...document.images].every((image) =>
    (image.complete && image.naturalWidth > 0)
    || image.getBoundingClientRect().top > innerHeight)"""
CROPS_SHOWN: Final = """() => document.querySelector(".cell__image")
  && ![...document.querySelectorAll(".cell__none.shimmer")].some((cell) => {
    const { top, bottom } = cell.getBoundingClientRect();
    return bottom > 0 && top < innerHeight;
  })
  && [...document.querySelectorAll(".cell__image")].every(
    (image) => image.complete && image.naturalWidth)"""
STAGE: Final = ".stage[data-picture=shown]"


@dataclass(frozen=True)
class Picture:
    """What to open, what shows that it is there, and what to do before the picture.

    `link` may name ``{frame}`` and ``{box}``: the ghost that shows best.
    """

    name: str
    link: str
    ready: str
    size: ViewportSize = field(default_factory=lambda: WIDE)
    act: Callable[[Page], None] = lambda _: None


def _close_up(page: Page) -> None:
    page.keyboard.press("c")
    page.wait_for_timeout(400)


def _skip_lesson(page: Page) -> None:
    page.get_by_role("button", name="Skip the lesson").click()
    page.wait_for_timeout(2500)


def _keep(page: Page) -> None:
    """Answer the first box of the lesson that has no answer."""
    expect(page.locator(STAGE)).to_be_visible()
    page.wait_for_timeout(400)
    page.keyboard.press("a")
    expect(page.locator(".coach--right, .coach--wrong")).to_be_visible()
    page.keyboard.press("j")
    page.wait_for_timeout(1500)
    page.keyboard.press("a")
    page.wait_for_timeout(1500)


_GRID: Final = f"#/datasets/{DATASET}/grid?verdict=rejected"
_QUEUE: Final = f"#/datasets/{DATASET}/queue"
_QUALITY: Final = f"#/datasets/{DATASET}/quality"
_THRESHOLDS: Final = (
    f"#/datasets/{DATASET}/thresholds"
    "?threshold_small_box=16&classes.traffic_light.threshold_small_box=2"
)


def _all_crops(page: Page) -> None:
    """Wait until all crops are loaded; cells shimmer until theirs is."""
    page.wait_for_function(CROPS_SHOWN, timeout=60_000)


PICTURES: Final = (
    Picture("datasets", "#/datasets", ".card img"),
    Picture("frames", f"#/datasets/{DATASET}/frames", "a.thumb img"),
    Picture("frame", "#/frames/{frame}?box={box}", STAGE),
    Picture("frame-crop", "#/frames/{frame}?box={box}", STAGE, act=_close_up),
    Picture("queue", _QUEUE, STAGE, act=_skip_lesson),
    Picture("home", f"#/datasets/{DATASET}", ".compare__box--kept"),
    Picture("compare", "#/frames/{frame}/compare", ".compare__box--kept"),
    Picture("lesson", _QUEUE, ".coach", act=_keep),
    Picture("grid", _GRID, "main img", act=_all_crops),
    Picture("thresholds", _THRESHOLDS, ".flip img"),
    Picture("quality", _QUALITY, ".curve__drawing canvas"),
    Picture("runs", f"#/datasets/{DATASET}/runs", "main article"),
    Picture("thresholds-narrow", _THRESHOLDS, ".flip img", NARROW),
    Picture("frame-narrow", "#/frames/{frame}?box={box}", STAGE, NARROW),
    Picture("queue-narrow", _QUEUE, STAGE, NARROW, act=_skip_lesson),
    Picture("frames-narrow", f"#/datasets/{DATASET}/frames", "a.thumb img", NARROW),
    Picture("datasets-narrow", "#/datasets", ".card img", NARROW),
    Picture("grid-narrow", _GRID, "main img", NARROW, act=_all_crops),
    Picture("quality-narrow", _QUALITY, ".curve__drawing canvas", NARROW),
    Picture("runs-narrow", f"#/datasets/{DATASET}/runs", "main article", NARROW),
)


def main() -> None:
    """Take all pictures, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=ROOT / "build" / "screenshots")
    parser.add_argument("names", nargs="*", metavar="NAME")
    options = parser.parse_args()
    wanted = [one for one in PICTURES if not options.names or one.name in options.names]
    FOLDER.mkdir(parents=True, exist_ok=True)
    with served_demo(options.data) as url, launched() as browser:
        token = (options.data / "token").read_text("utf-8").strip()
        add_activity(url, token)
        with Client(url, token) as client:
            box = best_ghost(client)
            for picture in wanted:
                for scheme in SCHEMES:
                    code = client.create_login_code().code
                    take(browser, f"{url}/#code={code}", picture, box, scheme)


@contextmanager
def served_demo(data: Path) -> Iterator[str]:
    """The address of a demo of our own, rendered the first time."""
    data.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "unghost.cli", "demo", "--port", "0"]
    command += ["--data", str(data)]
    # The page is there before the frames are.
    subprocess.run([*command, "--exit-when-ready"], check=True)
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        lines = (line.strip() for line in process.stdout)
        link = next((line for line in lines if "/#code=" in line), None)
        if link is None:
            raise RuntimeError("the demo ended before it was ready; see its messages")
        yield link.split()[-1].partition("/#")[0]
    finally:
        process.terminate()
        process.wait()


@contextmanager
def launched() -> Iterator[Browser]:
    """Chromium of the system, or Playwright's own."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=system_chromium(), args=["--no-sandbox", "--disable-gpu"]
        )
        yield browser
        browser.close()


def best_ghost(client: Client) -> Decision:
    """The largest box in which nothing but other objects of its class are seen."""
    found = client.boxes(DATASET, verdict="rejected", reason="hidden_by_instance")
    behind = (box for box in found if (box.match_percent or 0) > _MOSTLY)
    return max(behind, key=lambda box: box.area_percent or 0)


def take(
    browser: Browser,
    login_link: str,
    picture: Picture,
    box: Decision,
    scheme: Literal["light", "dark"],
) -> None:
    """One picture in one appearance, in a window of its own."""
    url = login_link.partition("/#")[0]
    context = browser.new_context(
        viewport=picture.size, color_scheme=scheme, reduced_motion="reduce"
    )
    page = context.new_page()
    page.goto(login_link)
    expect(page.locator(".shell")).to_have_attribute("data-view", "datasets")
    link = picture.link.format(frame=box.frame_id, box=box.box_id)
    page.goto(f"{url}/{link}")
    expect(page.locator(picture.ready).first).to_be_visible(timeout=30_000)
    page.wait_for_function(PICTURES_SHOWN, timeout=30_000)
    picture.act(page)
    page.wait_for_timeout(500)
    shot = page.screenshot(animations="disabled")
    path = FOLDER / f"{picture.name}-{scheme}.webp"
    # As WebP it has a tenth of the bytes, without a visible difference.
    pixels = cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR)
    assert pixels is not None
    flags = [cv2.IMWRITE_WEBP_QUALITY, WEBP_QUALITY]
    path.write_bytes(cv2.imencode(".webp", pixels, flags)[1].tobytes())
    sys.stdout.write(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1000:.0f} kB\n")
    context.close()


if __name__ == "__main__":
    main()
