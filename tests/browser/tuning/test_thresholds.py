"""The view that tries thresholds: previews, flips, saving and applying a version."""

import json
import re

import pytest
from playwright.sync_api import Locator, Page, Route, expect

from filter_core.config.filter import FilterConfig
from filter_core.config.keys import keys_of
from filter_core.formats.recording import DATASET_SETTINGS
from tests.support.page import scenes
from tests.support.page.scenes import MakeScene, Scene
from tests.support.page.stage import bounds
from tests.support.page.tuning import applied_config, car_at, count_bar_colours, dragged
from tests.support.page.windows import PHONE, OpenWindow, Visitor, route_loaded
from tests.support.sensors import ANNOTATION, sensors
from tests.support.waiting import until

pytestmark = pytest.mark.browser

# Cars that fill 4, 30, 55 and 80 % of their boxes; the walker fills its box.
BOXES = [car_at(share, index) for index, share in enumerate((4, 30, 55, 80))]
WALKER = {"id": "walker", "class": "walker", "xyxy": (560, 200, 590, 280)}


@pytest.fixture
def street(make_scene: MakeScene) -> Scene:
    return make_scene(boxes=[*BOXES, WALKER])


def open_thresholds(user: Visitor, street: Scene, query: str = "") -> Page:
    page = user.open(f"#/datasets/{street.dataset}/thresholds{query}")
    expect(figure(page, "kept")).not_to_have_text("–")
    expect(page.locator(".histogram__drawing canvas").first).to_be_visible()
    return page


def handle(page: Page, name: str) -> Locator:
    return page.get_by_role("slider", name=f"Threshold of {name}", exact=True)


def figure(page: Page, which: str) -> Locator:
    return page.locator(f'[data-figure="{which}"] .figure__value')


def test_flip_shows_both_sides_and_dragging_updates_counts(user, street):
    page = open_thresholds(user, street, "?threshold_small_box=30.04")
    flip = page.locator(".flip--rejected")

    sides = flip.locator(".flip__side")
    expect(sides.nth(0)).to_have_text("kept now: match 30 % ≥ 10 %")
    expect(sides.nth(1)).to_have_text("would be rejected: match 30 % < 30.04 %")

    expect(flip.locator("img")).to_be_visible()
    picture = bounds(flip.locator(".flip__picture"))
    outline = bounds(flip.locator(".cell__box--rejected"))
    x0, y0, x1, y1 = car_at(30, 1)["xyxy"]
    assert outline["width"] / outline["height"] == pytest.approx(
        (x1 - x0) / (y1 - y0), rel=0.05
    )
    assert middle_of(outline) == pytest.approx(middle_of(picture), abs=1)

    flip.click()

    box = next(box for box in street.frame["boxes"] if box["id"] == "car-30")
    expect(page).to_have_url(re.compile(rf"#/frames/\d+\?box={box['box_id']}$"))

    open_thresholds(user, street)
    expect(figure(page, "kept")).to_have_text("4")

    dragged(page, handle(page, "all classes"), to=60)

    expect(handle(page, "all classes")).to_have_attribute("aria-valuenow", "60")
    expect(figure(page, "kept")).to_have_text("2")
    expect(figure(page, "kept_to_rejected")).to_have_text("2")
    expect(page.locator(".flip--rejected")).to_have_count(2)
    expect(page.locator(".flip img").first).to_have_attribute(
        "src", re.compile("blob:")
    )
    expect(page.locator(".flip img").first).to_have_js_property("complete", True)
    width = page.locator(".flip img").first.evaluate("(img) => img.naturalWidth")
    assert width > 0


def middle_of(rectangle):
    return (
        rectangle["x"] + rectangle["width"] / 2,
        rectangle["y"] + rectangle["height"] / 2,
    )


