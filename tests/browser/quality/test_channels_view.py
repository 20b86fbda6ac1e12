"""The view that compares measuring channels with instances and with people."""

import re

import httpx
import pytest
from playwright.sync_api import Locator, Page, expect

from tests.support.api import BY_TAGS
from tests.support.page import scenes
from tests.support.page.windows import Visitor
from tests.support.sensors import ANNOTATION, experiment_report, sensors
from tests.support.waiting import until

pytestmark = pytest.mark.browser

ROWS = 7
"""No filter, then every kind of evidence."""


@pytest.fixture
def dataset(http: httpx.Client, request: pytest.FixtureRequest) -> str:
    """One frame with depth and instances: a car, and a ghost behind it."""
    name = re.sub(r"\W+", "-", request.node.name).strip("-")[:60]
    made = http.post("/datasets", json={"name": name, "config": BY_TAGS})
    assert made.status_code == 201, made.text
    scenes.put(http, name, "a", ANNOTATION, **sensors())
    return name


def panel(page: Page) -> Locator:
    return page.get_by_role("region", name="Kinds of evidence compared")


def measured(user: Visitor, dataset: str) -> Locator:
    """The panel of channels after "Measure every kind", when all rows are there."""
    page = user.open(f"#/datasets/{dataset}/quality")
    panel(page).get_by_role("button", name="Measure every kind").click()
    rows = panel(page).locator("tbody tr")
    expect(rows).to_have_count(ROWS, timeout=20_000)
    # Until the run's strip is gone, what is below it may still move.
    expect(page.locator(".runstrip")).to_have_count(0)
    expect(panel(page)).to_have_attribute("aria-busy", "false")
    return panel(page)


def test_measured_channels_are_compared_by_class_distance_and_with_people(
    user, http, dataset
):
    channels = measured(user, dataset)

    unfiltered = channels.get_by_role("row", name=re.compile("^No filter"))
    expect(unfiltered).to_contain_text("50 %")
    segmentation = channels.get_by_role("row", name=re.compile("^Segmentation active"))
    expect(segmentation).to_contain_text("50 %")
    expect(segmentation.locator("td").nth(4)).to_have_text("1")
    expect(
        channels.get_by_role("row", name=re.compile("^Depth pixels"))
    ).to_contain_text("100 %")
    expect(channels).to_contain_text("2 boxes of 1 frame")
    expect(channels.get_by_role("button", name="Measure every kind")).to_have_count(0)
    boxes = http.get("/boxes", params={"dataset": dataset}).json()["items"]
    assert [box["verdict"] for box in boxes] == ["kept", "kept"]

    channels.get_by_role("button", name="Distance").click()
    expect(channels.get_by_role("row", name=re.compile("^0–50 m"))).to_be_visible()

    channels.get_by_role("button", name="Class").click()
    expect(channels.get_by_role("row", name=re.compile("^car"))).to_be_visible()

    channels.get_by_role("button", name="People").click()
    expect(channels).to_contain_text("Nobody has kept or rejected a box yet")
    for box in http.get("/boxes", params={"dataset": dataset}).json()["items"]:
        body = {"verdict": "keep", "seen_revision": box["revision"]}
        http.post(f"/boxes/{box['box_id']}/reviews", json=body)

    user.page.reload()

    assert user.page.url.endswith("truth=people")
    depth = channels.get_by_role("row", name=re.compile("^Depth pixels"))
    expect(depth.get_by_role("link", name="Look at 1")).to_be_visible()


def test_boxes_that_a_channel_got_wrong_open_as_a_queue(user, http, dataset):
    channels = measured(user, dataset)
    expect(
        channels.get_by_role("link", name=re.compile("that Depth got"))
    ).to_have_count(0)

    channels.get_by_role("link", name="Look at 1 that Segmentation got wrong").click()

    page = user.page
    # The address soon names the box as well.
    expect(page).to_have_url(re.compile(rf"/{dataset}/queue\?boxes=(\d+)(&box=\1)?$"))
    expect(page.locator(".queue__listed")).to_contain_text("1 chosen box")
    expect(page.locator(".inspector__head h2")).to_have_text(re.compile(r"218 ?$"))
    user.press("x")
    user.wait_until_saved()
    expect(page.locator(".queue__message")).to_contain_text("1 rejected")
    listed = http.get("/boxes", params={"dataset": dataset, "review": "reject"}).json()
    assert [box["id"] for box in listed["items"]] == ["218"]

    page.locator(".queue__head").get_by_role("button", name="The whole queue").click()
    expect(page).to_have_url(re.compile(rf"/{dataset}/queue$"))
    expect(page.locator(".queue__listed")).to_have_count(0)


def test_filter_is_compared_with_instances_without_answers(user, dataset):
    page = user.open(f"#/datasets/{dataset}/quality")
    page.get_by_role("button", name="Compare with instances").click()
    expect(page).to_have_url(re.compile("against=instances$"))
    expect(page.get_by_text("No instances have been measured")).to_be_visible()

    panel(page).get_by_role("button", name="Measure every kind").click()

    expect(page.locator(".matrixcell__count")).to_have_text(
        ["1", "1", "0", "0"], timeout=20_000
    )
    expect(page.locator("a.matrixcell")).to_have_count(0)
    expect(page.locator(".matrix")).to_contain_text("is not visible")
    card = page.get_by_role("article", name="car")
    expect(card).to_contain_text("2 boxes")


def test_box_decided_by_depth_names_the_deciding_channel(user, http, dataset):
    body = {"config": {"evidence": "depth"}, "activate": True}
    started = http.post(f"/datasets/{dataset}/runs", json=body)
    assert started.is_success, started.text
    ghost = rejected(http, dataset)

    page = user.open(f"#/datasets/{dataset}/queue?boxes={ghost}")

    decided = page.locator(".match--other")
    expect(decided).to_contain_text("Decided by Depth")
    expect(decided).to_contain_text("0 pixels seen")
    expect(decided).to_contain_text("which did not decide")
    expect(page.locator(".match__track")).to_have_count(0)


def rejected(http: httpx.Client, dataset: str) -> int:
    """The id of the one rejected box; waits until the measuring run is done."""
    filters = {"dataset": dataset, "verdict": "rejected"}
    (box,) = until(lambda: http.get("/boxes", params=filters).json()["items"])
    return int(box["box_id"])


def test_without_instance_image_page_offers_compare_with_people(user, scene):
    page = user.open(f"#/datasets/{scene.dataset}/quality")
    panel(page).get_by_role("button", name="Measure every kind").click()

    button = panel(page).get_by_role("button", name="Compare with people")
    expect(button).to_be_visible(timeout=20_000)
    button.click()

    expect(page).to_have_url(re.compile("truth=people$"))


def test_report_of_an_experiment_is_drawn_with_its_verdict(user, http, dataset):
    page = user.open(f"#/datasets/{dataset}/quality")
    report = page.get_by_role("region", name="Is it worth it?")
    expect(report).to_contain_text(
        f"unghost worth-it SOURCE --no-train --dataset {dataset}"
    )
    stored = http.put(f"/datasets/{dataset}/experiment", json=experiment_report())
    assert stored.status_code == 200

    page.reload()

    depth = report.get_by_role("row", name=re.compile("^depth"))
    expect(depth).to_contain_text(re.compile(r"21\s327"))
    expect(depth).to_contain_text("+6 +5 to +7")
    random = report.get_by_role("row", name=re.compile("^random"))
    expect(random).to_contain_text("no difference shown")
    expect(report).to_contain_text("Better: depth.")
