"""A frame's picture is the same in its frame, in the grid and as a thumbnail.

Pictures that programs show differently: turned by EXIF, or with an alpha channel.
"""

from itertools import count

import httpx
import numpy as np
import pytest
from playwright.sync_api import Locator, expect

from filter_core.segmentation.palettes import FAMILIES
from tests.support.page import scenes
from tests.support.page.stage import layer, view, wait_for_drawing
from tests.support.page.windows import Visitor
from tests.support.pictures import jpeg, png, with_alpha, with_orientation

pytestmark = pytest.mark.browser

WIDTH, HEIGHT = 320, 180
COLORS = np.array(
    [[[220, 40, 40], [40, 160, 60]], [[50, 70, 210], [210, 190, 60]]], np.uint8
)
"""RGB of the four quarters of the stored picture."""
TURNED = COLORS[::-1, ::-1]
GREY = np.repeat(COLORS[..., :1], 3, axis=2)
CENTRES = [[(80, 45), (240, 45)], [(80, 135), (240, 135)]]
READ = """async (image) => {
  while (!image.naturalWidth) await new Promise(requestAnimationFrame);
  const canvas = document.createElement("canvas");
  canvas.width = image.naturalWidth;
  canvas.height = image.naturalHeight;
  const ctx = canvas.getContext("2d");
  ctx.drawImage(image, 0, 0);
  const at = (x, y) => {
    const pixel = ctx.getImageData(x * canvas.width, y * canvas.height, 1, 1);
    return [...pixel.data];
  };
  const row = (y) => [at(0.25, y), at(0.75, y)];
  return { centre: at(0.5, 0.5), quarters: [row(0.25), row(0.75)] };
}"""
_numbers = count(1)


def quarters(colors: np.ndarray = COLORS) -> np.ndarray:
    """(H, W, 3): a picture of four colours."""
    return colors.repeat(HEIGHT // 2, axis=0).repeat(WIDTH // 2, axis=1)


def alpha_in_places() -> np.ndarray:
    """Alpha that hides more or less, and only around the centres of the quarters."""
    alpha = np.full((HEIGHT, WIDTH), 255, np.uint8)
    for (x, y), each in zip([*CENTRES[0], *CENTRES[1]], (0, 40, 160, 255), strict=True):
        alpha[y - 12 : y + 12, x - 12 : x + 12] = each
    return alpha


PICTURES = {
    "turned by half": (with_orientation(jpeg(quarters(), 95), 3), TURNED),
    "turned by a quarter": (with_orientation(jpeg(quarters(), 95), 6), COLORS),
    "transparent in places": (png(with_alpha(quarters(), alpha_in_places())), COLORS),
}


def pushed(http: httpx.Client, image: bytes, segmentation: bytes) -> scenes.Scene:
    """A new dataset of one frame, with a box in each quarter."""
    dataset = f"one-picture-{next(_numbers)}"
    made = http.post("/datasets", json={"name": dataset, "palette": scenes.FAMILY})
    assert made.status_code == 201, made.text
    boxes = [
        {"class": "car", "xyxy": [x - 10, y - 10, x + 10, y + 10]}
        for row in CENTRES
        for x, y in row
    ]
    files = {"image": image, "segmentation": segmentation}
    frame = scenes.put(http, dataset, "a", {"boxes": boxes}, **files)
    return scenes.Scene(http, dataset, frame)


def car_tags() -> np.ndarray:
    palette = FAMILIES[scenes.FAMILY]
    return np.full((HEIGHT, WIDTH), palette.tag_of("Car"), np.uint8)


def read(image: Locator, part: str) -> np.ndarray:
    """RGB at the centre of an <img>, or at those of its quarters."""
    return np.array(image.evaluate(READ)[part], int)


@pytest.mark.parametrize("name", PICTURES)
def test_frame_grid_and_thumbnail_show_one_picture(http, user: Visitor, name):
    content, colors = PICTURES[name]
    painted = FAMILIES[scenes.FAMILY].paint(car_tags())
    scene = pushed(http, content, png(with_alpha(painted, 0)))
    opaque = np.dstack([colors, np.full((2, 2), 255)])

    page = user.open(scene.link())
    expect(page.locator(".stage")).to_have_attribute("data-picture", "shown")
    wait_for_drawing(page)
    base, (scale, x0, y0) = layer(page, "base"), view(page)
    in_frame = [
        [base[round(y * scale + y0), round(x * scale + x0)] for x, y in row]
        for row in CENTRES
    ]
    page = user.open(f"#/datasets/{scene.dataset}/grid?sort=id")
    crops = page.locator(".cell__image")
    expect(crops).to_have_count(4)
    in_grid = [read(crops.nth(index), "centre") for index in range(4)]
    page = user.open(f"#/datasets/{scene.dataset}/frames")
    thumbnail = page.locator("main img").first
    expect(thumbnail).to_be_visible()

    np.testing.assert_allclose(in_frame, opaque, atol=10)
    np.testing.assert_allclose(np.reshape(in_grid, (2, 2, 4)), opaque, atol=10)
    np.testing.assert_allclose(read(thumbnail, "quarters"), opaque, atol=10)


@pytest.mark.parametrize("form", ["palette", "raw"])
def test_transparent_segmentation_is_shown_and_matched(http, user: Visitor, form):
    tags = car_tags()
    painted = FAMILIES[scenes.FAMILY].paint(tags)
    raw = np.dstack([tags, np.zeros_like(tags), np.zeros_like(tags)])
    content = png(with_alpha(painted if form == "palette" else raw, 0))
    scene = pushed(http, jpeg(quarters()), content)

    page = user.open(scene.link("0"))
    expect(page.locator(".stage")).to_have_attribute("data-highlighted", "400")
    user.press("m", *"]" * 5)
    expect(page.locator(".stage")).to_have_attribute("data-mask", "on")
    wait_for_drawing(page)

    base, (scale, x0, y0) = layer(page, "base"), view(page)
    beside = base[round(20 * scale + y0), round(160 * scale + x0)]
    np.testing.assert_allclose(beside[:3], painted[0, 0], atol=2)
