"""The view that compares the filter with people's answers, and suggests thresholds."""

import re

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.support import plain_http
from tests.support.page import scenes
from tests.support.page.scenes import MakeScene, Scene
from tests.support.page.tuning import applied_config, car_at
from tests.support.page.windows import Visitor, route_loaded

pytestmark = pytest.mark.browser

# Per cent of each box that match. The filter keeps boxes from 10 % on and people from
# 5 % on, so they differ about 6 and 8.
SHARES = (1, 2, 3, 6, 8, 20, 40, 60, 80)
BOXES = [car_at(share, at) for at, share in enumerate(SHARES)]
PEOPLE_KEEP_FROM = 5


@pytest.fixture
def street(make_scene: MakeScene) -> Scene:
    return make_scene(boxes=BOXES)


@pytest.fixture
def answered(street: Scene) -> Scene:
    """The street and a second frame of the same boxes, each with an answer."""
    scenes.push(street.http, street.dataset, "run/000002", BOXES)
    listed = street.http.get("/boxes", params={"dataset": street.dataset}).json()
    for box in listed["items"]:
        answer(street.http, box, truth(box))
    return street


def truth(box: dict[str, float]) -> str:
    return "keep" if box["match_percent"] >= PEOPLE_KEEP_FROM else "reject"


def answer(http: httpx.Client, box: dict[str, float], verdict: str) -> None:
    body = {"verdict": verdict, "seen_revision": box["revision"]}
    stored = http.post(f"/boxes/{box['box_id']}/reviews", json=body)
    assert stored.status_code == 201, stored.text


def quality_page(user: Visitor, street: Scene) -> Page:
    page = user.open(f"#/datasets/{street.dataset}/quality")
    expect(page.locator(".matrix")).to_be_visible()
    return page


def test_scores_have_intervals_per_class_and_distance_and_curves_are_tables_too(
    user, answered
):
    page = quality_page(user, answered)
    quality = answered.http.get(f"/datasets/{answered.dataset}/quality").json()
    recall = quality["confusion"]["recall"]
    low, high = (round(100 * recall[key], 1) for key in ("low", "high"))

    expect(page.locator(".score").nth(1)).to_contain_text("66.7 %")
    expect(page.locator(".score").nth(1)).to_contain_text(f"{low:g}–{high:g} %")
    expect(page.get_by_role("row", name=re.compile("^car 18 100 %"))).to_be_visible()
    page.get_by_role("button", name="Distance").click()
    expect(page.get_by_role("row", name=re.compile("^0–50 m 18"))).to_be_visible()

    expect(page.locator(".curve__drawing canvas")).to_be_visible()
    table = page.get_by_role("table", name=re.compile("Scores of car"))
    expect(table.get_by_role("columnheader")).to_have_text(
        ["Threshold", "Precision", "Recall", "F1"]
    )
    assert table.get_by_role("row").count() > 3

    page.get_by_role("button", name="Keep 99 % of the visible objects").click()
    expect(page).to_have_url(re.compile(r"/quality\?target=recall$"))
    expect(page.get_by_text("the highest ones that keep")).to_be_visible()


def test_matrix_links_to_boxes_and_suggestion_to_thresholds(user, answered):
    page = quality_page(user, answered)
    fields = page.locator(".matrixcell__count")
    expect(fields).to_have_text(["8", "0", "4", "6"])

    page.get_by_role("link", name=re.compile("real boxes that were rejected")).click()

    expect(page).to_have_url(re.compile(r"/grid\?by_filter=rejected&review=keep$"))
    expect(page.locator(".grid-status")).to_contain_text(re.compile(r"\b4 boxes"))

    page.go_back()
    page.get_by_role("link", name="See the 4 boxes on which they differ").click()
    expect(page).to_have_url(re.compile(r"/grid\?conflict=true$"))
    expect(page.locator(".grid-status")).to_contain_text(re.compile(r"\b4 boxes"))

    quality_page(user, answered)
    quality = answered.http.get(f"/datasets/{answered.dataset}/quality").json()
    suggested = quality["suggested"][0]["suggested"]
    assert 3 < suggested <= 6

    page.get_by_role("link", name="Try it").click()

    handle = page.get_by_role("slider", name="Threshold of car", exact=True)
    expect(handle).to_have_attribute("aria-valuenow", f"{suggested:g}")
    expect(
        page.locator('[data-figure="rejected_to_kept"] .figure__value')
    ).to_have_text("4")

    quality_page(user, answered)
    route_loaded(
        page, "**/quality?*target=recall*", lambda route: route.fulfill(status=500)
    )
    page.get_by_role("button", name="Keep 99 %").click()

    expect(page.locator("main")).to_contain_text("Try again")
    expect(page.get_by_role("button", name="Save")).to_have_count(0)

    page.unroute("**/quality?*target=recall*")
    page.get_by_role("button", name="Try again").click()
    expect(page.locator(".matrix")).to_be_visible()


