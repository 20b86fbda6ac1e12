"""The grid of crops: what it shows, how boxes are selected, filters and order."""

import re

import pytest
from playwright.sync_api import Route, expect

from tests.support.page import many_boxes, scenes
from tests.support.page.many_boxes import cell, grid, open_grid, selected
from tests.support.page.scenes import MakeScene, Scene
from tests.support.page.stage import bounds
from tests.support.page.windows import (
    OVERFLOW,
    WIDTHS,
    hold_timers,
)
from tests.support.waiting import until

pytestmark = pytest.mark.browser


@pytest.fixture
def sixty_boxes(make_scene: MakeScene) -> Scene:
    """Sixty boxes: b0, b2, ... are kept, b1, b3, ... are rejected."""
    return make_scene(boxes=many_boxes.alternating_boxes(60))


def test_cell_names_the_frame_of_its_box_and_links_to_it(make_scene, user):
    key = f"{'a-long-name-of-a-drive-' * 4}/camera-front/0000000042"
    scene = make_scene(boxes=[])
    frame = scene.push(key, boxes=many_boxes.alternating_boxes(2))
    page = user.open(grid(scene))
    link = cell(page, 1).locator(".cell__frame")

    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 844})
        expect(link).to_have_text(key)
        expect(link.get_by_text("0000000042", exact=True)).to_be_visible()
        picture = bounds(cell(page, 1).locator(".cell__picture"))
        shown = bounds(link)
        assert shown["width"] <= picture["width"], width
        assert page.evaluate(OVERFLOW) <= 0, width
    link.click()

    box = frame["boxes"][1]["box_id"]
    expect(page).to_have_url(re.compile(rf"#/frames/{frame['id']}\?box={box}$"))


def test_every_box_is_shown_and_is_selected_by_clicks_and_drags(sixty_boxes, user):
    page = open_grid(user, sixty_boxes)

    first, second = cell(page, 0), cell(page, 1)
    expect(first.locator("img")).to_be_visible()
    expect(first.locator(".cell__box--kept")).to_have_css("border-style", "solid")
    expect(second.locator(".cell__box--rejected")).to_have_css("border-style", "dashed")
    expect(first.locator(".cell__percent")).to_have_text("100 %")
    expect(second.locator(".cell__reason")).to_have_text("too few visible pixels")
    expect(first).to_have_accessible_name(
        "car b0, kept: 100 % Car ≥ 10 %, frame run/000001"
    )
    expect(page.locator(".grid-status p")).to_have_text("60 boxes")

    cell(page, 3).click()
    assert selected(page) == [3]
    cell(page, 7).click(modifiers=["Control"])
    assert selected(page) == [3, 7]
    cell(page, 3).click(modifiers=["Control"])
    cell(page, 7).click()
    assert selected(page) == [7]
    cell(page, 10).click(modifiers=["Shift"])
    assert selected(page) == [7, 8, 9, 10]
    cell(page, 5).click(modifiers=["Shift"])
    assert selected(page) == [5, 6, 7]
    expect(page.locator(".bar__count")).to_have_text("3 selected")
    user.press("Escape")
    assert selected(page) == []
    start, end = bounds(cell(page, 0)), bounds(cell(page, 2))
    page.mouse.move(start["x"] + 20, start["y"] + 30)
    page.mouse.down()
    page.mouse.move(end["x"] + 10, end["y"] + 60, steps=5)
    expect(page.locator(".lasso")).to_be_visible()
    page.mouse.up()

    expect(page.locator(".lasso")).to_have_count(0)
    assert selected(page) == [0, 1, 2]
    cell(page, 5).click(modifiers=["Control"])
    assert selected(page) == [0, 1, 2, 5]

    cell(page, 9).click()
    box = bounds(cell(page, 1))

    page.keyboard.down("Control")
    page.mouse.move(box["x"] + 10, box["y"] + 10)
    page.mouse.down()
    page.mouse.move(box["x"] + 60, box["y"] + 60, steps=3)
    page.mouse.up()
    page.keyboard.up("Control")

    assert selected(page) == [1, 9]


