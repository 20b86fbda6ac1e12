"""Which modules and requests a view needs."""

import pytest
from playwright.sync_api import expect

from tests.support.page.windows import route_loaded

pytestmark = pytest.mark.browser

LOADED = "() => performance.getEntriesByType('resource').map(({ name }) => name)"


MOST_REQUESTS = 14
"""Most requests of the first view, including the page, its data and one picture."""


@pytest.mark.parametrize("view", ["#/datasets", "#/datasets/{}/frames"])
def test_first_view_loads_few_files(make_scene, user, view):
    scene = make_scene(config={"evidence": "auto"})
    page = user.open(view.format(scene.dataset))
    expect(page.locator("img[src^='blob:']").first).to_be_visible()

    loaded = page.evaluate(LOADED)

    assert [name for name in loaded if name.endswith("/later.js")] == []
    # Pictures are left out: their number depends on the datasets of other tests.
    others = [name for name in loaded if "/thumbnail" not in name]
    assert len(others) + len(["page", "picture"]) <= MOST_REQUESTS, loaded


def test_view_that_fails_to_load_can_be_retried_and_is_built_once(scene, user):
    page = user.open("#/datasets")
    expect(page.get_by_role("link", name=scene.dataset).first).to_be_visible()
    route_loaded(page, "**/later.js", lambda route: route.abort())
    page.evaluate(f"location.hash = '#/datasets/{scene.dataset}/thresholds'")
    expect(page.get_by_role("alert")).to_be_visible()

    page.unroute("**/later.js")
    page.get_by_role("button", name="Try again").click()

    expect(page.locator(".histogram--large canvas")).to_be_visible()
    expect(page.get_by_role("alert")).to_have_count(0)

    user.open(scene.link("ghost"))
    page.locator(".stage").evaluate("(stage) => { stage.mark = 'same'; }")

    user.press("j")

    expect(page.locator(".inspector__head h2")).to_have_text("walker walker")
    assert page.locator(".stage").evaluate("(stage) => stage.mark") == "same"
