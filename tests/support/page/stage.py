"""Reads the pixels and the view of the stage, the canvas that shows a frame."""

from collections.abc import Sequence

import numpy as np
from playwright.sync_api import FloatRect, Locator, Page

from tests.support.page.scenes import GREY

READ_LAYER = """(name) => {
  const canvas = document.querySelector(`.stage__layer--${name}`);
  const { width, height } = canvas;
  const { data } = canvas.getContext("2d").getImageData(0, 0, width, height);
  let text = "";
  for (let i = 0; i < data.length; i += 32768)
    text += String.fromCharCode(...data.subarray(i, i + 32768));
  return { width, height, pixels: btoa(text) };
}"""


def layer(page: Page, name: str) -> np.ndarray:
    """The pixels of the `base` or the `top` layer, (H, W, 4) RGBA."""
    import base64

    drawn = page.evaluate(READ_LAYER, name)
    flat = np.frombuffer(base64.b64decode(drawn["pixels"]), np.uint8)
    return flat.reshape(drawn["height"], drawn["width"], 4)


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
