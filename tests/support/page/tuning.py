"""Makes boxes with a known match, and moves and reads the page's histograms."""

from typing import Any

import cv2
import numpy as np
from playwright.sync_api import Locator, Page

from tests.support.page import scenes
from tests.support.page.scenes import Scene
from tests.support.page.stage import bounds

LEFT, RIGHT = 40, 20
"""The widths of the axis and of the padding beside the plot, in px of the page."""


def car_at(share: int, index: int) -> dict[str, Any]:
    """A box of the size of the scene's car, moved up to match `share` percent."""
    x0, y0, x1, y1 = scenes.CAR
    up = (y1 - y0) * (100 - share) // 100
    return {
        "id": f"car-{share}",
        "class": "car",
        "xyxy": (x0, y0 - up, x1, y1 - up),
        "distance": 10 + index,
    }


def applied_config(scene: Scene) -> dict[str, Any]:
    """The active configuration of the dataset."""
    response = scene.http.get(f"/datasets/{scene.dataset}/config")
    config: dict[str, Any] = response.json()["config"]
    return config


def dragged(page: Page, handle: Locator, *, to: float) -> None:
    """Drag a handle of a threshold with the mouse to a percentage of its track."""
    handle.hover()  # waits until the page has stopped to move it
    own, track = bounds(handle), bounds(handle.locator(".."))
    y = own["y"] + own["height"] / 2
    page.mouse.move(own["x"] + own["width"] / 2, y)
    page.mouse.down()
    page.mouse.move(track["x"] + track["width"] * to / 200, y, steps=4)
    page.mouse.move(track["x"] + track["width"] * to / 100, y, steps=6)
    page.mouse.up()


def count_bar_colours(canvas: Locator, *, percent: float) -> int:
    """How many colours the histogram's bar at a percentage has."""
    drawn = canvas.screenshot()
    pixels = cv2.imdecode(np.frombuffer(drawn, np.uint8), cv2.IMREAD_COLOR)
    assert pixels is not None
    width = pixels.shape[1]
    x = LEFT + (width - LEFT - RIGHT) * percent / 100
    bar = pixels[-60:-30, int(x) : int(x) + 1].reshape(-1, 3)
    return len(np.unique(bar, axis=0))
