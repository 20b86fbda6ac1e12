"""The pages of `unghost inspect --html` and `unghost draw`, opened from the disk."""

import pytest
import typer
from playwright.sync_api import expect

from tests.support.folders import mixed_recording
from tests.support.frames import write_manifest
from tests.support.page.windows import OVERFLOW
from unghost.cli.local.draw import DrawOptions, draw
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


@pytest.mark.parametrize(
    ("width", "scheme"),
    [
        (390, "light"),
        (1440, "dark"),
        pytest.param(390, "dark", marks=pytest.mark.long),
        pytest.param(1440, "light", marks=pytest.mark.long),
    ],
)
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


def test_slider_moves_the_line_between_before_and_after(browser, tmp_path):
    source = write_manifest(tmp_path / "frames", 2)
    draw(DrawOptions(source=source, output=tmp_path / "out"))
    page = browser.new_page(viewport={"width": 900, "height": 700})
    page.goto((tmp_path / "out/index.html").as_uri())
    slider, after = page.get_by_role("slider").first, page.locator(".after").first
    expect(after).to_have_css("clip-path", "inset(0px 0px 0px 50%)")

    slider.press("End")

    expect(after).to_have_css("clip-path", "inset(0px 0px 0px 0%)")
    expect(page.locator(".after").nth(1)).to_have_css(
        "clip-path", "inset(0px 0px 0px 50%)"
    )
    page.close()
