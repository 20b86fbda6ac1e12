"""Every view, in each of its states, is checked for cut-off content and by axe."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest
from playwright.sync_api import Page, expect

from tests.support.folders import write_files
from tests.support.page import many_boxes, scenes
from tests.support.page.accessibility import findings
from tests.support.page.scenes import MakeScene
from tests.support.page.tuning import car_at
from tests.support.page.windows import OVERFLOW, Visitor, go_offline, lose_session
from tests.support.sensors import ANNOTATION, sensors

pytestmark = pytest.mark.browser

EVIDENCE_ROWS = 7


@dataclass(frozen=True)
class Tools:
    """What a function of `VIEWS` needs: a window, a maker of data, an empty folder."""

    user: Visitor
    make_scene: MakeScene
    folder: Path

    @property
    def page(self) -> Page:
        """The page in the window."""
        return self.user.page


View = Callable[[Tools], Iterator[str]]
"""Brings a view into one state after another, and yields the name of each."""


def lists_and_menus(tools: Tools) -> Iterator[str]:
    scene, user, page = tools.make_scene(), tools.user, tools.page
    user.open("#/datasets")
    expect(page.get_by_role("heading", name=scene.dataset)).to_be_visible()
    yield "datasets"

    user.open(f"#/datasets/{scene.dataset}")
    expect(page.locator(".compare__box--kept")).to_have_count(2)
    expect(page.get_by_role("table")).to_have_count(5)
    yield "home of a dataset"

    user.open(f"#/datasets/{scene.dataset}/frames?verdict=rejected")
    expect(page.locator("a.thumb")).to_have_count(1)
    yield "frames"

    page.get_by_role("button", name="Dataset settings").click()
    expect(page.locator(".settings__grid")).to_be_visible()
    page.get_by_text("Delete this dataset").click()
    yield "settings of a dataset"

    user.open(scene.link())
    page.get_by_role("button", name="Settings").click()
    yield "settings of the page"

    user.press("Escape", "?")
    expect(page.get_by_role("dialog", name="Keys")).to_be_visible()
    yield "help"

    user.press("Escape")
    lose_session(page)
    page.reload()
    expect(page.get_by_label("Token or login link")).to_be_visible()
    yield "sign-in"


def upload(tools: Tools) -> Iterator[str]:
    root = tools.folder / f"town-{tools.folder.name.strip('_').lower()}"
    files = dict.fromkeys(("images/1.png", "images/stray.png"), scenes.picture())
    files |= {"seg/1.png": scenes.segmentation("palette")}
    boxes = "0 0.25 0.694444 0.25 0.277778\n1 0.5 0.2 0.05 0.25\n"
    labels = {"data.yaml": "names: [car, wlker]\n", "labels/1.txt": boxes}
    write_files(root, files | labels)
    page = tools.user.open("#/datasets")
    page.get_by_label("Upload a folder").last.set_input_files(root)
    page.get_by_text("Did not match 1").click()
    page.locator(".pbox").first.focus()
    yield "what will be sent"

    page.get_by_role("button", name="Is it walker?").click()
    expect(page.get_by_text("Classes: wlker measured as walker")).to_be_visible()
    expect(page.locator("[aria-busy=true]")).to_have_count(0)
    yield "what was corrected"

    page.get_by_role("button", name=re.compile(r"^Upload \d+ frame")).click()
    page.get_by_role("button", name="Close the upload").wait_for()
    yield "what was sent"


def frame(tools: Tools) -> Iterator[str]:
    scene, user, page = tools.make_scene(), tools.user, tools.page
    user.open(scene.link("ghost"))
    user.press("a", "j", "x", "j", "Space", "ArrowLeft", "m")
    user.wait_until_saved()
    yield "answers"

    user.press("b")
    yield "blind"

    scene = tools.make_scene()
    user.open(scene.link("ghost"))
    many_boxes.review(scene, scene.box_id("ghost"), "reject")
    user.press("a")
    expect(page.locator(".overtaken")).to_be_visible()
    yield "overtaken"

    go_offline(page)
    user.press("j", "a")
    expect(page.locator(".savestate")).to_contain_text("offline")
    yield "offline"


def grid(tools: Tools) -> Iterator[str]:
    scene, user, page = tools.make_scene(), tools.user, tools.page
    user.open(many_boxes.grid(scene))
    expect(many_boxes.cell(page, 0).locator("img")).to_be_visible()
    user.press("ArrowRight", "Space")
    expect(page.locator(".bar--grid")).to_be_visible()
    yield "selected"

    go_offline(page)
    user.press("x")
    expect(page.locator(".strip")).to_be_visible()
    yield "offline"

    page.context.set_offline(False)
    user.open(many_boxes.grid(scene, distance_min="900"))
    expect(page.get_by_role("heading", name="No box matches")).to_be_visible()
    yield "no box"

    user.open(many_boxes.grid(scene, **{"class": "car", "toss_up": "true"}))
    unfold_filters(page)
    page.get_by_role("button", name="More").click()
    expect(page.get_by_role("group", name="More filters")).to_be_visible()
    yield "filters"


def queue(tools: Tools) -> Iterator[str]:
    scene, user, page = tools.make_scene(), tools.user, tools.page
    user.open(many_boxes.queue(scene))
    expect(page.locator(".stage[data-picture=shown]")).to_be_visible()
    many_boxes.review(scene, scene.box_id(many_boxes.queued_box_id(page)), "reject")
    user.press("a", "x")
    expect(page.locator(".overtaken")).to_be_visible()
    yield "overtaken"

    user.press("b")
    yield "blind"

    user.press("a", "x", "a")
    expect(page.get_by_role("heading", name="All done")).to_be_visible()
    yield "all done"

    user.open(many_boxes.queue(tools.make_scene(), verdict="rejected"))
    unfold_filters(page)
    expect(page.get_by_role("combobox", name="Reason")).to_be_visible()
    yield "filters"


def thresholds(tools: Tools) -> Iterator[str]:
    boxes = [car_at(share, index) for index, share in enumerate((4, 30, 55, 80))]
    link = f"#/datasets/{tools.make_scene(boxes=boxes).dataset}/thresholds"
    page = tools.user.open(f"{link}?threshold_small_box=60")
    expect(page.locator(".histogram__drawing canvas").first).to_be_visible()
    expect(page.locator(".flip")).to_have_count(2)
    yield "flips"

    page.get_by_role("button", name="Save as new config version").click()
    expect(page.get_by_role("dialog")).to_be_visible()
    yield "saving"

    tools.user.press("Escape")
    tools.user.open(f"{link}?profile=carlasimu")
    expect(page.get_by_text("requires reading the images again")).to_be_visible()
    yield "pixels needed"


def channels(tools: Tools) -> Iterator[str]:
    scene = tools.make_scene(boxes=[])
    scenes.put(scene.http, scene.dataset, "a", ANNOTATION, **sensors())
    page = tools.user.open(f"#/datasets/{scene.dataset}/quality")
    panel = page.get_by_role("region", name="Kinds of evidence compared")
    measure = panel.get_by_role("button", name="Measure every kind")
    expect(measure).to_be_visible()
    yield "not measured"

    measure.click()
    expect(panel.locator("tbody tr")).to_have_count(EVIDENCE_ROWS, timeout=20_000)
    yield "measured"

    page.get_by_role("button", name="Compare with instances").click()
    expect(page.locator(".matrixcell__count")).to_have_text(["1", "1", "0", "0"])
    yield "instances"


def quality(tools: Tools) -> Iterator[str]:
    shares = (1, 2, 3, 6, 8, 20, 40, 60, 80)
    scene = tools.make_scene(boxes=[car_at(share, i) for i, share in enumerate(shares)])
    listed = scenes.get(scene.http, f"/boxes?dataset={scene.dataset}")["items"]
    for box in listed:
        verdict = "keep" if box["match_percent"] >= 5 else "reject"
        many_boxes.review(scene, box["box_id"], verdict)
    page = tools.user.open(f"#/datasets/{scene.dataset}/quality")
    expect(page.locator(".matrix")).to_be_visible()
    expect(page.locator(".curve__drawing canvas")).to_be_visible()
    yield "people"


def runs(tools: Tools) -> Iterator[str]:
    scene = tools.make_scene(boxes=[car_at(30, 0), car_at(55, 1)])
    scene.decide(threshold_small_box=40)
    number = scenes.get(scene.http, f"/datasets/{scene.dataset}/runs")["items"][0]["id"]
    scene.http.post(f"/datasets/{scene.dataset}/exports", json={"format": "yolo"})
    page = tools.user.open(f"#/datasets/{scene.dataset}/runs?run={number}")
    expect(page.locator(".flip")).to_have_count(1)
    expect(page.get_by_role("button", name=re.compile("^Download"))).to_be_visible()
    yield "what a run changed"

    page.get_by_role("button", name="New export").click()
    expect(page.locator(".formatcard").first).to_be_visible()
    yield "asking for an export"


def unfold_filters(page: Page) -> None:
    """Show the filters; narrow windows hide them behind a button."""
    filters = page.get_by_role("button", name="Filters", exact=True)
    if filters.is_visible():
        filters.click()


VIEWS: list[View] = [
    *(lists_and_menus, upload, frame, grid, queue),
    *(thresholds, channels, quality, runs),
]


# A narrow and a wide window, light and dark; only the long tests look at all.
LOOKS = [(390, "light"), (1440, "dark")]
OTHER_LOOKS = [(1440, "light"), (820, "dark"), (820, "light"), (390, "dark")]
NEXT_FRAMES = """() => new Promise((done) =>
  requestAnimationFrame(() => requestAnimationFrame(done)))"""


@pytest.mark.parametrize(
    "looks",
    [LOOKS, pytest.param(OTHER_LOOKS, marks=pytest.mark.long)],
    ids=["two looks", "other looks"],
)
@pytest.mark.parametrize("view", VIEWS, ids=lambda view: view.__name__)
def test_every_view_has_no_overflow_and_no_axe_findings(
    user: Visitor, make_scene: MakeScene, tmp_path: Path, view: View, looks
):
    """Each state is brought about in the first look, and looked at in all of them."""
    page = user.page
    take_look(page, *looks[0])
    for state in view(Tools(user, make_scene, tmp_path)):
        for look in (*looks[1:], looks[0]):
            take_look(page, *look)
            assert page.evaluate(OVERFLOW) <= 0, (state, look)
            assert findings(page) == [], (state, look)


def take_look(page: Page, width: int, scheme: Literal["dark", "light"]) -> None:
    """Change the window's width and colours, and wait until the page follows."""
    page.set_viewport_size({"width": width, "height": 844})
    page.emulate_media(color_scheme=scheme)
    page.evaluate(NEXT_FRAMES)
