"""The views of runs and exports: progress, cancelling, comparing, downloading."""

import hashlib
import re
import zipfile
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.support.api import Api
from tests.support.databases import hold_write_lock
from tests.support.page import many_boxes, scenes
from tests.support.page.scenes import Scene
from tests.support.page.windows import PHONE, Visitor
from tests.support.servers import RunningServer
from tests.support.slow_datasets import FROM_PIXELS, OTHER_PIXELS, create_slow_dataset
from tests.support.waiting import until

pytestmark = pytest.mark.browser

FRAMES = 16
PIXEL_KEYS = ("profile", "projection", "channel_order")


@pytest.fixture
def long_street(street: Scene) -> Iterator[Scene]:
    """A street of so many frames that measuring them again takes a visible time.

    Its dataset is deleted afterwards, and with it the runs that the next test would
    have to wait for.
    """
    for number in range(2, FRAMES + 2):
        scenes.push(street.http, street.dataset, f"run/{number:06d}")
    yield street
    name = street.dataset
    deleted = street.http.delete(f"/datasets/{name}?confirm={name}")
    assert deleted.status_code == 204, deleted.text


@pytest.fixture
def slow_street(server: RunningServer) -> Iterator[tuple[Api, str]]:
    """A client, and a dataset whose runs take much longer than requesting one.

    It is deleted afterwards, like `long_street`.
    """
    api = Api.at(server.url, server.headers)
    with api.http:
        street = create_slow_dataset(api, 20)
        yield api, street
        deleted = api.delete(f"/datasets/{street}?confirm={street}")
        assert deleted.status_code == 204, deleted.text


def runs_page(user: Visitor, street: Scene, query: str = "") -> Page:
    page = user.open(f"#/datasets/{street.dataset}/runs{query}")
    expect(page.locator("article.run").first).to_be_visible()
    return page


def start_run(street: Scene, **config: object) -> int:
    body = {"config": config, "activate": True}
    response = street.http.post(f"/datasets/{street.dataset}/runs", json=body)
    assert response.status_code == 202, response.text
    number: int = response.json()["id"]
    return number


def run(page: Page, number: int) -> Locator:
    return page.get_by_role("article", name=f"Run {number}", exact=True)


def test_run_is_shown_until_done_and_what_is_cancelled_changes_nothing(
    user, server, long_street
):
    page = runs_page(user, long_street)
    number = start_run(long_street, profile="carlasimu")

    expect(run(page, number)).to_be_visible(timeout=15_000)
    expect(run(page, number)).to_contain_text("measured again")

    expect(run(page, number).locator(".statebadge--done")).to_be_visible()

    # Exports are written one after another: the last is still queued when cancelled.
    path = f"/datasets/{long_street.dataset}/exports"
    responses = [
        long_street.http.post(path, json={"format": "yolo"}) for _ in range(12)
    ]
    number = responses[-1].json()["id"]

    # Until the button is found, no export goes on.
    with hold_write_lock(server.data):
        page.reload()
        page.get_by_role("button", name=f"Cancel export {number}").click()

    row = page.get_by_role("article", name=f"Export {number}", exact=True)
    expect(row.locator(".statebadge--cancelled")).to_be_visible()
    expect(row).to_contain_text("nothing was written")
    stored = long_street.http.get(f"/exports/{number}").json()
    assert (stored["state"], stored["download"]) == ("cancelled", None)

    # Runs follow one another, and each measures all pixels: the last is still queued.
    for choice in product(("paper", "carlasimu"), ("naive", "clipped"), ("rgb", "bgr")):
        keys = dict(zip(PIXEL_KEYS, choice, strict=True))
        number = start_run(long_street, **keys, threshold_small_box=77)

    # Until the button is found, no run goes on.
    with hold_write_lock(server.data):
        page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
        page.get_by_role("button", name=f"Cancel run {number}").click()

    expect(run(page, number).locator(".statebadge--cancelled")).to_be_visible()
    expect(run(page, number)).to_contain_text("nothing was changed")
    stored = long_street.http.get(f"/runs/{number}").json()
    assert (stored["state"], stored["changed"]) == ("cancelled", 0)


def test_open_jobs_do_not_use_up_the_browser_connections(user, server, slow_street):
    """A browser opens six connections to a server, shared by all its tabs.

    Formerly each open job occupied one of them.
    """
    api, street = slow_street
    numbers = [
        api.post(f"/datasets/{street}/runs", {"config": config}).json()["id"]
        for config in (FROM_PIXELS, *OTHER_PIXELS)
    ]
    with hold_write_lock(server.data):
        page = user.open(f"#/datasets/{street}/runs")
        open_now = page.locator(".statebadge--queued, .statebadge--running")
        expect(open_now.nth(6)).to_be_visible()

        another = page.context.new_page()
        another.goto(page.url.replace("/runs", "/grid"))
        expect(another.locator("[id^=cell-]").first).to_be_visible()
        another.close()

    # The others follow one after another, which takes long on a slow machine.
    expect(run(page, numbers[0]).locator(".statebadge--done")).to_be_visible()


