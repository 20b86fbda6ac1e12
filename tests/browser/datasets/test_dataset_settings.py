"""The settings of a dataset: refused frames, description, reading of segmentations."""

import pytest
import yaml
from playwright.sync_api import Page, expect

from tests.support.page import scenes
from tests.support.page.scenes import Scene
from tests.support.page.windows import Visitor, route_loaded
from unghost.wire.datasets import DatasetPatch

pytestmark = [pytest.mark.browser, pytest.mark.long]


def open_settings(user: Visitor, scene: Scene) -> Page:
    page = user.open(f"#/datasets/{scene.dataset}/frames")
    page.get_by_role("button", name="Dataset settings").click()
    expect(page.get_by_role("dialog", name=scene.dataset)).to_be_visible()
    return page


def test_settings_list_refused_frames_and_the_api_values_and_delete(scene, user):
    bad = {"annotation": ("a.json", '{"boxes": [{"class": "car"}]}')}
    scene.http.put(f"/datasets/{scene.dataset}/frames/bad", files=bad)
    page = open_settings(user, scene)

    refused = page.get_by_label("Refused frames")

    expect(refused).to_contain_text("bad")
    expect(refused).to_contain_text("expected exactly one of xyxy")
    expect(page.locator(".page__settings")).to_contain_text("1 refused frame")
    properties = DatasetPatch.model_json_schema()["properties"]
    choices = {
        name: field["enum"] for name, field in properties.items() if "enum" in field
    }

    for name, values in choices.items():
        options = page.locator(f"select[name={name}] option")
        expect(options).to_have_text(values)
    expect(page.locator(".settings__grid select")).to_have_count(len(choices))
    expect(page.get_by_label("Description")).to_have_attribute("maxlength", "2000")
    page.get_by_text("Delete this dataset").click()
    expect(page.get_by_role("button", name="Delete")).to_be_disabled()

    page.get_by_label("Name of the dataset").fill(scene.dataset)
    page.get_by_role("button", name="Delete").click()

    expect(page.get_by_role("heading", name="Datasets", exact=True)).to_be_visible()
    assert scene.http.get(f"/datasets/{scene.dataset}").status_code == 404


def test_dataset_description_is_stored(scene, user):
    page = open_settings(user, scene)

    page.get_by_label("Description").fill("one car, and what is not there")
    page.get_by_role("button", name="Save").click()

    expect(page.get_by_role("dialog")).to_have_count(0)
    stored = scenes.get(scene.http, f"/datasets/{scene.dataset}")
    assert stored["description"] == "one car, and what is not there"


def test_description_of_the_recording_can_be_downloaded(scene, user):
    recording = {"layout": "voc", "boxes": {"unit": "pixels"}, "classes": {"é": "car"}}
    path = f"/datasets/{scene.dataset}"
    assert scene.http.patch(path, json={"recording": recording}).status_code == 200
    page = open_settings(user, scene)

    with page.expect_download() as download:
        page.get_by_role("button", name="Download recording.yaml").click()

    assert download.value.suggested_filename == "recording.yaml"
    assert yaml.safe_load(download.value.path().read_text("utf-8")) == recording
    expect(page.get_by_role("link", name="configuration")).to_be_visible()


def test_changed_palette_starts_a_run_and_links_to_it(scene, user):
    page = open_settings(user, scene)

    page.locator("select[name=palette]").select_option("auto")
    page.get_by_role("button", name="Save").click()
    page.get_by_role("link", name="Show the run").click()

    expect(page).to_have_url(f"{user.url}/#/datasets/{scene.dataset}/runs")


def test_refused_palette_change_shows_the_servers_error(scene, user):
    page = open_settings(user, scene)
    problem = {"title": "Conflict", "detail": "a run is going on", "status": 409}
    route_loaded(
        page,
        f"**/datasets/{scene.dataset}",
        lambda route: route.fulfill(status=409, json=problem),
    )

    page.locator("select[name=palette]").select_option("auto")
    page.get_by_role("button", name="Save").click()

    expect(page.get_by_text("a run is going on")).to_be_visible()