def test_boxes_outside_the_image_are_labelled_outside(scene, user):
    page = open_grid(user, scene, reason="outside_image")

    expect(page.locator(".cell__none")).to_have_text("outside")


def test_keys_move_the_focus_select_and_filter_by_verdict(sixty_boxes, user):
    page = open_grid(user, sixty_boxes)
    columns = int(page.get_by_role("grid").get_attribute("aria-colcount") or 0)

    user.press("ArrowRight", "Space", "ArrowDown", "Enter")

    assert selected(page) == [1, 1 + columns]
    focused = page.get_by_role("grid").get_attribute("aria-activedescendant")
    assert focused == cell(page, 1 + columns).get_attribute("id")
    user.press("Space")
    assert selected(page) == [1]
    user.press("Escape")
    assert selected(page) == []
    expect(page.locator(".bar--grid")).to_have_count(0)

    user.press("End")
    expect(cell(page, 59)).to_be_in_viewport(ratio=1)
    user.press("Space", "Home")
    expect(cell(page, 0)).to_be_in_viewport(ratio=1)
    expect(page.locator(".bar__count")).to_have_text("1 selected")
    user.press("Escape")

    user.press("ArrowRight", "Shift+ArrowRight", "Shift+ArrowRight")
    assert selected(page) == [1, 2, 3]
    user.press("Shift+ArrowLeft")
    assert selected(page) == [1, 2]
    user.press("Escape")

    user.press("v")
    expect(page.locator(".grid-status p")).to_contain_text("30 hidden")
    assert "verdict=kept" in page.url
    user.press("Control+a")
    expect(page.locator(".bar__count")).to_have_text("30 of this filter")
    cell(page, 0).click(modifiers=["Control"])
    expect(page.locator(".bar__count")).to_have_text("29 selected")
    user.press("Escape")
    user.press("v", "v")

    expect(page.locator(".grid-status p")).to_have_text("60 boxes")


def test_grid_applies_filters_of_its_link_and_counts_hidden_boxes(sixty_boxes, user):
    many_boxes.review(sixty_boxes, sixty_boxes.box_id("b0"), "reject")
    # No two neighbours show the same words, so that each has to be waited for.
    for query, words in [
        ({"verdict": "rejected"}, "31 boxes · 29 hidden by the filters"),
        ({"by_filter": "rejected"}, "30 boxes · 30 hidden by the filters"),
        ({"class": "truck"}, "No box matches"),
        ({"reason": "visible"}, "30 boxes · 30 hidden by the filters"),
        ({"review": "decided"}, "1 box · 59 hidden by the filters"),
        ({"match_min": "50"}, "30 boxes · 30 hidden by the filters"),
        ({"distance_min": "20"}, "No box matches"),
        ({"match_max": "50"}, "30 boxes · 30 hidden by the filters"),
        ({"conflict": "true"}, "1 box · 59 hidden by the filters"),
        ({"distance_max": "20"}, "60 boxes"),
        ({"toss_up": "true"}, "No box matches"),
    ]:
        page = user.open(grid(sixty_boxes, **query))

        shown = page.locator(".grid-status p, .notice h2")
        expect(shown.filter(visible=True)).to_have_text(re.compile(f"^{words}"))


