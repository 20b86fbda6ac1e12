"""Takes the README's picture of the review page.

Give it the login link of a running `unghost demo`; its street is always the same, and
so is the box in the picture: a car that is hidden by a truck.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

from playwright.sync_api import expect, sync_playwright

from tools.ensure_chromium import SYSTEM_CHROMIUM
from unghost import Client

PICTURE: Final = Path(__file__).resolve().parents[1] / "docs" / "images" / "review.png"
DATASET, FRAME, BOX = "demo", "town-b/000005", "468"


def main(login_link: str) -> None:
    """Log in, open the box, and take the picture."""
    url, _, token = login_link.partition("/#token=")
    with Client(url, token) as client:
        frame = client.frame_by_key(DATASET, FRAME)
        (box,) = (box for box in frame.boxes if box.id == BOX)
    system = str(SYSTEM_CHROMIUM) if SYSTEM_CHROMIUM.exists() else None
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=system, args=["--no-sandbox", "--disable-gpu"]
        )
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(login_link)
        expect(page.get_by_text(DATASET, exact=True).first).to_be_visible()
        page.goto(f"{url}/#/frames/{frame.id}?box={box.box_id}")
        expect(page.locator(".stage")).to_have_attribute("data-picture", "shown")
        page.wait_for_load_state("networkidle")
        page.screenshot(path=str(PICTURE), animations="disabled")
        browser.close()


if __name__ == "__main__":
    main(sys.argv[1])