def test_answers_on_chosen_boxes_tell_no_quality_and_random_ones_do(user, street):
    page = user.open(f"#/datasets/{street.dataset}/quality")
    page.get_by_role("link", name="Answer boxes").click()
    expect(page).to_have_url(re.compile(f"/{street.dataset}/queue$"))
    listed = street.http.get("/boxes", params={"dataset": street.dataset}).json()
    for box in listed["items"][:4]:
        answer(street.http, box, truth(box))
    page = quality_page(user, street)
    note = page.locator(".fewanswers")

    expect(note).to_contain_text("These 4 answers were on boxes that were not chosen")
    expect(note).to_contain_text("Answer 5 random boxes")
    expect(page.locator(".score__value")).to_have_text(["–"] * 3)
    expect(page.locator(".matrixcell__count")).to_have_text(["0", "0", "1", "3"])

    page.get_by_role("link", name="Answer random boxes").click()

    expect(page).to_have_url(re.compile(r"/queue\?order=random\b"))
    for number in range(5):
        expect(page.locator(".queue__progress")).to_contain_text(f"{number} answered")
        expect(page.locator(".stage")).to_have_attribute("data-picture", "shown")
        user.press("a")
    user.wait_until_saved()
    page = quality_page(user, street)
    for score in page.locator(".score__value").all():
        expect(score).to_have_text(re.compile(r"\d %"))
    expect(note).to_have_count(0)


def test_suggestion_is_saved_as_a_version_after_another_one_was_applied(user, answered):
    page = quality_page(user, answered)
    button = page.get_by_role("button", name="Save as a version", exact=True)
    expect(button).to_be_visible()
    answered.decide(classes={"walker": {"threshold_small_box": 77}})
    path = f"/datasets/{answered.dataset}/configs"
    before = answered.http.get(path).json()["items"]

    # The page says that it was refused before it has loaded the other version.
    with page.expect_response("**/quality?*"):
        button.click()

    expect(page.get_by_role("alert")).to_contain_text("somebody has applied another")
    assert answered.http.get(path).json()["items"] == before
    expect(page.get_by_role("main")).to_have_attribute("aria-busy", "false")
    button.click()
    expect(page.get_by_text("Saved as version")).to_be_visible()
    newest = answered.http.get(path).json()["items"][0]["config"]["classes"]
    quality = answered.http.get(f"/datasets/{answered.dataset}/quality").json()
    suggested = quality["suggested"][0]["suggested"]
    walker = {"walker": {"threshold_small_box": 77}}
    assert newest == {"car": {"threshold_small_box": suggested}, **walker}
    assert applied_config(answered)["classes"] == walker


def test_agreement_of_two_reviewers_is_shown(user, answered):
    name = f"bo-{answered.dataset}"
    made = answered.http.post("/tokens", json={"name": name, "role": "reviewer"})
    bearer = {"Authorization": f"Bearer {made.json()['token']}"}
    listed = answered.http.get("/boxes", params={"dataset": answered.dataset}).json()
    with plain_http.Client(base_url=answered.http.base_url, headers=bearer) as bo:
        for at, box in enumerate(listed["items"]):
            answer(bo, box, "keep" if at == 0 else truth(box))

    page = quality_page(user, answered)

    expect(page.locator(".together")).to_contain_text("of 18 boxes answered twice")
    pair = page.get_by_role("row", name=re.compile(f"^admin and {name} 18 17"))
    expect(pair).to_be_visible()