def test_filters_and_sort_order_are_kept_in_the_address(sixty_boxes, user):
    page = open_grid(user, sixty_boxes)
    page.get_by_role("group", name="Verdict").get_by_text("Rejected").click()
    page.get_by_label("Order").select_option("-match_percent")
    page.get_by_role("button", name="More").click()
    page.get_by_label("Distance, at most").fill("40")

    expect(page).to_have_url(re.compile(r"distance_max=40"))
    assert "verdict=rejected" in page.url
    assert "sort=-match_percent" in page.url
    expect(page.locator(".grid-status p")).to_contain_text("30 boxes")
    page.get_by_role("button", name="Clear").click()
    expect(page.locator(".grid-status p")).to_have_text("60 boxes")
    assert "sort=-match_percent" in page.url

    # Numbers apply even if their menu closes at once.
    page.get_by_role("button", name="More").click()
    page.get_by_label("Match, at least").fill("1")
    page.get_by_label("Distance, at most").fill("40")
    page.keyboard.press("Escape")
    expect(page.get_by_label("Distance, at most")).to_have_count(0)
    expect(page).to_have_url(re.compile(r"distance_max=40"))
    assert "match_min=1" in page.url

    # A pending number does not block the way back.
    user.open(f"#/datasets/{sixty_boxes.dataset}/frames")
    expect(page.locator("a.thumb").first).to_be_visible()
    open_grid(user, sixty_boxes)
    page.get_by_role("button", name="More").click()
    page.get_by_label("Match, at least").fill("1")

    page.evaluate("history.back()")

    expect(page.locator("a.thumb").first).to_be_visible()
    assert page.url.endswith(f"#/datasets/{sixty_boxes.dataset}/frames")


def test_blind_re_check_hides_verdicts_of_unanswered_boxes(sixty_boxes, user):
    many_boxes.review(sixty_boxes, sixty_boxes.box_id("b1"), "keep")
    page = open_grid(user, sixty_boxes)
    user.press("b")

    expect(cell(page, 1).locator(".cell__box--kept")).to_be_visible()
    for index in (0, 2, 3):
        expect(cell(page, index).locator(".cell__box--withheld")).to_be_visible()
        name = cell(page, index).locator(".sr-only").inner_text()
        assert not re.search("kept|rejected|%|pixel", name)


def test_key_double_click_or_button_opens_a_box_in_its_frame(sixty_boxes, user):
    page = open_grid(user, sixty_boxes)
    opened = page.locator(".inspector__head h2")

    cell(page, 5).click()
    user.press("c")
    expect(opened).to_have_text("car b5")

    page.go_back()
    cell(page, 6).dblclick()
    expect(opened).to_have_text("car b6")

    page.go_back()
    cell(page, 7).hover()
    cell(page, 7).locator(".cell__open").click()
    expect(opened).to_have_text("car b7")


def test_returning_to_the_grid_restores_scroll_and_selection(sixty_boxes, user):
    page = open_grid(user, sixty_boxes)
    user.press("End")
    cell(page, 55).click()
    before = page.get_by_role("grid").evaluate("grid => grid.scrollTop")
    assert before > 0
    user.press("c")
    user.wait_until_drawn()

    user.press("x", "g")

    expect(cell(page, 55)).to_be_in_viewport()
    assert page.get_by_role("grid").evaluate("grid => grid.scrollTop") == before
    expect(cell(page, 55)).to_have_attribute("aria-selected", "true")
    assert selected(page) == [55]
    expect(cell(page, 55).locator(".sign--reject")).to_be_visible()
    page.go_back()
    user.wait_until_drawn()
    page.go_back()
    expect(cell(page, 55)).to_be_in_viewport()


def test_grid_that_was_left_before_its_dataset_was_loaded_is_restored(
    sixty_boxes, user
):
    held: list[Route] = []
    user.page.route(
        f"**/api/v1/datasets/{sixty_boxes.dataset}",
        lambda route: route.continue_() if held else held.append(route),
    )
    page = open_grid(user, sixty_boxes)
    user.press("End")
    cell(page, 55).click()
    user.press("c")
    user.wait_until_drawn()

    user.press("g")

    expect(cell(page, 55)).to_be_in_viewport()
    expect(cell(page, 55)).to_have_attribute("aria-selected", "true")
    assert selected(page) == [55]


def test_lists_are_read_once_after_the_dataset_has_changed(sixty_boxes, user):
    page = open_grid(user, sixty_boxes)
    scenes.push(sixty_boxes.http, sixty_boxes.dataset, "run/000002")
    addresses: list[str] = []
    page.on("request", lambda request: addresses.append(request.url))

    with page.expect_response(f"**/datasets/{sixty_boxes.dataset}"):
        user.press("v")
    expect(page.locator(".grid-status b")).to_have_text("32")
    page.wait_for_timeout(500)  # in which it would be read once more
    cell(page, 0).click()

    assert selected(page) == [0]
    assert len([url for url in addresses if "/boxes?" in url]) == 1


