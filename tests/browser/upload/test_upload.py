"""Dropped or picked files are matched to frames and sent."""

import base64
import json
import re
from pathlib import Path

import pytest
from playwright.sync_api import Page, Route, expect

from tests.support.folders import write_files
from tests.support.page import scenes
from tests.support.page.windows import Visitor, first_held, hold_timers, route_loaded

pytestmark = pytest.mark.browser

CAR_LINE = "0 0.25 0.694444 0.25 0.277778\n"
VOC = """<annotation><size><width>640</width><height>360</height></size>
<object><name>car</name><bndbox><xmin>81</xmin><ymin>201</ymin>
<xmax>240</xmax><ymax>300</ymax></bndbox></object></annotation>"""
DROP = """(files) => {
  const transfer = new DataTransfer();
  for (const [name, data] of files) {
    const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
    transfer.items.add(new File([bytes], name));
  }
  const init = { dataTransfer: transfer, bubbles: true, cancelable: true };
  document.body.dispatchEvent(new DragEvent("dragenter", init));
  window.dropzoneWasShown = new Promise((done) => requestAnimationFrame(() =>
    done(document.querySelector(".dropzone") !== null)));
  return window.dropzoneWasShown.then((was) => {
    document.body.dispatchEvent(new DragEvent("drop", init));
    return was;
  });
}"""


@pytest.fixture
def town(tmp_path: Path) -> Path:
    """A YOLO folder: three frames, an image without label, and a broken label."""
    root = tmp_path / f"town-{tmp_path.name.strip('_').lower()}"
    segmentation, picture = scenes.segmentation("palette"), scenes.picture()
    files = {"data.yaml": "names: [car, walker]\n", "images/stray.png": picture}
    for name in "123":
        files |= {f"images/{name}.png": picture, f"seg/{name}.png": segmentation}
        files[f"labels/{name}.txt"] = CAR_LINE
    write_files(root, {**files, "labels/broken.txt": "9 0.5 0.5 0.1 0.1\n"})
    return root


def pick_folder(user: Visitor, folder: Path) -> Page:
    page = user.open("#/datasets")
    page.get_by_label("Upload a folder").last.set_input_files(folder)
    expect(page.get_by_label("Dataset", exact=True)).to_be_visible()
    return page


def send(page: Page) -> None:
    page.get_by_role("button", name=re.compile(r"^Upload \d+ frame")).click()


def test_picked_folder_is_matched_and_uploaded(town, user, http):
    page = pick_folder(user, town)
    dialog = page.get_by_role("dialog", name="Upload")
    expect(
        page.get_by_role("dialog").get_by_label("Dataset", exact=True)
    ).to_have_value(town.name)
    expect(dialog.locator(".upload__sum")).to_have_text(
        re.compile(r"YOLO \(Ultralytics\) · 3 frames · 3 boxes · [\d.]+ kB")
    )
    expect(dialog.get_by_label("Cannot be read")).to_have_text(
        "broken labels/broken.txt, line 1: expected a class from 0 to 1, found '9'"
    )
    dialog.get_by_text("Did not match 1").click()
    expect(dialog.get_by_label("Did not match")).to_have_text(
        "images/stray.png no label file for this image"
    )

    send(page)
    page.get_by_role("link", name="Open the frames").click()

    expect(page.locator("a.thumb")).to_have_count(3)
    stored = scenes.get(http, f"/datasets/{town.name}")
    assert (stored["classes"], stored["counts"]["kept"]) == (["car", "walker"], 3)


def test_folder_sent_again_stores_what_has_changed_and_lists_set_aside_answers(
    town, user, http
):
    page = pick_folder(user, town)
    send(page)
    page.get_by_role("button", name="Close the upload").click()
    expect(page.get_by_role("heading", name=town.name)).to_be_visible()

    page = pick_folder(user, town)
    expect(page.locator("#upload-where")).to_contain_text("a dataset that has 3 frames")
    send(page)
    outcome = page.locator(".upload-panel__text")
    expect(outcome).to_have_text("0 frames stored · 3 there already")
    page.get_by_role("button", name="Close the upload").click()

    frame = scenes.get(http, f"/datasets/{town.name}/frames/1")
    path = f"/boxes/{frame['boxes'][0]['box_id']}/reviews"
    answer = {"verdict": "reject", "seen_revision": 0}
    assert http.post(path, json=answer).status_code == 201
    moved = CAR_LINE.replace("0.25", "0.3", 1)
    (town / "labels" / "1.txt").write_text(moved)

    page = pick_folder(user, town)
    page.get_by_label("Replace frames whose content has changed").check()
    send(page)

    expect(outcome).to_have_text(
        "1 frame stored · 2 there already · 1 answer set aside"
    )
    expect(page.get_by_label("Answers set aside")).to_have_text(
        re.compile(r"1 1 answer on boxes that changed or are gone: .+")
    )


