"""The page over `http://` from another machine.

Browsers withhold some functions there, such as locks and the clipboard.
"""

import pytest
from playwright.sync_api import expect

from tests.support.page.scenes import Scene
from tests.support.page.windows import OpenWindow, hold_timers

pytestmark = pytest.mark.browser

SECURE_FUNCTIONS = "[crypto.randomUUID, navigator.locks, navigator.clipboard]"
NOT_SECURE = """delete Crypto.prototype.randomUUID;
for (const name of ["locks", "clipboard"])
  Object.defineProperty(Navigator.prototype, name, { get: () => undefined });"""


def test_answers_are_saved_and_text_is_copied(scene: Scene, open_window: OpenWindow):
    user = open_window(own=True)
    # By a script, since pages of 127.0.0.1 count as secure.
    user.page.add_init_script(NOT_SECURE)
    page = user.open(scene.link("ghost"))
    assert page.evaluate(SECURE_FUNCTIONS) == [None, None, None]
    user.press("x")
    user.wait_until_saved()
    assert scene.review("ghost")["verdict"] == "reject"

    user.open(f"#/datasets/{scene.dataset}/thresholds")
    page.get_by_text("As YAML").click()
    yaml = page.get_by_label("Configuration as YAML").inner_text()
    hold_timers(page, 1500)  # the button says "Copied" until then

    page.get_by_role("button", name="Copy YAML").click()

    expect(page.get_by_role("button", name="Copied")).to_be_visible()
    user.open(scene.link("walker"))
    field = page.get_by_label("Comment")
    field.focus()
    page.keyboard.press("Control+V")
    expect(field).to_have_value(yaml)