def hidden_columns(page: Page) -> list[str]:
    """The headings of columns that tables show only when they are scrolled."""
    hidden: list[str] = page.locator(".tablewrap").evaluate_all(
        """wraps => wraps.flatMap((wrap) => {
          const end = wrap.getBoundingClientRect().right + 1;
          return [...wrap.querySelectorAll("thead th")]
            .filter((cell) => cell.getBoundingClientRect().right > end)
            .map((cell) => cell.textContent);
        })"""
    )
    return hidden


def test_run_shows_its_counts_and_two_are_compared_by_class_key_and_box(user, street):
    first = start_run(street, threshold_small_box=40)
    page = runs_page(user, street)
    expect(run(page, first)).to_contain_text("done")
    expect(run(page, first)).to_contain_text("active")
    expect(run(page, first)).to_contain_text("1 kept · 1 rejected · 1 changed")
    second = start_run(street, threshold_small_box=60)
    page.reload()

    page.get_by_role("link", name=f"What changed in run {second}").click()

    expect(
        page.get_by_role("heading", name=f"What run {second} changed")
    ).to_be_visible()
    expect(page.get_by_role("row", name="car 1")).to_be_visible()
    expect(page.get_by_role("row", name="threshold_small_box 40 60")).to_be_visible()
    expect(page.locator(".flip--rejected")).to_have_count(1)
    expect(page).to_have_url(re.compile(rf"run={second}$"))
    sides = page.locator(".flip--rejected .flip__side")
    expect(sides.nth(0)).to_contain_text(f"kept in run {first}: match")
    expect(sides.nth(1)).to_contain_text(f"rejected in run {second}: match")

    against = page.get_by_label("Run to compare with")
    expect(against).to_have_value(str(first))
    began = street.http.get(f"/datasets/{street.dataset}/runs").json()["items"][-1][
        "id"
    ]
    against.select_option(str(began))

    expect(page.locator(".flip--rejected")).to_have_count(2)
    expect(page.get_by_role("row", name="threshold_small_box 10 60")).to_be_visible()


def test_difference_of_runs_shows_the_values_of_both(user, street):
    own = {"threshold_small_box": 60, "threshold_big_box": 60}
    street.decide(classes={"traffic_light": own, "car": own})
    path = f"/datasets/{street.dataset}/runs"
    number = scenes.get(street.http, path)["items"][0]["id"]

    page = user.open(f"#{path}?run={number}")

    row = page.get_by_role("row", name="classes.traffic_light.threshold_small_box")
    expect(row).to_contain_text("60")
    assert hidden_columns(page) == []


def test_first_run_no_export_and_no_dataset_are_called_that(user, http, street):
    page = runs_page(user, street)
    runs = page.get_by_role("article", name=re.compile("^Run"))

    expect(runs).to_contain_text("Created with the dataset.")
    expect(runs).not_to_contain_text("again")
    expect(page.get_by_text("No export yet")).to_be_visible()

    empty = f"{street.dataset}-empty"
    assert http.post("/datasets", json={"name": empty}).status_code == 201
    scenes.decide(http, empty, {"threshold_small_box": 40})
    user.open(f"#/datasets/{empty}/runs")
    expect(runs).to_have_count(2)
    expect(runs.nth(0)).to_contain_text("decided again")
    expect(runs.nth(0)).to_contain_text("There were no boxes.")
    expect(runs.nth(1)).not_to_contain_text("decided again")

    user.open("#/datasets/nothing-here/runs")
    expect(page.get_by_role("alert")).to_contain_text("nothing-here")


def test_export_is_made_and_its_download_matches_the_checksum(user, street, tmp_path):
    page = runs_page(user, street)
    page.get_by_role("button", name="New export").click()
    page.locator(".formatcard", has_text="COCO").click()
    page.get_by_role("combobox", name=re.compile("^Images")).select_option("none")

    page.get_by_role("button", name="Make export").click()

    made = page.get_by_role("article", name=re.compile("^Export"))
    expect(made).to_contain_text("done")
    expect(made).to_contain_text("boxes written2")
    expect(made).to_contain_text("images: left out, labels alone")
    with page.expect_download() as downloading:
        made.get_by_role("button", name=re.compile("^Download")).click()
    archive = tmp_path / "export.zip"
    downloading.value.save_as(archive)
    shown = made.locator("code[title]").get_attribute("title")
    assert hashlib.sha256(archive.read_bytes()).hexdigest() == shown
    assert any(name.endswith(".json") for name in members(archive))
    made.get_by_role("button", name=re.compile("^Delete export")).click()
    dialog = page.get_by_role("dialog", name=re.compile(r"^Delete export \d+ \(COCO"))
    dialog.get_by_role("button", name="Delete").click()
    expect(dialog).to_have_count(0)
    expect(made).to_have_count(0)
    path = f"/datasets/{street.dataset}/exports"
    assert scenes.get(street.http, path)["items"] == []