def test_dropped_files_are_uploaded_to_the_current_dataset(scene, user):
    page = user.open(scene.link("ghost"))
    files = {
        "9.png": scenes.picture(),
        "9_seg.png": scenes.segmentation("raw"),
        "9.json": json.dumps({"boxes": scenes.BOXES}).encode(),
    }

    said = page.evaluate(DROP, encode_files(files))

    assert said
    name = page.get_by_role("dialog").get_by_label("Dataset", exact=True)
    expect(name).to_have_value(scene.dataset)
    send(page)
    expect(page.locator(".upload-panel__text")).to_have_text("1 frame stored")
    page.get_by_role("link", name="Open the frames").click()
    expect(page.locator("a.thumb")).to_have_count(2)


def encode_files(files: dict[str, bytes]) -> list[list[str]]:
    return [[name, base64.b64encode(data).decode()] for name, data in files.items()]


def test_upload_is_disabled_until_the_dataset_list_is_loaded(scene, user):
    page = user.open(f"#/datasets/{scene.dataset}/frames")
    expect(page.locator("a.thumb")).to_have_count(1)
    held: list[Route] = []
    route_loaded(page, "**/api/v1/datasets?*", lambda route: held.append(route))
    page.evaluate(DROP, encode_files({"9.png": scenes.picture()}))
    button = page.get_by_role("button", name="Upload 1 frame")

    expect(page.locator("#upload-where")).to_contain_text(
        "Loading the list of datasets"
    )
    expect(button).to_be_disabled()
    first_held(page, held).continue_()

    expect(page.locator("#upload-where")).to_contain_text("a dataset that has 1 frame")
    expect(button).to_be_enabled()


def test_files_are_read_in_the_chosen_layout_or_as_images_without_labels(scene, user):
    page = user.open(f"#/datasets/{scene.dataset}/frames")
    expect(page.locator("a.thumb")).to_have_count(1)
    files = {"v.xml": VOC.encode(), "v.png": scenes.picture(), "classes.txt": b"car"}

    yolo = {"w.txt": CAR_LINE.encode(), "w.png": scenes.picture()}
    page.evaluate(DROP, encode_files({**files, **yolo}))
    expect(page.locator(".upload__sum")).to_contain_text("Pascal VOC · 1 frame")
    page.get_by_role("combobox", name="Dataset").fill("typed")
    page.get_by_role("button", name="YOLO (Ultralytics)", exact=True).click()

    expect(page.locator(".upload__sum")).to_contain_text("YOLO (Ultralytics) · 1 frame")
    expect(page.get_by_text("Layout: YOLO (Ultralytics)")).to_be_visible()
    expect(page.get_by_role("combobox", name="Dataset")).to_have_value("typed")
    page.get_by_role("button", name="Cancel").click()

    page.evaluate(
        DROP, encode_files({"9.png": scenes.picture(), "9.txt": b"0 1 1 1 1"})
    )
    expect(page.get_by_role("alert")).to_contain_text("No frames were recognised")
    page.get_by_role("button", name="Upload the images only").click()

    expect(page.get_by_role("button", name="Upload 1 frame")).to_be_enabled()
    page.get_by_text("Did not match 1").click()
    expect(page.get_by_label("Did not match")).to_contain_text(
        "9.txt labels of another"
    )


def test_upload_dialog_that_cannot_be_loaded_keeps_the_files_and_can_be_retried(
    town, user
):
    page = user.open("#/datasets")
    route_loaded(page, "**/later.js", lambda route: route.abort())
    page.get_by_label("Upload a folder").last.set_input_files(town)
    dialog = page.get_by_role("dialog", name="Upload")
    expect(dialog.get_by_role("alert")).to_contain_text(
        "The upload dialog could not be loaded: Failed to fetch"
    )
    page.unroute("**/later.js")

    dialog.get_by_role("button", name="Try again").click()

    expect(dialog.locator(".upload__sum")).to_contain_text("3 frames")


