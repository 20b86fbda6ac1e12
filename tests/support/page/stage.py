"""Reads the pixels and the view of the stage, the canvas that shows a frame."""

from base64 import b64decode
from collections.abc import Sequence

import cv2
import numpy as np
from playwright.sync_api import FloatRect, Locator, Page

from tests.support.page.scenes import GREY

READ_LAYER = """(name) =>
  document.querySelector(`.stage__layer--${name}`).toDataURL("image/png")"""


def layer(page: Page, name: str) -> np.ndarray:
    """The pixels of the `base` or the `top` layer, (H, W, 4) RGBA.

    The browser sends them as a PNG: it is a hundredth of the size of all numbers.
    """
    _, _, content = page.evaluate(READ_LAYER, name).partition(",")
    stored = np.frombuffer(b64decode(content), np.uint8)
    pixels = cv2.imdecode(stored, cv2.IMREAD_UNCHANGED)
    assert pixels is not None
    return cv2.cvtColor(pixels, cv2.COLOR_BGRA2RGBA)


def view(page: Page) -> tuple[float, float, float]:
    """Scale and origin: stage px = image px * scale + origin."""
    text = page.locator(".stage").get_attribute("data-view") or ""
    scale, x, y = map(float, text.split())
    return scale, x, y


def bounds(element: Locator) -> FloatRect:
    """The rectangle of an element that is shown, in px of the window."""
    box = element.bounding_box()
    assert box is not None
    return box


def point(page: Page, x: float, y: float) -> tuple[float, float]:
    """The place in the window of a place in the image, in px."""
    scale, x0, y0 = view(page)
    corner = bounds(page.locator(".stage"))
    return corner["x"] + x * scale + x0, corner["y"] + y * scale + y0


def drawings(page: Page) -> int:
    """How often the stage has been drawn."""
    return int(page.locator(".stage").get_attribute("data-drawn") or 0)


def wait_for_drawing(page: Page) -> None:
    """Wait for two animation frames, by which all pending drawing is done."""
    page.evaluate(
        "() => new Promise((done) => requestAnimationFrame("
        "() => requestAnimationFrame(done)))"
    )


def edge_contrast(page: Page, xyxy: Sequence[int]) -> float:
    """How much the drawn lower edge of a box differs from the picture's grey."""
    scale, x0, y0 = view(page)
    row = round(xyxy[3] * scale + y0)
    left, right = (round(x * scale + x0) for x in (xyxy[0] + 60, xyxy[2] - 10))
    drawn = layer(page, "base")[row - 3 : row + 3, left:right, :3].astype(float)
    return float(np.abs(drawn - GREY).max())


def edge_runs(page: Page, xyxy: tuple[int, ...]) -> int:
    """How many strokes a box's lower edge has: 1 if solid, many if dashed."""
    scale, x0, y0 = view(page)
    base = layer(page, "base").astype(int)
    row = round(xyxy[3] * scale + y0)
    left, right = (round(x * scale + x0) for x in (xyxy[0], xyxy[2]))
    pixels = base[row - 1 : row + 1, left + 4 : right - 4, :3]
    inked = (np.abs(pixels - GREY).max(axis=(0, 2)) > 60).astype(int)
    return int((np.diff(inked, prepend=0) == 1).sum())
