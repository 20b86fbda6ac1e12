"""The layout holds with long names, narrow windows and empty datasets."""

import httpx
import pytest
from playwright.sync_api import Route, expect

from tests.support.page import many_boxes
from tests.support.page.accessibility import findings
from tests.support.page.scenes import MakeScene, Scene
from tests.support.page.windows import OVERFLOW, PHONE, WIDE, OpenWindow, Visitor

pytestmark = pytest.mark.browser

LONG_KEY = f"{'a-run-whose-name-says-everything-' * 4}/front-camera/000001"
OVERFLOW_DOWN = "document.documentElement.scrollHeight - innerHeight"
TOP = "(element) => element.getBoundingClientRect().top"
BROKEN_WORDS = """(elements) => elements.flatMap((element) => {
  const broken = [];
  const nodes = document.createTreeWalker(element, NodeFilter.SHOW_TEXT);
  while (nodes.nextNode()) {
    const range = document.createRange();
    range.selectNodeContents(nodes.currentNode);
    if (range.getClientRects().length > 1) broken.push(nodes.currentNode.data);
  }
  return broken;
})"""
BELOW_SIGN = """(shares) => shares.filter((share) => {
  const sign = share.parentElement.querySelector(".icon").getBoundingClientRect();
  const range = document.createRange();
  range.selectNodeContents(share);
  const text = range.getBoundingClientRect();
  return text.right > sign.left && text.top < sign.bottom;
}).map((share) => share.textContent)"""
GAPS = """(buttons) => buttons.slice(1).map((button, i) => {
  const [one, other] = [buttons[i], button].map((each) => each.getBoundingClientRect());
  return Math.max(other.left - one.right, other.top - one.bottom);
})"""


@pytest.fixture
def empty(http: httpx.Client) -> str:
    """A dataset without frames."""
    name = "nothing-in-it"
    assert http.post("/datasets", json={"name": name}).status_code in (201, 409)
    return name


def test_long_frame_key_does_not_stretch_thumbnails(scene: Scene, user: Visitor):
    scene.push(LONG_KEY)
    page = user.open(f"#/datasets/{scene.dataset}/frames")
    expect(page.locator("a.thumb img")).to_have_count(2)

    for size in (WIDE, PHONE):
        page.set_viewport_size(size)
        widths = page.locator(".thumb__picture").evaluate_all(
            "(all) => all.map((one) => one.getBoundingClientRect().width)"
        )
        assert widths[0] == pytest.approx(widths[1], abs=1)
        assert page.evaluate(OVERFLOW) <= 0


def test_notices_are_below_the_header_and_their_buttons_do_not_touch(user, empty):
    page = user.open(f"#/datasets/{empty}/queue")
    notice = page.locator(".notice")

    for size in (WIDE, PHONE):
        page.set_viewport_size(size)
        expect(notice).to_contain_text("No boxes yet")
        expect(notice).to_contain_text("No frames have been uploaded to this dataset.")
        expect(page.locator(".strip-list")).to_be_hidden()
        assert notice.evaluate(TOP) < 240

    page.set_viewport_size(WIDE)
    for view in ("grid", "thresholds"):
        user.open(f"#/datasets/{empty}/{view}")
        shown = page.locator(f"[data-view={view}]")
        expect(shown.get_by_role("heading", name="No boxes yet")).to_be_visible()
    user.open(f"#/datasets/{empty}/quality")
    buttons = page.locator(".notice__actions .button")
    expect(buttons).to_have_count(2)
    assert min(buttons.evaluate_all(GAPS)) >= 8


def test_configuration_keys_wrap_only_at_underscores(scene, open_window):
    page = open_window(viewport=PHONE).open(f"#/datasets/{scene.dataset}/thresholds")
    keys = page.locator("th code")
    expect(keys.filter(has_text="threshold_small_box")).to_be_visible()

    assert keys.evaluate_all(BROKEN_WORDS) == []
    for table in page.locator(".tablewrap").all():
        assert table.evaluate("(one) => one.scrollWidth - one.clientWidth") <= 0
    assert page.evaluate(OVERFLOW) <= 0


def test_dataset_without_answers_shows_zero_progress(make_scene, user, empty):
    outside = [{"id": "a", "class": "car", "xyxy": [-20, -20, -5, -5]}]
    scene = make_scene(boxes=outside)
    page = user.open(f"#/datasets/{scene.dataset}/frames")

    expect(page.locator("a.thumb")).to_contain_text("nothing to review")

    page = user.open("#/datasets")
    progress = page.locator(".card", has_text=empty).get_by_role("progressbar")
    expect(progress).to_have_attribute("aria-valuenow", "0")


def test_numbers_and_units_do_not_wrap_in_a_narrow_window(
    make_scene: MakeScene, open_window: OpenWindow
):
    scene = make_scene(boxes=many_boxes.alternating_boxes(4))
    many_boxes.review(scene, scene.box_id("b0"), "keep")
    user = open_window(viewport=PHONE)
    user.page.route("**/quality?*", respond_with_many_answers)
    page = user.open(f"#/datasets/{scene.dataset}/quality")
    shares = page.locator(".matrixcell__share")
    expect(shares).to_have_count(4)

    assert shares.evaluate_all(BROKEN_WORDS) == []
    assert shares.evaluate_all(BELOW_SIGN) == []
    # The table of people is wider than the window: keys must be able to scroll it.
    assert findings(page) == []


def respond_with_many_answers(route: Route) -> None:
    """Give the server's own answer, with counts of two and three digits in it."""
    quality = route.fetch().json()
    counts = {"kept_keep": 409, "rejected_reject": 383, "kept_reject": 111}
    quality["confusion"] |= {**counts, "rejected_keep": 29}
    quality["reviewers"][0] |= {"name": "a" * 60, "answers": 123_456}
    route.fulfill(json=quality)


def test_reviewer_is_named_and_the_tab_is_marked_whose_link_keeps_the_filters(
    scene, user
):
    page = user.open(f"#/datasets/{scene.dataset}/frames?class=car&key=run")
    tabs = page.get_by_role("navigation", name="Dataset")

    current = tabs.locator("[aria-current=page]")

    expect(current).to_have_text("Frames")
    expect(current).to_have_attribute(
        "href", f"#/datasets/{scene.dataset}/frames?class=car"
    )
    expect(page.locator(".who")).to_have_text("Aadmin")
    expect(page.locator(".who")).to_have_attribute("title", "Signed in as admin, admin")


def test_current_tab_is_visible_on_a_phone(scene, open_window):
    page = open_window(viewport=PHONE).open(f"#/datasets/{scene.dataset}/frames")

    tabs = page.get_by_role("navigation", name="Dataset")

    expect(tabs.locator("[aria-current=page]")).to_be_in_viewport(ratio=1)