def test_failed_folder_reading_can_be_retried_and_cancelled(town, user):
    page = user.open("#/datasets")
    route_loaded(page, "**/api/v1/folders?*", lambda route: route.abort())
    page.get_by_label("Upload a folder").last.set_input_files(town)
    expect(page.get_by_role("alert")).to_contain_text("The server does not answer")
    page.unroute("**/api/v1/folders?*")
    held: list[Route] = []
    route_loaded(page, "**/api/v1/folders?*", lambda route: held.append(route))

    page.get_by_role("button", name="Try again").click()
    expect(page.locator(".upload__reading")).to_contain_text("is reading 12 files")
    page.get_by_role("button", name="Cancel").click()

    expect(page.get_by_role("dialog", name="Upload")).to_have_count(0)


def test_refused_frames_are_listed_and_can_be_retried(town, user):
    """They are listed with the server's message.

    A file that was changed after it was picked cannot be read again by the browser.
    """
    seg = town / "seg" / "2.png"
    good = seg.read_bytes()
    seg.write_bytes(good[:200])
    page = pick_folder(user, town)

    send(page)

    expect(page.locator(".upload-panel__text")).to_have_text(
        "2 frames stored · 1 refused"
    )
    expect(page.get_by_label("Refused")).to_contain_text("2 ")
    expect(page.get_by_label("Refused")).to_contain_text("segmentation")
    seg.write_bytes(good)
    page.get_by_role("button", name="Retry refused frames").click()
    expect(page.get_by_label("Refused")).to_contain_text("can no longer be read")


def test_upload_waits_while_server_is_unavailable_and_can_be_resumed(town, user, http):
    page = pick_folder(user, town)
    # Or the page's own retry, after a second, could come before the click.
    hold_timers(page, 1000)
    route_loaded(page, re.compile("/frames/"), lambda route: route.abort())
    expect_phase = expect(page.locator(".upload-panel h2"))

    send(page)
    expect_phase.to_contain_text("The server does not answer")
    page.unroute(re.compile("/frames/"))
    page.get_by_role("button", name="Resume").click()

    expect(page.locator(".upload-panel__text")).to_have_text("3 frames stored")
    assert scenes.get(http, f"/datasets/{town.name}")["counts"]["frames"] == 3


def test_refused_new_dataset_shows_error_and_can_be_sent_again(town, user):
    page = pick_folder(user, town)
    problem = {"title": "Internal Server Error", "detail": "the disk is full"}
    refuse = re.compile("/api/v1/datasets$")
    route_loaded(page, refuse, lambda route: route.fulfill(status=500, json=problem))
    send(page)
    failure = page.get_by_role("dialog").get_by_role("alert")
    expect(failure).to_have_text("the disk is full")
    page.unroute(refuse)

    send(page)

    expect(page.locator(".upload-panel__text")).to_have_text("3 frames stored")


CANCEL_AND_PICK = """() => {
  const buttons = [...document.querySelectorAll("dialog button")];
  buttons.find(({ textContent }) => textContent === "Cancel").click();
  const picked = new DataTransfer();
  picked.items.add(new File(["no frame"], "a.md"));
  const field = document.querySelector("input[aria-label='Upload files']");
  field.files = picked.files;
  field.dispatchEvent(new Event("change", { bubbles: true }));
}"""


def test_files_picked_right_after_cancel_are_read(town, user):
    """The browser says only with its next picture that a dialog was closed."""
    page = pick_folder(user, town)

    page.evaluate(CANCEL_AND_PICK)

    expect(page.get_by_role("alert")).to_contain_text("No frames were recognised")


def test_invalid_dataset_name_and_folder_without_frames_show_errors(
    town, user, tmp_path
):
    page = pick_folder(user, town)
    page.get_by_label("Dataset", exact=True).fill("Town Ten")
    send(page)
    expect(page.locator("#upload-error")).to_contain_text("Use letters")

    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "a.md").write_text("no frame")
    page.get_by_role("button", name="Cancel").click()
    page.get_by_label("Upload a folder").last.set_input_files(tmp_path / "notes")

    expect(page.get_by_role("alert")).to_contain_text("No frames were recognised")
    expect(page.get_by_role("dialog")).to_contain_text("notes: no layout recognised")
