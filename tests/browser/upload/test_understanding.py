"""The upload dialog shows how dropped files are understood, and takes corrections."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from playwright.sync_api import Locator, Page, expect

from filter_core.segmentation.palettes import FAMILIES
from tests.support.folders import write_files
from tests.support.page import scenes
from tests.support.page.windows import Visitor
from tests.support.pictures import png

pytestmark = pytest.mark.browser

CAR: dict[str, Any] = {"id": "7", "class": "car", "xyxy": scenes.CAR}
GHOST = {"id": "8", "class": "car", "xyxy": scenes.SKY}
MISSPELT = {"id": "9", "class": "caar", "xyxy": scenes.CAR}
DEPTH = png(np.full((scenes.HEIGHT, scenes.WIDTH, 3), (9, 1, 0), np.uint8))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return tmp_path / f"run-{tmp_path.name.strip('_').lower()}"


def write_recording(root: Path, boxes: list[dict[str, Any]], **more: bytes) -> None:
    """One frame of images with endings, and what belongs to none."""
    files = {
        "1.png": scenes.picture(),
        "1_semseg.png": scenes.segmentation("palette"),
        "1_depth.png": DEPTH,
        "1.json": json.dumps({"boxes": boxes}),
        "notes.bin": b"no frame",
    }
    write_files(root, {**files, **more})


def pick(user: Visitor, folder: Path) -> Locator:
    page = user.open("#/datasets")
    page.get_by_label("Upload a folder").last.set_input_files(folder)
    dialog = page.get_by_role("dialog", name="Upload")
    expect(dialog.locator(".understood")).to_be_visible()
    return dialog


def upload(dialog: Locator, page: Page) -> None:
    dialog.get_by_role("button", name="Upload 1 frame").click()
    expect(page.locator(".upload-panel__text")).to_have_text("1 frame stored")


def downloaded(dialog: Locator, page: Page) -> dict[str, object]:
    """The description that the dialog offers."""
    with page.expect_download() as download:
        dialog.get_by_role("button", name="Download recording.yaml").click()
    assert download.value.suggested_filename == "recording.yaml"
    content: dict[str, object] = yaml.safe_load(download.value.path().read_text())
    return content


def drawn(canvas: Locator) -> int:
    """The brightest level of a thumbnail; 0 until it is drawn."""
    script = "(one) => Math.max(...one.getContext('2d').getImageData(0, 0, 9, 9).data"
    return int(canvas.evaluate(f"{script}.filter((_, at) => at % 4 < 3))"))


def test_recording_is_understood_and_uploaded_with_its_description(root, user, http):
    write_recording(root, [CAR, GHOST])
    dialog = pick(user, root)
    page = user.page

    expect(dialog.locator(".understood__head")).to_have_text(
        re.compile(
            r"Images and segmentations · 1 frame · 2 boxes · [\d.]+ kB"
            r"recognised by images, in a folder of no other layout"
        )
    )
    row = dialog.get_by_role("row", name=re.compile("^car 2"))
    expect(row).to_contain_text("1 kept · 1 rejected")
    expect(row.get_by_label("Measure car as")).to_have_value("car")
    expect(dialog.locator(".legend")).to_have_text("keptrejected")
    roles = dialog.get_by_role("combobox", name=re.compile("^Role of"))
    expect(roles).to_have_count(3)
    for name, role in (("", "image"), ("_semseg", "segmentation"), ("_depth", "depth")):
        expect(dialog.get_by_label(f"Role of 1{name}.png")).to_have_value(role)
    for thumbnail in dialog.locator("canvas").all():
        # The depth is darker than can be seen, and is made brighter.
        page.wait_for_function(
            "(one) => one.width < 200", arg=thumbnail.element_handle()
        )
        assert drawn(thumbnail) >= scenes.GREY
    palette = dialog.get_by_label("Palette", exact=True)
    expect(palette).to_contain_text("auto: carla-0.9.14")
    dialog.get_by_text("Did not match 1").click()
    expect(dialog.get_by_label("Did not match")).to_contain_text("notes.bin neither")

    # Boxes are explained to the pointer, and to the keyboard.
    frame = dialog.locator("figure")
    boxes = frame.get_by_role("group", name="2 boxes of 1").get_by_role("img")
    boxes.first.focus()
    expect(frame.locator("figcaption")).to_contain_text("car kept: 100 % of its pixels")
    page.keyboard.press("ArrowRight")
    expect(boxes.last).to_be_focused()
    expect(frame.locator("figcaption")).to_contain_text("car rejected: none of its")
    boxes.first.hover()
    expect(frame.locator("figcaption")).to_contain_text("car kept")

    assert http.get(f"/datasets/{root.name}").status_code == 404
    description = downloaded(dialog, page)
    assert description["layout"] == "pairs"
    upload(dialog, page)
    stored = scenes.get(http, f"/datasets/{root.name}")
    assert (stored["counts"]["kept"], stored["counts"]["rejected"]) == (1, 1)
    # The file that did not match.
    assert stored["recording"] == {**description, "companions": {".": 1}}


def test_dropped_folder_is_listed_with_its_folders(root, user):
    for number in range(120):  # more than a browser lists at a time
        write_files(root / "a" / "b", {f"{number}.png": scenes.picture()})
    page = user.open("#/datasets")
    browser = page.context.new_cdp_session(page)

    expect(page.get_by_role("button", name="Upload a folder").last).to_be_visible()
    for event in ("dragEnter", "dragOver", "drop"):
        data = {"items": [], "files": [str(root)], "dragOperationsMask": 1}
        place = {"type": event, "x": 200, "y": 200, "data": data}
        browser.send("Input.dispatchDragEvent", place)

    expect(page.locator(".upload__sum")).to_contain_text("120 frames")
    expect(page.get_by_label("Dataset", exact=True)).to_have_value(root.name)
    expect(page.get_by_label("Role of a/b/0.png")).to_have_value("image")


def test_class_is_corrected_undone_and_corrected_again(root, user, http):
    write_recording(root, [MISSPELT, GHOST])
    dialog = pick(user, root)
    remarks = dialog.get_by_role("list", name="What to look at")
    expect(remarks).to_have_text(re.compile("does not know its class: caar"))
    remarks.get_by_role("button", name="Choose for caar").click()
    as_what = dialog.get_by_label("Measure caar as")
    expect(as_what).to_be_focused()
    expect(as_what).to_have_value("")

    dialog.get_by_role("button", name="Is it car?").click()

    correction = dialog.get_by_text("Classes: caar measured as car")
    expect(correction).to_be_visible()
    expect(as_what).to_have_value("car")
    expect(remarks).to_have_count(0)
    row = dialog.get_by_role("row", name=re.compile("^caar"))
    expect(row).to_contain_text("1 kept")
    dialog.get_by_role("button", name="Undo: Classes: caar measured as car").click()
    expect(as_what).to_have_value("")
    expect(correction).to_have_count(0)
    as_what.select_option("car")
    expect(row).to_contain_text("1 kept")
    assert downloaded(dialog, user.page)["classes"] == {"caar": "car"}
    upload(dialog, user.page)

    stored = scenes.get(http, f"/datasets/{root.name}")
    assert (stored["counts"]["kept"], stored["counts"]["unmeasured"]) == (1, 0)
    assert stored["recording"]["classes"] == {"caar": "car"}


def test_roles_of_images_are_corrected(root, user):
    """Two kinds of images may be the segmentations; one shows no car."""
    palette = FAMILIES[scenes.FAMILY]
    tags = scenes.tags()
    tags[tags == palette.tag_of("Car")] = palette.tag_of("Road")
    empty = png(palette.paint(tags))
    write_recording(root, [CAR], **{"1_gt.png": empty, "1_mask.png": empty})
    dialog = pick(user, root)
    row = dialog.get_by_role("row", name=re.compile("^car 1"))

    def choose(name: str, role: str) -> None:
        dialog.get_by_label(f"Role of 1_{name}.png").select_option(role)
        expect(dialog.locator("[aria-busy=true]")).to_have_count(0)

    choose("gt", "segmentation")
    expect(row).to_contain_text("1 rejected")
    expect(dialog.get_by_text("Images: {frame}_gt.png is segmentation")).to_be_visible()
    expect(dialog.get_by_label("Role of 1_semseg.png")).to_have_value("")
    choose("semseg", "segmentation")
    choose("mask", "")

    expect(row).to_contain_text("1 kept")
    expect(dialog.get_by_label("Role of 1_gt.png")).to_have_value("")
    expect(dialog.locator(".upload__sum")).to_contain_text("1 frame · 1 box")
    assert downloaded(dialog, user.page)["files"] == {
        "image": "{frame}.png",
        "segmentation": "{frame}_semseg.png",
        "depth": "{frame}_depth.png",
        "ignore": ["{frame}_gt.png", "{frame}_mask.png"],
    }


def test_unit_is_said_before_frames_can_be_uploaded(root, user, http):
    x_min, y_min, x_max, y_max = scenes.CAR
    across, down = scenes.WIDTH, scenes.HEIGHT
    shares = [x_min / across, y_min / down, x_max / across, y_max / down]
    boxes = [
        {"id": n, "class": "car", "xyxy": [share + n / 1000 for share in shares]}
        for n in range(3)
    ]
    # What a person wrote beside the data stays.
    settings = {
        "segmentation": {"palette": "carla-0.9.14"},
        "classes": {"Misc": "pass"},
    }
    description = json.dumps(settings).encode()
    write_recording(root, boxes, **{"recording.yaml": description})
    dialog = pick(user, root)
    expect(dialog.get_by_role("button", name="Nothing to upload")).to_be_disabled()
    expect(dialog.locator(".upload__sum")).to_contain_text("1 frame, of which none can")
    remark = dialog.get_by_role("list", name="What to look at").get_by_role("listitem")
    expect(remark.first).to_contain_text("The boxes look like shares of the image's")

    remark.get_by_role("button", name="Read as shares").click()

    expect(dialog.get_by_text("Boxes: unit shares")).to_be_visible()
    upload(dialog, user.page)
    stored = scenes.get(http, f"/datasets/{root.name}")
    assert stored["counts"]["kept"] == 3
    assert stored["recording"]["boxes"] == {"unit": "shares"}
    assert stored["recording"]["classes"] == settings["classes"]


NOTE_LONG_TASKS = """() => {
  window.longTasks = [];
  addEventListener("change", ({ timeStamp }) => new PerformanceObserver((list) =>
    window.longTasks.push(...list.getEntries()
      .filter(({ startTime }) => startTime > timeStamp)
      .map(({ duration }) => duration))).observe({ type: "longtask" }), true);
}"""
"""Notes how long the page was busy at a time, after files were picked."""


@pytest.mark.long
def test_ten_thousand_files_are_understood_while_the_page_stays_fluid(root, user):
    picture, segmentation = scenes.picture(), scenes.segmentation("palette")
    line = "0 0.25 0.694444 0.25 0.277778\n"
    for number in range(3333):
        files = {
            f"images/{number}.png": picture,
            f"seg/{number}.png": segmentation,
            f"labels/{number}.txt": line,
        }
        write_files(root, files)
    write_files(root, {"data.yaml": "names: [car]"})
    page = user.open("#/datasets")
    page.evaluate(NOTE_LONG_TASKS)

    page.get_by_label("Upload a folder").last.set_input_files(root)
    expect(page.locator(".upload__sum")).to_contain_text("3\u2009333 frames")

    # About 50 ms on a machine that does nothing else.
    assert max(page.evaluate("window.longTasks"), default=0) < 500
    expect(page.get_by_role("row", name=re.compile("^car"))).to_contain_text("kept")
    expect(page.get_by_text("unghost push run-")).to_be_visible()


def test_columns_of_an_unknown_table_are_chosen_by_clicks(root, user, http):
    x0, y0, x1, y1 = scenes.CAR
    rows = f"Picture file;a0;b0;a1;b1;Kind of thing\n1.png;{x0};{y0};{x1};{y1};car\n"
    files = {"1.png": scenes.picture(), "1_semseg.png": scenes.segmentation("palette")}
    write_files(root, {**files, "all.csv": rows})
    dialog = pick(user, root)
    columns = dialog.get_by_role("region", name="Boxes in all.csv?")

    read = columns.get_by_role("button", name="Read its boxes")
    expect(columns.get_by_label("Image")).to_have_value("Picture file")
    expect(read).to_be_disabled()
    chosen = {"Left": "a0", "Top": "b0", "Right": "a1", "Bottom": "b1"}
    for field, column in {**chosen, "Class": "Kind of thing"}.items():
        columns.get_by_label(field).select_option(column)
    read.click()

    expect(dialog.locator(".upload__sum")).to_contain_text("1 box")
    expect(columns).to_have_count(0)
    expect(dialog.get_by_role("row", name=re.compile("^car"))).to_contain_text("1 kept")
    upload(dialog, user.page)