def test_threshold_is_set_by_arrow_keys_or_by_typing_a_valid_number(user, street):
    page = open_thresholds(user, street)
    handle(page, "car").focus()

    user.press("ArrowRight", "Shift+ArrowRight", "PageUp", "ArrowLeft")

    expect(handle(page, "car")).to_have_attribute("aria-valuenow", "25")
    expect(handle(page, "car")).to_have_attribute("aria-valuetext", "25 %")
    expect(handle(page, "all classes")).to_have_attribute("aria-valuenow", "10")
    user.press("End")
    expect(figure(page, "kept")).to_have_text("1")
    user.press("Home")
    expect(figure(page, "kept")).to_have_text("5")
    expect(figure(page, "rejected_to_kept")).to_have_text("1")
    page.get_by_role("button", name="Follow all").click()
    expect(handle(page, "car")).to_have_attribute("aria-valuenow", "10")

    field = page.locator("input[aria-label='Threshold of all classes']")
    field.fill("31.25")
    expect(handle(page, "all classes")).to_have_attribute("aria-valuenow", "31.25")
    field.fill("131")

    expect(field).to_have_attribute("aria-invalid", "true")
    expect(field).to_have_accessible_description("Expected 0 to 100, found 131.")
    expect(page.get_by_role("alert")).to_be_visible()
    expect(handle(page, "all classes")).to_have_attribute("aria-valuenow", "31.25")
    field.fill("")
    expect(field).to_have_accessible_description("Expected 0 to 100, found nothing.")
    field.press_sequentially("-")
    expect(field).to_have_accessible_description("Expected 0 to 100, found no number.")
    field.fill("40")
    expect(field).to_have_accessible_description("")
    expect(page.get_by_role("alert")).to_have_count(0)


def test_tried_thresholds_are_kept_in_the_link_and_the_last_drag_is_undone(
    user, street
):
    page = open_thresholds(user, street)
    handle(page, "all classes").focus()
    user.press("PageUp")
    expect(page).to_have_url(re.compile(r"\?threshold_small_box=20$"))

    link = page.url.partition("#")[2]
    user.open("#/datasets")
    expect(page.get_by_role("heading", name="Datasets")).to_be_visible()
    page = user.open(f"#{link}")

    expect(handle(page, "all classes")).to_have_attribute("aria-valuenow", "20")
    page.evaluate("link => { location.hash = link }", link.replace("=20", "=35"))
    expect(handle(page, "all classes")).to_have_attribute("aria-valuenow", "35")
    page.get_by_role("button", name="Reset").click()
    expect(handle(page, "all classes")).to_have_attribute("aria-valuenow", "10")
    expect(page).to_have_url(re.compile("/thresholds$"))

    field = page.get_by_label("Threshold of car, percent")
    field.fill("33")
    expect(handle(page, "car")).to_have_attribute("aria-valuenow", "33")
    dragged(page, handle(page, "all classes"), to=60)
    expect(handle(page, "all classes")).to_have_attribute("aria-valuenow", "60")

    user.press("Control+z")

    expect(handle(page, "all classes")).to_have_attribute("aria-valuenow", "10")
    expect(field).to_have_value("33")
    user.press("Control+z")
    expect(field).to_have_value("10")


def test_saving_a_version_lists_its_changes_and_applying_it_starts_a_run(user, street):
    page = open_thresholds(user, street, "?threshold_small_box=40&min_visible_pixels=3")
    page.get_by_role("button", name="Save as new config version").click()
    dialog = page.get_by_role("dialog")
    rows = dialog.locator("tbody").get_by_role("row")
    expect(rows).to_have_text(
        [
            re.compile("threshold_small_box.*10.*40"),
            re.compile("min_visible_pixels.*1.*3"),
        ]
    )
    # It is empty until the server has counted what is tried.
    version = dialog.locator("code[title]")
    expect(version).to_have_attribute("title", re.compile("."))
    digest = version.get_attribute("title")

    dialog.get_by_role("button", name="Save only").click()

    expect(dialog).to_have_count(0)
    expect(page.locator(".version")).to_have_count(2)
    versions = street.http.get(f"/datasets/{street.dataset}/configs").json()["items"]
    assert versions[0]["digest"] == digest
    assert versions[0]["config"]["threshold_small_box"] == 40
    assert applied_config(street)["threshold_small_box"] == 10

    open_thresholds(user, street, "?threshold_small_box=40")
    page.get_by_role("button", name="Save as new config version").click()

    page.get_by_role("button", name="Save and apply").click()

    expect(page.locator(".runstrip--done")).to_contain_text("is done")
    expect(page.get_by_text("The active configuration")).to_be_visible()
    expect(handle(page, "all classes")).to_have_attribute("aria-valuenow", "40")
    expect(page).to_have_url(re.compile("/thresholds$"))
    assert applied_config(street)["threshold_small_box"] == 40
    page.get_by_role("link", name="See what changed").click()
    expect(page.get_by_role("heading", name=re.compile("What run"))).to_be_visible()
    expect(page.locator(".flip--rejected")).to_have_count(1)


