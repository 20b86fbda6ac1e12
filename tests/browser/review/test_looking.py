"""Looking at a frame: clicks, the order of the list, and room for the picture."""

import numpy as np
import pytest
from playwright.sync_api import expect

from tests.support import sensors
from tests.support.page import scenes
from tests.support.page.stage import edge_contrast, point, view, wait_for_drawing
from tests.support.page.windows import OVERFLOW
from tests.support.pictures import png

pytestmark = pytest.mark.browser

CAR, GHOST = scenes.CAR, [100, 220, 180, 280]
STACK = [
    {"id": "real", "class": "car", "xyxy": CAR, "distance": 12.5},
    {"id": "ghost", "class": "walker", "xyxy": GHOST, "distance": 60},
    {"id": "far", "class": "truck", "xyxy": scenes.SKY, "distance": 150},
]


def click(page, x, y):
    page.mouse.click(*point(page, x, y))


def test_click_selects_the_object_whose_pixels_were_clicked(make_scene, user):
    scene = make_scene(boxes=[])
    height, width = scenes.HEIGHT, scenes.WIDTH
    tags, ids = np.ones((height, width), np.uint8), np.zeros((height, width), int)
    # A bus, and a car in front of it whose box is as large as its pixels.
    tags[100:300, 80:400], ids[100:300, 80:400] = 16, 500
    tags[200:300, 120:240], ids[200:300, 120:240] = 14, 700
    # A small kept box of the bus's own pixels lies within the bus.
    boxes = [
        {"id": "bus", "class": "bus", "xyxy": [80, 100, 400, 300], "distance": 30},
        {"id": "car", "class": "car", "xyxy": [120, 200, 240, 300], "distance": 10},
        {"id": "part", "class": "bus", "xyxy": [260, 120, 300, 160], "distance": 31},
    ]
    files = {
        "image": scenes.picture(),
        "segmentation": png(np.dstack([tags, 0 * tags, 0 * tags])),
        "instances": sensors.instance_png(tags, ids),
    }
    camera = {"width": width, "height": height, "fov": 90}
    annotation = {"carla_version": "0.9.15", "camera": camera, "boxes": boxes}
    frame = scenes.put(scene.http, scene.dataset, "run/000002", annotation, **files)
    page = user.open(f"#/frames/{frame['id']}")
    expect(page.locator(".stage")).to_have_attribute("data-objects", "shown")

    click(page, 280, 140)
    expect(page.locator(".inspector__head h2")).to_have_text("bus bus")
    click(page, 180, 250)

    expect(page.locator(".inspector__head h2")).to_have_text("car car")


def test_stack_fades_is_sorted_and_is_selected_by_keys_and_clicks(make_scene, user):
    """Far boxes fade; a click on a box inside another selects the visible one first."""
    page = user.open(make_scene(boxes=STACK).link())
    wait_for_drawing(page)
    faint = edge_contrast(page, scenes.SKY)
    user.press("o")
    wait_for_drawing(page)
    assert 0 < 1.5 * faint < edge_contrast(page, scenes.SKY)

    names = page.locator(".box__name")
    expect(names).to_have_text(["car real", "walker ghost", "truck far"])

    page.get_by_label("Order").select_option("size")
    expect(names).to_have_text(["car real", "truck far", "walker ghost"])
    page.get_by_label("Order").select_option("distance")
    expect(names).to_have_text(["car real", "walker ghost", "truck far"])
    page.get_by_label("Order").select_option("doubt")
    expect(names).to_have_count(3)
    page.get_by_label("Order").select_option("size")
    user.press("j", "j")

    expect(page.locator(".inspector__head h2")).to_have_text("truck far")
    for name in ("car real", "walker ghost"):
        click(page, 140, 250)
        expect(page.locator(".inspector__head h2")).to_have_text(name)


def test_picture_has_most_of_the_window_and_all_of_it_without_panels(make_scene, user):
    scene = make_scene()
    page = user.open(scene.link("real"))
    expect(page.locator(".stage")).to_have_attribute("data-picture", "shown")

    def share() -> float:
        scale, *_ = view(page)
        pixels = scenes.WIDTH * scenes.HEIGHT * scale**2
        return float(pixels / page.evaluate("innerWidth * innerHeight"))

    wait_for_drawing(page)
    assert share() >= 0.55
    expect(page.locator(".panel--list")).to_be_visible()
    expect(page.locator(".panel--inspector")).to_be_visible()
    user.press("p")
    expect(page.locator(".panel--list")).to_be_hidden()
    wait_for_drawing(page)
    assert share() >= 0.7
    assert page.evaluate(OVERFLOW) <= 0
    user.press("p")
    expect(page.locator(".panel--inspector")).to_be_visible()

    # The tabs of the dataset stay.
    page.get_by_role("navigation", name="Dataset").get_by_text("Queue").click()
    expect(page).to_have_url(f"{user.url}/#/datasets/{scene.dataset}/queue")


def test_overlapping_boxes_are_listed_closest_first_and_dimmed_less(make_scene, user):
    part, far = [200, 220, 330, 320], [420, 30, 520, 110]
    corners = {"near": scenes.CAR, "part": part, "inside": [90, 210, 230, 290]}
    corners["far"] = far
    boxes = [{"id": id_, "class": "car", "xyxy": xy} for id_, xy in corners.items()]
    page = user.open(make_scene(boxes=boxes).link("near"))
    wait_for_drawing(page)
    assert edge_contrast(page, part) > 1.5 * edge_contrast(page, far) > 0
    listed = page.get_by_label("Overlapping boxes").get_by_role("button")
    expect(listed).to_have_count(2)
    expect(listed.first).to_contain_text("car inside")

    listed.nth(1).click()

    expect(page.locator(".inspector__head h2")).to_have_text("car part")
