"""The pixels that the stage really draws, and how it zooms and pans."""

import numpy as np
import pytest
from playwright.sync_api import expect

from tests.support.page import scenes
from tests.support.page.stage import (
    drawings,
    edge_runs,
    layer,
    point,
    view,
    wait_for_drawing,
)
from tests.support.page.windows import PHONE

pytestmark = pytest.mark.browser


def count_lit_pixels(top: np.ndarray) -> int:
    """How many pixels of the stage have the colour that outlines matching pixels."""
    red, green, blue, alpha = (top[..., i].astype(int) for i in range(4))
    return int(((red > 220) & (green > 180) & (blue < 90) & (alpha > 100)).sum())


def test_verdicts_differ_in_their_stroke_not_only_in_colour(make_scene, user):
    measured = make_scene()
    page = user.open(measured.link())
    kept = edge_runs(page, scenes.CAR)
    rejected = edge_runs(page, scenes.SKY)
    user.open(make_scene(form="none").link())
    unmeasured = edge_runs(page, scenes.SKY)

    assert kept == 1
    assert 5 < rejected < unmeasured
    # Without a segmentation there is no mask to show.
    expect(page.get_by_role("toolbar", name="View")).to_be_visible()
    expect(page.get_by_role("button", name="Segmentation")).to_have_count(0)
    expect(page.locator(".stroke--unmeasured").first).to_be_visible()


def test_matching_pixels_of_the_selected_box_are_outlined(make_scene, user):
    # The tags are in the stored file alone: the painted mask has other values.
    page = user.open(make_scene(form="raw").link("hidden"))
    expect(page.locator(".stage")).to_have_attribute("data-highlighted", "400")
    wait_for_drawing(page)

    # 100 x 4 pixels are outlined, and stay visible.
    scale, *_ = view(page)
    assert count_lit_pixels(layer(page, "top")) == pytest.approx(
        208 * scale * 1.5, rel=0.4
    )
    user.press("l")
    expect(page.locator(".stage")).to_have_attribute("data-highlighted", "")
    wait_for_drawing(page)
    assert count_lit_pixels(layer(page, "top")) == 0
    user.press("l", "j")
    expect(page.locator(".inspector__head h2")).to_contain_text("ghost")
    expect(page.locator(".stage")).to_have_attribute("data-highlighted", "0")
    wait_for_drawing(page)
    assert count_lit_pixels(layer(page, "top")) == 0


@pytest.mark.parametrize("form", ["palette", "bgr", "raw"])
def test_mask_blends_in_the_palette_colours_of_every_file_form(make_scene, user, form):
    page = user.open(make_scene(form=form).link())
    before = layer(page, "base")
    scale, x, y = view(page)
    sky = round(60 * scale + y), round(200 * scale + x)
    assert before[sky][:3].tolist() == [scenes.GREY] * 3

    user.press("m")
    expect(page.locator(".stage")).to_have_attribute("data-mask", "on")
    wait_for_drawing(page)
    half = [(scenes.GREY + channel) / 2 for channel in (70, 130, 180)]
    assert layer(page, "base")[sky][:3].tolist() == pytest.approx(half, abs=2)

    user.press(*"]" * 5)
    wait_for_drawing(page)

    assert layer(page, "base")[sky][:3].tolist() == [70, 130, 180]


def test_selected_box_is_drawn_on_top_and_its_answer_on_its_corner(scene, user):
    page = user.open(scene.link())
    before = layer(page, "base")
    assert not layer(page, "top").any()

    user.press("j")
    wait_for_drawing(page)

    assert layer(page, "top").any()
    ink = np.abs(before.astype(int) - scenes.GREY).max()
    dimmed = np.abs(layer(page, "base").astype(int)[..., :3] - scenes.GREY).max()
    assert dimmed < ink, "the others are dimmed"
    user.press("a", "Escape")
    wait_for_drawing(page)
    scale, x, y = view(page)
    column, row = round(scenes.CAR[2] * scale + x), round(scenes.CAR[1] * scale + y)
    mark = layer(page, "base")[row - 9 : row + 10, column - 9 : column + 10, :3]
    whites = (mark.min(axis=2) > 230).sum()
    greens = ((mark[..., 1] > mark[..., 0] + 60) & (mark[..., 0] < 40)).sum()
    assert whites > 20
    assert greens > 60


def test_edges_of_a_3d_box_are_drawn_until_the_d_key(make_scene, user):
    scene = make_scene(boxes=[scenes.SOLID])
    page = user.open(scene.link("solid"))
    edges = page.get_by_role("button", name="3D edges", exact=True)
    expect(edges).to_have_attribute("aria-pressed", "true")
    wait_for_drawing(page)
    with_edges = layer(page, "top")

    user.press("d")
    expect(edges).to_have_attribute("aria-pressed", "false")
    wait_for_drawing(page)

    changed = (with_edges != layer(page, "top")).any(axis=2).sum()
    assert changed > 200