def test_class_is_measured_as_another_from_stored_images(user, make_scene):
    dragon = {**WALKER, "class": "dragon"}
    street = make_scene(boxes=[dragon, car_at(30, 0)])
    page = open_thresholds(user, street)
    form = page.get_by_role("group", name="What a class is measured as")
    form.get_by_label("Class").select_option("dragon")
    tags = form.get_by_label("or by these tags")
    expect(tags).to_have_attribute("name", "dragon")
    tags.fill("Car, 12")
    tags.press("Tab")
    row = page.get_by_role("row", name=re.compile(r"^classes\.dragon"))
    expect(row).to_contain_text("classes.dragon.acceptCar, 12")
    form.get_by_label("Measured as").select_option("walker")
    expect(row).to_contain_text("classes.dragon.measures_aswalker")
    page.get_by_role("textbox", name="tags", exact=True).fill("40: Pedestrian")
    page.get_by_role("textbox", name="tags", exact=True).press("Tab")
    page.get_by_role("button", name="Save as new config version").click()

    page.get_by_role("button", name="Save and apply").click()

    expect(page.locator(".runstrip--done")).to_contain_text("is done")
    config = applied_config(street)
    assert config["classes"] == {"dragon": {"measures_as": "walker"}}
    assert config["tags"] == {"40": "Pedestrian"}
    boxes = scenes.get(street.http, f"/frames/{street.frame['id']}")["boxes"]
    verdicts = {box["class"]: box["verdict"] for box in boxes}
    assert verdicts == {"dragon": "kept", "car": "kept"}


def test_older_version_can_be_previewed_and_activated_again(user, street):
    street.decide(threshold_small_box=60)
    page = open_thresholds(user, street)
    expect(page.locator(".version.is-active")).to_contain_text("in use")
    expect(handle(page, "all classes")).to_have_attribute("aria-valuenow", "60")

    page.get_by_role("button", name="Try").click()
    expect(handle(page, "all classes")).to_have_attribute("aria-valuenow", "10")
    expect(figure(page, "rejected_to_kept")).to_have_text("2")
    page.get_by_role("button", name="Apply").click()
    dialog = page.get_by_role("dialog", name=re.compile("^Apply version [0-9a-f]{8}"))
    expect(dialog).to_contain_text(street.dataset)
    expect(dialog.get_by_role("row", name="threshold_small_box 60 10")).to_be_visible()
    dialog.get_by_role("button", name="Cancel").click()
    expect(dialog).to_have_count(0)
    assert applied_config(street)["threshold_small_box"] == 60
    assert (
        len(scenes.get(street.http, f"/datasets/{street.dataset}/runs")["items"]) == 2
    )

    page.get_by_role("button", name="Apply").click()
    dialog.get_by_role("button", name="Apply", exact=True).click()

    expect(page.locator(".runstrip--done")).to_be_in_viewport(ratio=1)
    assert applied_config(street)["threshold_small_box"] == 10


@pytest.mark.parametrize(
    "width", [390, pytest.param(820, marks=pytest.mark.long), 1440]
)
def test_applied_version_is_reported_in_sight(street, open_window: OpenWindow, width):
    user = open_window(viewport={"width": width, "height": 844})
    page = open_thresholds(user, street)
    field = page.get_by_role("spinbutton", name="threshold_big_box")
    field.fill("60")
    expect(page.locator(".summary__state")).to_contain_text("1 change")
    page.keyboard.press("Tab")
    # Without the scrolling that a click on the button brings.
    save = page.get_by_role("button", name="Save as new config version")
    save.evaluate("button => button.click()")

    page.get_by_role("button", name="Save and apply").click()

    strip = page.locator(".runstrip--done")
    expect(page.locator(".summary__state")).to_have_text("The active configuration")
    expect(strip).to_be_in_viewport(ratio=1)
    shown, summary = bounds(strip), bounds(page.locator(".summary"))
    assert shown["y"] >= summary["y"] + summary["height"]


