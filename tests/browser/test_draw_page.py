"""The page that `unghost draw` writes, opened from the disk."""

import pytest
from playwright.sync_api import expect

from tests.support.frames import write_manifest
from unghost.cli.local.draw import DrawOptions, draw

pytestmark = pytest.mark.browser


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