def test_pointer_shows_the_label_of_a_box_zooms_and_pans(scene, user):
    page = user.open(scene.link())

    page.mouse.move(*point(page, 160, 250))
    wait_for_drawing(page)

    assert layer(page, "top").any()
    page.mouse.move(*point(page, 10, 170))
    wait_for_drawing(page)
    assert not layer(page, "top").any()

    at = point(page, 160, 250)
    page.mouse.move(*at)
    fitted, *_ = view(page)
    page.mouse.wheel(0, -300)
    page.wait_for_function(
        "(old) => document.querySelector('.stage').dataset.view.split(' ')[0] > old",
        arg=fitted * 1.2,
    )
    assert point(page, 160, 250) == pytest.approx(at, abs=0.5)

    user.press("f", "j")
    expect(page.locator(".inspector__head h2")).to_have_text("car real")
    wait_for_drawing(page)
    scale, x, y = view(page)
    page.mouse.move(*point(page, 10, 170))
    page.mouse.down()
    page.mouse.move(*(n + 40 for n in point(page, 10, 170)))
    page.mouse.up()
    wait_for_drawing(page)
    assert view(page) == pytest.approx((scale, x + 40, y + 40), abs=0.01)
    expect(page.locator(".inspector__head h2")).to_have_text("car real")


def test_pinch_gesture_zooms(scene, open_window):
    bo = open_window(viewport=PHONE, has_touch=True, is_mobile=True)
    page = bo.open(scene.link())
    before, *_ = view(page)

    page.evaluate(PINCH)
    wait_for_drawing(page)

    assert view(page)[0] == pytest.approx(2 * before, rel=0.01)


PINCH = """() => {
  const stage = document.querySelector(".stage");
  const { left, top } = stage.getBoundingClientRect();
  stage.setPointerCapture = () => {};
  const send = (type, pointerId, x) => stage.dispatchEvent(new PointerEvent(type,
    { pointerId, button: 0, clientX: left + x, clientY: top + 150, bubbles: true }));
  send("pointerdown", 1, 150);
  send("pointerdown", 2, 200);
  send("pointermove", 2, 225);
  send("pointermove", 1, 125);
  send("pointerup", 1, 125);
  send("pointerup", 2, 225);
}"""


def test_500_boxes_are_drawn_at_most_once_per_animation_frame(make_scene, user):
    rng = np.random.default_rng(5)
    corners = rng.uniform((0, 0), (600, 330), (500, 2)).round(1)
    sizes = rng.uniform(6, 40, (500, 2)).round(1)
    boxes = [
        {"id": str(i), "class": "car", "xyxy": [*corner, *(corner + size)]}
        for i, (corner, size) in enumerate(zip(corners, sizes, strict=True))
    ]
    page = user.open(make_scene(boxes=boxes).link())
    expect(page.locator(".panel__count")).to_have_text("500 boxes")
    before = drawings(page)

    page.mouse.move(*point(page, 300, 100))
    page.mouse.down()
    frames = page.evaluate(DRAG)
    page.mouse.up()

    drawn = drawings(page) - before
    assert 10 <= drawn <= frames + 3


DRAG = """async () => {
  const stage = document.querySelector(".stage");
  const at = stage.getBoundingClientRect();
  let frames = 0;
  for (let i = 1; i <= 20; i++) {
    for (let j = 0; j < 8; j++)
      stage.dispatchEvent(new PointerEvent("pointermove", {
        pointerId: 1, clientX: at.left + 300 + 8 * i + j, clientY: at.top + 200 }));
    await new Promise(requestAnimationFrame);
    frames++;
  }
  return frames;
}"""


def test_boxes_follow_the_image_during_and_after_panning(scene, user):
    page = user.open(scene.link())
    start = point(page, 20, 20)
    page.mouse.move(*start)
    page.mouse.down()

    page.mouse.move(start[0] + 90, start[1] + 40, steps=4)
    wait_for_drawing(page)

    assert edge_runs(page, scenes.CAR) == 1
    assert edge_runs(page, scenes.HALF_HIDDEN) > 3
    page.mouse.move(start[0] + 460, start[1] - 30, steps=4)
    wait_for_drawing(page)
    assert edge_runs(page, scenes.CAR) == 1, "further than what was drawn ahead"
    page.mouse.up()
    user.press("+")
    wait_for_drawing(page)
    assert edge_runs(page, scenes.CAR) == 1, "drawn afresh"