def test_preview_without_counts_shows_why_and_what_it_can(user, street):
    page = open_thresholds(user, street)

    page.evaluate("location.hash += '?profile=carlasimu'")

    expect(
        page.get_by_text("This change requires reading the images again.")
    ).to_be_visible()
    expect(figure(page, "kept")).to_have_count(0)
    expect(page.locator(".summary__pixels")).to_contain_text("again. Its effect")
    expect(page.get_by_role("heading", name="Configuration")).to_be_visible()
    for name in ("All classes", "Reasons", "Would flip"):
        expect(page.get_by_role("heading", name=name)).to_have_count(0)

    page.get_by_role("button", name="Reset").click()
    expect(page.get_by_role("heading", name="Reasons")).to_be_visible()
    expect(handle(page, "all classes")).to_be_visible()

    page.evaluate("location.hash += '?min_distance=50&max_distance=10'")

    expect(page.get_by_role("alert")).to_contain_text("min_distance")
    expect(handle(page, "all classes")).to_be_visible()


def test_deciding_channel_is_named_with_its_keys_which_can_be_previewed(user, street):
    page = open_thresholds(user, street)
    line = page.locator(".tuning__channel")
    # The line names keys, which come with the form.
    expect(page.get_by_role("spinbutton", name="ordered_min_pixels")).to_be_visible()
    expect(line).to_have_count(0)
    street.decide(evidence="ordered")

    page.reload()

    expect(line).to_have_text(
        "ordered decides, by min_visible_pixels (1), min_visible_percent (0) and "
        "ordered_min_pixels (3); thresholds of matching pixels decide the boxes that "
        "it could not measure."
    )
    kept = figure(page, "kept")
    expect(kept).to_have_text(re.compile(r"\d"))
    before = int(kept.inner_text())

    page.get_by_role("spinbutton", name="ordered_min_pixels").fill("100000")

    expect(page).to_have_url(re.compile("ordered_min_pixels=100000"))
    expect(kept).not_to_have_text(str(before))
    points = page.get_by_role("spinbutton", name="lidar_min_points")
    expect(points).to_have_value("5")


def test_form_lists_every_key_as_declared_and_previews_no_invalid_number(user, street):
    page = open_thresholds(user, street)
    keys = keys_of(FilterConfig)
    rows = page.locator(".table--keys tbody tr")

    expect(rows.locator("code")).to_have_text(list(keys))
    # Of the settings of reading, this dataset has one of its own.
    own = " The dataset's own setting is used: carla-0.9.14."
    expect(rows.locator(".table__text")).to_have_text(
        [
            key.sentence + own if name == "palette" else key.sentence
            for name, key in keys.items()
        ]
    )
    # The settings of reading are changed with the dataset's, which win over these.
    expected = [name for name in keys if name not in (*DATASET_SETTINGS, "tag_scale")]
    controls = rows.locator("input, select, textarea")
    labels = controls.evaluate_all("all => all.map((one) => one.ariaLabel)")
    assert labels == expected

    share = page.get_by_role("spinbutton", name="size_big_box")

    for wrong in ("101", "-1"):
        share.fill(wrong)
        expect(share).to_have_attribute("aria-invalid", "true")
    expect(share).to_have_accessible_description(
        "Expected a number from 0 to 100, found -1."
    )
    points = page.get_by_role("spinbutton", name="lidar_min_points")
    points.fill("2.5")
    expect(points).to_have_accessible_description(
        re.compile("^Expected a whole number .*, found 2.5.$")
    )
    most = page.get_by_role("spinbutton", name="max_distance")
    most.fill("")
    most.press_sequentially("-")
    expect(most).to_have_accessible_description(re.compile("found no number.$"))
    expect(page.locator(".summary__state")).to_have_text("The active configuration")

    share.fill("70.5")
    expect(page.locator(".summary__state")).to_contain_text("1 change, not saved")


