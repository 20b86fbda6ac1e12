"""The address holds filters and selection: they survive a reload and can be shared."""

import re

import pytest
from playwright.sync_api import expect

from tests.support.page import scenes
from tests.support.page.scenes import Scene
from tests.support.page.windows import Visitor

pytestmark = pytest.mark.browser


def test_filters_and_selection_survive_a_reload(scene: Scene, user: Visitor):
    page = user.open(scene.link())
    page.get_by_label("Reason").select_option("below_threshold")
    page.locator(".box", has_text="hidden").click()
    address = page.url
    assert f"box={scene.box_id('hidden')}" in address
    assert "reason=below_threshold" in address

    page.reload()
    user.wait_until_drawn()

    assert page.url == address
    expect(page.locator(".box")).to_have_count(1)
    expect(page.get_by_label("Reason")).to_have_value("below_threshold")
    expect(page.locator(".inspector__head h2")).to_have_text("car hidden")
    user.open(scene.link("ghost", verdict="kept"))
    expect(page.locator("[aria-selected=true]")).to_contain_text("ghost")
    expect(page.locator(".panel__count")).to_contain_text("2 boxes")

    page.get_by_role("button", name="Show all").click()

    expect(page.locator(".panel__count")).to_have_text("5 boxes")
    assert page.url.endswith(f"?box={scene.box_id('ghost')}")


def test_address_that_is_opened_while_a_box_is_chosen_is_kept(scene, user):
    page = user.open(scene.link())
    user.wait_until_drawn()
    row = page.locator(".box", has_text="ghost")

    # The box is chosen after the address has changed, before the page is told of it.
    row.evaluate(
        "(row, address) => { location.hash = address; row.click(); }",
        scene.link(verdict="kept"),
    )

    expect(page.locator(".box")).to_have_count(2)
    assert "verdict=kept" in page.url


def test_frame_applies_filters_of_its_link_and_counts_hidden_boxes(scene, user):
    # No two neighbours have the same boxes, so that each has to be waited for.
    for query, shown in [
        ({"verdict": "kept"}, ["real", "walker"]),
        ({"class": "truck"}, ["ghost"]),
        ({"reason": "outside_image"}, ["away"]),
        ({"verdict": "rejected", "class": "car"}, ["hidden", "away"]),
        ({"review": "decided"}, []),
        ({"review": "undecided", "verdict": "kept"}, ["real", "walker"]),
    ]:
        page = user.open(scene.link(**query))

        names = [re.compile(rf"\b{name}$") for name in shown]
        expect(page.locator(".box__name")).to_have_text(names)
        hidden = page.locator(".panel__hidden")
        expect(hidden).to_contain_text(f"{5 - len(shown)} hidden")


def test_frame_list_filters_persist_into_a_frame_and_back(scene, user):
    walker = [{"id": "w", "class": "walker", "xyxy": scenes.WALKER}]
    scene.push("run/000002", boxes=walker)
    page = user.open(f"#/datasets/{scene.dataset}/frames")
    expect(page.locator("a.thumb")).to_have_count(2)

    page.get_by_role("button", name="Rejected").click()
    page.get_by_label("Class").select_option("truck")

    expect(page.locator("a.thumb")).to_have_count(1)
    expect(page.locator(".page__count")).to_have_text(
        "1 frame · 1 hidden by the filters"
    )
    page.locator("a.thumb").click()
    expect(page.locator(".box")).to_have_count(1)
    page.locator(".crumbs").get_by_role("link", name=scene.dataset).click()
    # The frame, which may still be shown, has a menu of classes, too.
    listed = page.locator("[data-view=frames]")
    expect(listed.get_by_label("Class")).to_have_value("truck")
    page.reload()
    expect(page.locator("a.thumb")).to_have_count(1)


def test_frames_are_filtered_by_key_prefix_and_back_returns_to_them(scene, user):
    scene.push("other/000001")
    page = user.open(f"#/datasets/{scene.dataset}/frames")

    page.get_by_label("Key starts with").fill("other/")

    expect(page.locator("a.thumb")).to_have_count(1)
    assert page.url.endswith("?key=other%2F")

    user.open(f"#/datasets/{scene.dataset}/frames?key=nowhere")
    expect(page.get_by_role("heading", name="No frame matches")).to_be_visible()
    page.get_by_role("button", name="Clear the filters").click()
    expect(page.locator("a.thumb")).to_have_count(2)
    page.locator("a.thumb").first.click()
    user.wait_until_drawn()
    user.press("j", "j")
    page.go_back()
    expect(page.locator("[data-view=frames]")).to_be_visible()


def test_long_frame_list_is_paginated_while_scrolling(scene, user):
    box = [{"id": "w", "class": "walker", "xyxy": scenes.WALKER}]
    for number in range(2, 66):
        scene.push(f"run/{number:06}", boxes=box, form="none")
    page = user.open(f"#/datasets/{scene.dataset}/frames")
    expect(page.locator("a.thumb").nth(59)).to_be_attached()

    page.mouse.wheel(0, 20_000)

    expect(page.locator("a.thumb")).to_have_count(65)
    expect(page.locator(".page__count")).to_have_text("65 frames")
    assert page.locator("a.thumb").nth(64).get_attribute("title") == "run/000065"


def test_unknown_address_says_so_and_links_to_the_datasets(user):
    page = user.page
    for link, words in [
        ("#/nothing/here", "Page not found"),
        ("#/datasets/no-such/frames", "there is no dataset 'no-such'"),
        ("#/frames/999999", "there is no frame"),
    ]:
        page.goto(f"{user.url}/{link}")
        expect(page.locator("main")).to_contain_text(words)

        page.locator(".notice").get_by_role("link", name="All datasets").click()

        expect(page.get_by_role("heading", name="Datasets")).to_be_visible()