def test_list_that_was_read_again_is_selected_from_and_returned_to(sixty_boxes, user):
    page = open_grid(user, sixty_boxes)
    user.press("End")
    expect(cell(page, 59)).to_be_in_viewport()
    many_boxes.review(sixty_boxes, sixty_boxes.box_id("b0"), "keep")
    page.get_by_role("button", name="Select all 60").click()
    user.press("a")
    with page.expect_response(re.compile(r"/boxes\?.*limit=200")):
        page.get_by_role("button", name="Count again").click()
    expect(page.get_by_role("grid")).to_have_attribute("aria-busy", "false")

    cell(page, 57).click()
    cell(page, 58).click(modifiers=["Shift"])

    assert selected(page) == [57, 58]
    user.press("c")
    user.wait_until_drawn()
    user.press("g")
    expect(cell(page, 57)).to_be_in_viewport()
    assert selected(page) == [57, 58]


def test_larger_crops_reduce_columns_and_keep_scroll_position(sixty_boxes, user):
    page = open_grid(user, sixty_boxes)
    user.press("End")
    expect(cell(page, 59)).to_be_in_viewport()
    columns = page.get_by_role("grid").get_attribute("aria-colcount")

    page.get_by_label("Size of the crops").fill("320")

    expect(page.get_by_role("grid")).not_to_have_attribute("aria-colcount", columns)
    expect(cell(page, 0)).to_have_count(0)
    expect(cell(page, 40)).to_be_in_viewport()
    page.reload()
    expect(page.get_by_label("Size of the crops")).to_have_value("320")


def test_failed_crops_are_retried_when_online_again(sixty_boxes, user):
    page = user.page
    refused: list[str] = []

    def refuse(route: Route) -> None:
        refused.append(route.request.url)
        route.abort()

    bundle = re.compile(rf"/boxes/crops\?crops={sixty_boxes.box_id('b0')}-")
    page.route(bundle, refuse)
    # Online or not, it is requested again after one second, and after two more, which
    # do not pass. When online again, it is requested at once, and a second later if
    # that came too early.
    hold_timers(page, 2000)
    open_grid(user, sixty_boxes)
    until(lambda: page.evaluate("true") and len(refused) == 2, "it is not retried")
    expect(cell(page, 0)).to_contain_text("not loaded")
    page.unroute(bundle)

    page.context.set_offline(True)
    page.wait_for_function("!navigator.onLine")
    page.context.set_offline(False)

    expect(cell(page, 0).locator("img")).to_be_visible()


def test_more_filters_open_inside_the_window(make_scene, user):
    light = {"id": "1", "class": "traffic_light", "xyxy": scenes.SKY}
    page = open_grid(user, make_scene(boxes=[light]), **{"class": "traffic_light"})
    more = page.get_by_role("button", name="More", exact=True)
    group = page.get_by_role("group", name="More filters")
    for width in (1024, 390):
        page.set_viewport_size({"width": width, "height": 844})
        if width == 390:
            page.get_by_role("button", name="Filters", exact=True).click()
        more.click()

        panel = bounds(group)

        assert panel["x"] >= 0, width
        assert panel["x"] + panel["width"] <= width
        assert page.evaluate(OVERFLOW) <= 0, width
        user.press("Escape")
        expect(group).to_have_count(0)


def test_grid_reloads_its_box_list_after_a_run(sixty_boxes, user):
    kept = grid(sixty_boxes, verdict="kept")
    # The last request for the state that belongs to the list.
    with user.page.expect_response(re.compile(r"/frames\?.*sort=-id")):
        page = user.open(kept)
    expect(page.locator(".grid-status b")).to_have_text("30")
    page.evaluate("location.hash = '#/datasets'")
    expect(page.get_by_role("heading", name="Datasets")).to_be_visible()
    sixty_boxes.decide(min_visible_pixels=1_000_000)

    page.evaluate("(link) => { location.hash = link; }", kept)

    expect(page.get_by_text("No box matches")).to_be_visible()