def test_yaml_is_accepted_and_flips_are_filtered_by_class(user, street):
    page = open_thresholds(
        user, street, "?threshold_small_box=12.5&classes.car.accept=[14]"
    )
    page.get_by_text("As YAML").click()

    text = page.locator(".yaml pre").inner_text()

    sent = {"Content-Type": "application/yaml"}
    path = f"/datasets/{street.dataset}/configs"
    stored = street.http.post(path, content=text, headers=sent)
    assert stored.status_code == 201, stored.text
    config = stored.json()["config"]
    assert config["threshold_small_box"] == 12.5
    assert config["classes"] == {"car": {"accept": [14]}}

    open_thresholds(user, street, "?threshold_small_box=60")
    expect(page.get_by_role("row", name=re.compile("^visible 4 2"))).to_be_visible()

    page.get_by_role("button", name="walker", exact=True).click()

    expect(page.get_by_role("heading", name="Reasons: walker")).to_be_visible()
    expect(page.get_by_role("row", name=re.compile("^visible 1 1"))).to_be_visible()
    expect(page.get_by_text("No verdict changes.")).to_be_visible()
    expect(page).to_have_url(re.compile("class=walker"))

    open_thresholds(user, street)
    legend = page.locator(".chartlegend")
    expect(legend).to_contain_text("at or above it")

    street.decide(profile="carlasimu")
    page.reload()

    expect(legend).to_contain_text("at or below the threshold")


def test_bars_are_hatched_below_the_threshold_and_redrawn_in_other_colours(
    user, street
):
    page = open_thresholds(user, street, "?threshold_small_box=50")
    drawing = page.locator(".histogram--large .histogram__drawing canvas")

    below, above = (
        count_bar_colours(drawing, percent=30.25),
        count_bar_colours(drawing, percent=80.25),
    )

    assert below > 1, "a rejected bar is slanted lines over a tint"
    assert above == 1, "a kept bar is one solid colour"
    drawings = page.locator(".histogram--large .histogram__drawing")
    expect(drawings).to_have_attribute("data-drawn", "1")
    page.get_by_role("button", name="Settings").click()
    page.get_by_role("button", name="Dark").click()
    expect(drawings).to_have_attribute("data-drawn", "2")


def test_a_threshold_is_moved_by_touch(street, open_window):
    bo = open_window(viewport=PHONE, has_touch=True, is_mobile=True)
    page = open_thresholds(bo, street)
    line = handle(page, "all classes")
    line.scroll_into_view_if_needed()

    place = bounds(line)
    assert place["width"] >= 44
    dragged(page, line, to=60)

    expect(figure(page, "kept")).to_have_text("2")
    assert json.loads(line.get_attribute("aria-valuenow") or "") == pytest.approx(
        60, abs=1
    )


def test_save_is_refused_once_if_another_version_was_applied(street, user):
    # A run that is open when the page looks for one would be followed to its end.
    with user.page.expect_response(re.compile(r"/runs\?")):
        page = open_thresholds(user, street)
    street.decide(classes={"walker": {"threshold_small_box": 77}})
    page.locator("input[aria-label='Threshold of car, percent']").fill("50")
    page.get_by_role("button", name="Save as new config version").click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("Applying it flips 1 box:")

    dialog.get_by_role("button", name="Save and apply").click()

    expect(dialog.get_by_role("alert")).to_contain_text("somebody has applied another")
    assert "car" not in applied_config(street)["classes"]
    other = scenes.get(street.http, f"/datasets/{street.dataset}/config")["digest"]
    expect(dialog).to_contain_text(f"differs from the active {other[:8]}")
    dialog.get_by_role("button", name="Save and apply").click()
    expect(page.locator(".runstrip")).to_contain_text("is done")
    classes = applied_config(street)["classes"]
    assert [classes[name]["threshold_small_box"] for name in ("car", "walker")] == [
        *(50, 77)
    ]


