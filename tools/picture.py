"""Takes the README's picture of the review page.

Give it the login link of a running `unghost demo`. The picture shows the largest ghost
there that a larger vehicle hides.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

from playwright.sync_api import ViewportSize, expect, sync_playwright

from tools.ensure_chromium import SYSTEM_CHROMIUM
from unghost import Client, Decision

PICTURE: Final = Path(__file__).resolve().parents[1] / "docs" / "images" / "review.png"
DATASET: Final = "demo"
SIZE: Final[ViewportSize] = {"width": 1360, "height": 800}
EDGE_PX: Final = 100
"""Nearer to the image's edge a box does not show well."""


def best_ghost(client: Client) -> Decision:
    """The largest box that a truck or a bus covers almost whole."""
    found = client.boxes(DATASET, verdict="rejected", reason="no_visible_pixels")
    return max((box for box in found if shows_well(box)), key=area)


def shows_well(box: Decision) -> bool:
    """Hidden by one vehicle, and well inside the image."""
    if not box.xyxy or not box.hidden_by or box.xyxy[0] < EDGE_PX:
        return False
    hider = box.hidden_by[0]
    return hider.name in ("Truck", "Bus") and hider.percent > 95


def area(box: Decision) -> float:
    """Percent of the image."""
    return box.area_percent or 0.0


def main(login_link: str) -> None:
    """Log in, open the box, and take the picture."""
    url, _, token = login_link.partition("/#token=")
    with Client(url, token) as client:
        box = best_ghost(client)
    system = str(SYSTEM_CHROMIUM) if SYSTEM_CHROMIUM.exists() else None
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=system, args=["--no-sandbox", "--disable-gpu"]
        )
        page = browser.new_page(viewport=SIZE)
        page.goto(login_link)
        expect(page.get_by_text(DATASET, exact=True).first).to_be_visible()
        page.goto(f"{url}/#/frames/{box.frame_id}?box={box.box_id}")
        expect(page.locator(".stage")).to_have_attribute("data-picture", "shown")
        page.wait_for_load_state("networkidle")
        page.screenshot(path=str(PICTURE), animations="disabled")
        browser.close()


if __name__ == "__main__":
    main(sys.argv[1])
