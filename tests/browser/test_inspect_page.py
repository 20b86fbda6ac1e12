"""The page that `unghost inspect --html` writes, opened from the disk."""

import pytest
import typer
from playwright.sync_api import expect

from tests.support.folders import mixed_recording
from tests.support.page.windows import OVERFLOW
from unghost.cli.local.inspect import InspectOptions, inspect

pytestmark = pytest.mark.browser

BACKGROUND = "getComputedStyle(document.body).backgroundColor"
ALL_DECODED = """async () => {
  const images = [...document.querySelectorAll("svg image")];
  const decoded = await Promise.all(images.map(async (image) => {
    const picture = new Image();
    picture.src = image.href.baseVal;
    await picture.decode();
    return picture.naturalWidth > 0;
  }));
  return decoded.length === 3 && decoded.every(Boolean);
}"""
STROKES = """() => ["kept", "rejected", "unmeasured"].map((word) => {
  const style = getComputedStyle(document.querySelector(`figure rect.${word}`));
  return [style.stroke, style.strokeDasharray];
})"""
ONE_LOOK = """() => [...document.querySelectorAll(".bar i")].every(
  (part) => part.getBoundingClientRect().width >= 1
    && part.getBoundingClientRect().right <= innerWidth)"""


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inspect")
    page = folder / "page.html"
    source = mixed_recording(folder / "street")
    with pytest.raises(typer.Exit):  # with code 3
        inspect(InspectOptions(source=source, html=page))
    return page.as_uri()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1440])
def test_page_shows_a_recording_without_loading_anything(
    browser, address, scheme, width
):
    viewport = {"width": width, "height": 900}
    context = browser.new_context(viewport=viewport, color_scheme=scheme)
    page = context.new_page()
    requests: list[str] = []
    faults: list[str] = []
    page.on("request", lambda request: requests.append(request.url))
    page.on("console", lambda message: faults.append(message.text))

    page.goto(address)

    assert page.evaluate(OVERFLOW) <= 0
    background = page.evaluate(BACKGROUND)
    light, dark = "rgb(246, 246, 247)", "rgb(12, 13, 16)"
    assert background == (dark if scheme == "dark" else light)
    assert page.evaluate(ALL_DECODED)
    strokes = page.evaluate(STROKES)
    assert [color for color, _ in strokes] == [
        *("rgb(20, 199, 149)", "rgb(255, 122, 47)", "rgb(195, 200, 208)")
    ]
    assert len({dashes for _, dashes in strokes}) == 3
    assert page.evaluate(ONE_LOOK)
    expect(page.locator(".serious")).to_have_count(4)
    expect(page.locator(".classes > div:not(.head)")).to_have_count(5)
    files = page.locator("details", has_text="no label file for this image")
    files.locator("summary").click()
    expect(files.get_by_text("and 15 more")).to_be_visible()
    expect(page.locator("pre")).to_contain_text("layout: yolo")
    assert [url for url in requests if not url.startswith("data:")] == [address]
    assert faults == []
    context.close()
