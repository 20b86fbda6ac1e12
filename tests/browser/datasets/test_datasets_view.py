"""The list of datasets."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect

from tests.support.page.accessibility import findings
from tests.support.page.windows import OVERFLOW

pytestmark = pytest.mark.browser


def test_empty_server_shows_how_to_upload_data(open_window, start_server):
    own = start_server()
    page = open_window(sign_in=False).page

    page.goto(own.login_link)

    expect(page.get_by_role("heading", name="No datasets yet")).to_be_visible()
    expect(page.locator("code").first).to_have_text(
        "unghost push FOLDER --dataset NAME"
    )
    expect(page.get_by_role("button", name=re.compile("^Copy"))).to_have_count(3)
    assert findings(page) == []
    # The longest command is wider than both windows.
    for width in (1440, 390):
        page.set_viewport_size({"width": width, "height": 844})
        assert page.evaluate(OVERFLOW) <= 0, width
