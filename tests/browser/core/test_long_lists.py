"""Lists that the API returns in pages: the view shows all items, or says how many more.

Here the pages are short, so that few items fill more than one.
"""

import json
import re

import pytest
from playwright.sync_api import Page, Route, expect

from tests.support.page import scenes

pytestmark = pytest.mark.browser


def shorten_pages(page: Page, path: str, items: int = 2) -> None:
    """Let pages of the list at this path of the API have so many items."""

    def ask_for_fewer(route: Route) -> None:
        url = re.sub(r"\blimit=\d+", f"limit={items}", route.request.url)
        route.continue_(url=url)

    page.route(re.compile(rf"/api/v1{path}\?"), ask_for_fewer)


def test_all_datasets_are_listed_and_known_to_an_upload(user, make_scene):
    """The dataset is the first one on the second page of the list."""
    scene, *others = (make_scene() for _ in range(3))
    listed = scenes.get(scene.http, "/datasets?limit=1000")["items"]
    names = [str(dataset["name"]) for dataset in listed]
    last = max(names.index(each.dataset) for each in (scene, *others))
    shorten_pages(user.page, "/datasets", last)
    page = user.open("#/datasets")
    heading = page.get_by_role("heading", name=names[last], exact=True)
    expect(heading).to_be_visible()

    contents = {
        "9.png": scenes.picture(),
        "9_seg.png": scenes.segmentation("raw"),
        "9.json": json.dumps({"boxes": scenes.BOXES}).encode(),
    }
    page.get_by_label("Upload files").last.set_input_files(
        [
            {"name": name, "mimeType": "application/octet-stream", "buffer": data}
            for name, data in contents.items()
        ]
    )

    page.get_by_label("Dataset", exact=True).fill(names[last])

    where = page.locator("#upload-where")
    expect(where).to_contain_text("Adds to a dataset that has 1 frame.")


def test_older_runs_exports_and_versions_are_shown_on_request(user, street):
    for percent in (40, 60, 70):  # a run after another
        street.decide(threshold_small_box=percent)
    runs = scenes.get(street.http, f"/datasets/{street.dataset}/runs")["items"]
    first, *others = sorted(int(run["id"]) for run in runs)
    path = f"/datasets/{street.dataset}/exports"
    for _ in range(3):
        assert street.http.post(path, json={"format": "yolo"}).status_code == 202
    shorten_pages(user.page, "/datasets/[^/]+/(runs|exports)")
    page = user.open(f"#/datasets/{street.dataset}/runs")
    expect(page.get_by_role("article", name=re.compile("^Run"))).to_have_count(2)

    page.get_by_role("button", name="Older runs").click()

    expect(page.get_by_role("article", name=f"Run {first}", exact=True)).to_be_visible()
    expect(page.get_by_role("article", name=re.compile("^Run"))).to_have_count(
        len(others) + 1
    )
    expect(page.get_by_role("button", name="Older runs")).to_have_count(0)

    exports = page.get_by_role("article", name=re.compile("^Export"))
    expect(exports).to_have_count(2)

    page.get_by_role("button", name="Older exports").click()

    expect(exports).to_have_count(3)

    shorten_pages(user.page, "/datasets/[^/]+/configs")
    page = user.open(f"#/datasets/{street.dataset}/thresholds")
    versions = page.get_by_role("region", name="Versions")
    expect(versions).to_contain_text("the newest 2 versions")

    versions.get_by_role("button", name="Older versions").click()

    expect(versions).to_contain_text("4 versions")
    expect(versions.locator("li")).to_have_count(4)

    shorten_pages(user.page, "/datasets/[^/]+/runs", 1)

    second = others[0]
    user.open(f"#/datasets/{street.dataset}/runs?run={second}&against={first}")

    row = page.get_by_role("row", name=re.compile(r"^threshold_small_box \d+ \d+$"))
    expect(row).to_be_visible()


def test_settings_say_how_many_more_frames_were_refused(user, street):
    bad = {"annotation": ("a.json", '{"boxes": [{"class": "car"}]}')}
    for number in range(3):
        street.http.put(f"/datasets/{street.dataset}/frames/bad{number}", files=bad)
    shorten_pages(user.page, "/datasets/[^/]+/problems")
    page = user.open(f"#/datasets/{street.dataset}/frames")

    page.get_by_role("button", name="Dataset settings").click()

    refused = page.get_by_role("dialog").locator(".filelist")
    expect(refused.locator("summary")).to_contain_text("3")
    expect(refused.get_by_role("listitem").last).to_have_text("and 1 more")