def test_export_whose_file_was_deleted_says_why_and_offers_no_download(user, street):
    path = f"/datasets/{street.dataset}/exports"
    street.http.post(path, json={"format": "yolo"})
    until(lambda: scenes.get(street.http, path)["items"][0]["state"] == "done")
    (item,) = scenes.get(street.http, path)["items"]
    why = {"code": "export_removed", "detail": "its file was deleted after 30 days"}
    gone = item | {"sha256": None, "download": None, "error": why}
    reply = {"items": [gone], "next_cursor": None}
    user.page.route("**/exports?*", lambda route: route.fulfill(json=reply))

    page = runs_page(user, street)

    row = page.get_by_role("article", name=re.compile("^Export"))
    expect(row).to_contain_text("No file: its file was deleted after 30 days.")
    expect(row.get_by_role("button", name=re.compile("^Delete"))).to_be_visible()
    expect(row.get_by_role("button", name=re.compile("^Download"))).to_have_count(0)


def members(archive: Path) -> list[str]:
    with zipfile.ZipFile(archive) as opened:
        return opened.namelist()


def test_export_form_offers_every_format_and_only_options_of_the_chosen_one(
    user, street
):
    schema = street.http.get(f"{user.url}/openapi.json").json()["components"]["schemas"]
    page = runs_page(user, street)
    page.get_by_role("button", name="New export").click()
    expect(page.locator(".formatcard").first).to_be_visible()
    offered = page.locator(".formatcard input").evaluate_all(
        "inputs => inputs.map(input => input.value)"
    )
    assert offered == schema["ExportIn"]["properties"]["format"]["enum"]
    rejected = page.get_by_label("Rejected boxes", exact=True)
    page.get_by_role("radio", name=re.compile("^COCO")).check()
    rejected.select_option("dontcare")

    page.get_by_role("radio", name=re.compile("^YOLO")).check()

    expect(page.get_by_label("Rectangle")).to_be_visible()
    expect(rejected).to_have_count(0)
    shares = page.get_by_label("Shares of train, val, test")
    shares.fill("0, 1, 0")
    expect(page.locator(".ask__parts")).to_contain_text("in val (100 %, ")
    shares.fill("0.5, 0.25, 0.25")
    page.get_by_role("button", name="Make export").click()
    made = page.get_by_role("article", name=re.compile("^Export"))
    expect(made).to_contain_text("split 50/25/25")
    expect(made).to_contain_text(re.compile(r"in (train|val|test) \(\d+ %"))
    page.get_by_role("button", name="New export").click()
    page.get_by_role("radio", name=re.compile("CSV")).check()
    expect(page.locator(".ask__fields")).to_have_count(0)
    page.get_by_role("button", name="Make export").click()
    expect(made).to_have_count(2)
    expect(made.first).not_to_contain_text("split")


def test_page_does_not_scroll_past_the_end_of_a_long_list_of_flips(
    make_scene, open_window
):
    scene = make_scene(boxes=many_boxes.alternating_boxes(80))
    scene.decide(max_distance=1)
    path = f"/datasets/{scene.dataset}/runs"
    number = scenes.get(scene.http, path)["items"][0]["id"]
    user = open_window(viewport=PHONE)
    page = runs_page(user, scene, f"?run={number}")
    expect(page.locator(".flip")).to_have_count(40)

    below = page.evaluate(
        "document.documentElement.scrollHeight - scrollY"
        " - document.querySelector('main').getBoundingClientRect().bottom"
    )

    assert below <= 1


def test_export_with_an_invalid_number_is_refused_or_not_even_requested(user, street):
    page = runs_page(user, street)
    page.get_by_role("button", name="New export").click()
    field = page.get_by_label("Labels per distance, metres").last
    field.fill("-5")
    page.get_by_role("button", name="Make export").click()
    expect(page.locator(".ask").get_by_role("alert")).to_contain_text("bands")
    path = f"/datasets/{street.dataset}/exports"
    assert scenes.get(street.http, path)["items"] == []

    field.fill("")
    field.press_sequentially("50, 100, 20O")

    page.get_by_role("button", name="Make export").click()

    assert not field.evaluate("field => field.checkValidity()")
    expect(field).to_have_accessible_description(
        "Expected numbers, separated by commas, found 50, 100, 20O."
    )
    assert scenes.get(street.http, path)["items"] == []
    field.fill("50, 100, 200")
    page.get_by_role("button", name="Make export").click()
    expect(page.get_by_role("article", name=re.compile("^Export"))).to_be_visible()
    (made,) = scenes.get(street.http, path)["items"]
    assert made["options"]["bands"] == [50, 100, 200]


def test_retry_button_keeps_focus_while_the_run_list_keeps_failing(open_window, street):
    user = open_window(own=True)
    user.page.clock.install()
    user.page.route("**/runs?*", lambda route: route.fulfill(status=500))
    page = user.open(f"#/datasets/{street.dataset}/runs")
    button = page.get_by_role("button", name="Try again")
    button.focus()

    page.clock.run_for(20_000)

    expect(button).to_be_focused()
