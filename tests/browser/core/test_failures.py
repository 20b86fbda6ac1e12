"""A part of a view that cannot be loaded shows the error, and can be tried again."""

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, Route, expect

from tests.support.page import scenes
from tests.support.page.scenes import MakeScene, Scene
from tests.support.page.tuning import car_at
from tests.support.page.windows import Visitor, first_held, route_loaded

pytestmark = pytest.mark.browser

DETAIL = "the disk is full"
PROBLEM = {"title": "Internal Server Error", "status": 500, "detail": DETAIL}


def respond_with_500(route: Route) -> None:
    route.fulfill(status=500, json=PROBLEM)


@pytest.fixture(scope="module")
def street(make_scene: MakeScene) -> Scene:
    """Two cars, after a run that has changed the verdict of one; no test changes it."""
    scene = make_scene(boxes=[car_at(30, 0), car_at(55, 1)])
    scene.decide(threshold_small_box=40)
    return scene


def view(path: str, *, click: str = "") -> Callable[[Visitor, Scene], None]:
    """A function that opens this view of the dataset and clicks a button, if named."""

    def go(user: Visitor, street: Scene) -> None:
        page = user.open(f"#/datasets/{street.dataset}/{path}")
        if click:
            page.get_by_role("button", name=click).click()

    return go


def open_datasets(user: Visitor, _: Scene) -> None:
    user.open("#/datasets")


def open_latest_run(user: Visitor, street: Scene) -> None:
    runs = scenes.get(street.http, f"/datasets/{street.dataset}/runs")["items"]
    user.open(f"#/datasets/{street.dataset}/runs?run={runs[0]['id']}")


def open_first_box(user: Visitor, street: Scene) -> None:
    box = street.frame["boxes"][0]
    user.page.goto(f"{user.url}/#/frames/{street.frame['id']}?box={box['box_id']}")


def segmentation(user: Visitor, street: Scene) -> None:
    """Show the segmentation of a frame.

    No box is selected: its pixels would be loaded from the segmentation, too.
    """
    user.page.goto(f"{user.url}/#/frames/{street.frame['id']}")
    user.page.get_by_role("button", name="Segmentation").click()


@pytest.mark.parametrize(
    ("address", "go", "part"),
    [
        (r"/datasets\?", open_datasets, ""),
        (r"/boxes\?", view("grid"), ""),
        (r"/queue$", view("queue"), ""),
        (r"/preview$", view("thresholds"), ""),
        (r"/evaluations\?", view("quality"), "Kinds of evidence compared"),
        (r"/runs\?", view("quality"), "Kinds of evidence compared"),
        (r"/runs\?", view("thresholds"), ""),
        (r"/configs\?", view("thresholds"), "Versions"),
        (r"/openapi\.json", view("thresholds"), "Configuration"),
        (r"/exports\?", view("runs"), "Exports"),
        (r"/openapi\.json", view("runs", click="New export"), "Exports"),
        (r"/diff\?", open_latest_run, "What run"),
        (r"/configs/", open_latest_run, "What run"),
        (r"/problems\?", view("frames", click="Dataset settings"), ""),
        (r"/openapi\.json", view("frames", click="Dataset settings"), ""),
        (r"/history", open_first_box, ""),
        (r"/thumbnail\?width=16383", open_first_box, ""),
        (r"/segmentation$", open_first_box, ""),
        (r"/(segmentation|painted)", segmentation, ""),
    ],
)
def test_failed_part_of_a_view_shows_error_and_can_be_retried(
    user, street, address, go, part
):
    page: Page = user.page
    page.route(re.compile(address), respond_with_500)
    go(user, street)
    place = page.get_by_role("region", name=part) if part else page
    failure = place.get_by_role("alert")
    expect(failure).to_contain_text(DETAIL)

    page.unroute(re.compile(address))
    # A failed response to a second such request may still be on its way.
    with page.expect_response(
        lambda response: response.ok and bool(re.search(address, response.url))
    ):
        place.get_by_role("button", name="Try again").click()

    expect(failure).to_have_count(0)


def test_failed_history_does_not_show_history_of_previous_box(user, street):
    open_first_box(user, street)
    items = user.page.locator(".history__item")
    expect(items.first).to_be_visible()

    route_loaded(user.page, re.compile("/history"), respond_with_500)
    user.press("j")

    expect(user.page.get_by_role("alert")).to_contain_text(DETAIL)
    expect(items).to_have_count(0)


def test_failed_channel_comparison_clears_the_previous_result(user, street):
    view("quality")(user, street)
    channels = user.page.get_by_role("region", name="Kinds of evidence compared")
    of_instances = channels.get_by_text("Only the segmentation has been measured.")
    expect(of_instances).to_be_visible()

    route_loaded(
        user.page, re.compile(r"/evaluations\?.*truth=people"), respond_with_500
    )
    channels.get_by_role("button", name="People").click()

    expect(channels.get_by_role("alert")).to_contain_text(DETAIL)
    expect(of_instances).to_have_count(0)

    channels.get_by_role("button", name="Instances").click()

    expect(of_instances).to_be_visible()
    expect(channels.get_by_role("alert")).to_have_count(0)


def test_request_that_fails_just_after_being_online_again_is_repeated(street, user):
    page = user.open("#/datasets")
    held: list[Route] = []
    route_loaded(
        page,
        "**/api/v1/boxes?*",
        lambda route: route.continue_() if held else held.append(route),
    )
    page.evaluate(
        "(to) => { location.hash = to; }", f"#/datasets/{street.dataset}/grid"
    )
    request = first_held(page, held)
    # The clock stands still, so that the failure counts as one of just after.
    page.evaluate("{ const now = Date.now(); Date.now = () => now; }")
    page.evaluate("dispatchEvent(new Event('online'))")

    request.abort()

    expect(page.locator("[role=gridcell]").first).to_be_visible()


def test_view_that_was_opened_offline_is_loaded_when_online_again(street, user):
    page = user.open("#/datasets")
    expect(page.get_by_role("heading", name=street.dataset)).to_be_visible()
    page.context.set_offline(True)
    page.evaluate(
        "(to) => { location.hash = to; }", f"#/datasets/{street.dataset}/queue"
    )
    expect(page.get_by_role("button", name="Try again").first).to_be_visible()

    page.context.set_offline(False)

    expect(page.locator(".answer--keep").first).to_be_visible()