def test_failed_counts_of_the_active_version_can_be_retried(street, user):
    failed: list[Route] = []

    def fail_active_once(route):
        threshold = route.request.post_data_json["config"]["threshold_small_box"]
        if threshold == 10 and not failed:
            failed.append(route)
            route.fulfill(status=503, body="{}")
        else:
            route.continue_()

    user.page.route("**/preview", fail_active_once)
    page = open_thresholds(user, street, "?threshold_small_box=60")
    change = page.locator('[data-figure="kept"] .delta')
    expect(change).to_have_text("±0")

    page.get_by_role("alert").get_by_role("button", name="Try again").click()

    expect(change).to_have_text("−2")
    expect(page.get_by_role("alert")).to_have_count(0)


def test_save_dialog_shows_no_flips_if_its_preview_failed(street, user):
    page = open_thresholds(user, street)
    field = page.locator("input[aria-label='Threshold of all classes']")
    field.fill("60")
    expect(
        page.locator('[data-figure="kept_to_rejected"] .figure__value')
    ).to_have_text("2")
    route_loaded(page, "**/preview", lambda route: route.fulfill(status=503, body="{}"))
    field.fill("90")
    expect(page.get_by_role("alert")).to_be_visible()

    page.get_by_role("button", name="Save as new config version").click()

    expect(page.get_by_role("dialog")).to_contain_text("Save and apply")
    expect(page.get_by_role("dialog")).not_to_contain_text("flips")


def test_other_evidence_is_tried_applied_and_undone_with_one_click_each(user, http):
    """A car, and a ghost behind it that has the same tag."""
    dataset = "other-evidence"
    by_tags = {"name": dataset, "config": {"evidence": "auto"}}
    assert http.post("/datasets", json=by_tags).status_code == 201
    scenes.put(http, dataset, "a", ANNOTATION, **sensors())
    run = {"config": {"profile": "paper"}, "activate": True}
    assert http.post(f"/datasets/{dataset}/runs", json=run).status_code == 202
    until(lambda: kept_boxes(http, dataset) == 2)

    page = user.open(f"#/datasets/{dataset}/frames")
    switch = page.get_by_role("region", name="What boxes are decided by")
    expect(switch).to_contain_text("1 ghost goes, 0 objects come back")
    switch.get_by_label("Evidence").select_option("depth")
    expect(switch).to_contain_text("Depth would reject 1 kept box")
    switch.get_by_label("Evidence").select_option("auto")
    switch.get_by_role("link", name="Show them").click()

    expect(figure(page, "kept_to_rejected")).to_have_text("1")
    expect(page.locator(".flip--rejected img").first).to_be_visible()
    switch.get_by_role("button", name="Decide so").click()

    expect(page.get_by_role("button", name="Undo")).to_be_visible(timeout=15_000)
    assert kept_boxes(http, dataset) == 1
    expect(switch).to_contain_text("Boxes are decided by")
    dragged(page, handle(page, "all classes"), to=95)  # now of a box's own pixels
    expect(figure(page, "kept")).to_have_text("0")
    expect(page).to_have_url(re.compile("min_visible_percent=95"))

    page.get_by_role("button", name="Undo").click()
    until(lambda: kept_boxes(http, dataset) == 2)


def kept_boxes(http, dataset):
    return http.get(f"/datasets/{dataset}/stats").json()["kept"]


def test_answers_that_overturn_the_filter_offer_a_threshold_and_score_it(
    user, make_scene
):
    shares = (1, 5, 6, 7, 80)
    boxes = [car_at(share, at) for at, share in enumerate(shares)]
    street = make_scene(boxes=boxes)
    for share, box in zip(shares, boxes, strict=True):
        body = {"verdict": "reject" if share == 1 else "keep", "seen_revision": 0}
        path = f"/boxes/{street.box_id(box['id'])}/reviews"
        assert street.http.post(path, json=body).status_code == 201

    page = open_thresholds(user, street)

    hint = page.get_by_role("list", name="What the truth contradicts")
    expect(hint).to_contain_text("3 answers of car overturned the filter.")
    expect(figure(page, "recall")).to_have_text("25 %")
    expect(page.get_by_text("of 5 answered boxes")).to_be_visible()
    hint.get_by_role("button", name=re.compile("^Try [1-5]")).click()

    expect(figure(page, "recall")).to_have_text("100 %")
    expect(figure(page, "precision")).to_have_text("100 %")
    expect(hint).to_have_count(0)
    expect(page.locator(".flip .truth--right")).to_have_count(3)
