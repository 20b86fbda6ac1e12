"""Makes frames with many boxes, and reads what the grid and the queue show of them."""

from datetime import datetime, timezone
from typing import Any

import httpx
from playwright.sync_api import Locator, Page, expect

from tests.support.page import scenes
from tests.support.page.scenes import Scene
from tests.support.page.windows import Visitor


def alternating_boxes(count: int) -> list[dict[str, Any]]:
    """Boxes that are by turns on the car (kept) and in the sky (rejected)."""
    boxes = []
    for index in range(count):
        x0, y0, *_ = scenes.CAR if index % 2 == 0 else scenes.SKY
        step = index % 40
        xyxy = (x0 + step, y0 + step, x0 + step + 40, y0 + step + 30)
        boxes.append({"id": f"b{index}", "class": "car", "xyxy": xyxy, "distance": 10})
    return boxes


def fill(http: httpx.Client, dataset: str, frames: int, boxes: int) -> None:
    """Create a dataset of `frames` frames with `boxes` boxes each."""
    made = http.post("/datasets", json={"name": dataset, "palette": scenes.FAMILY})
    assert made.status_code == 201, made.text
    place = {"x": 0, "y": 0, "z": 0}
    size = {"width": scenes.WIDTH, "height": scenes.HEIGHT}
    annotation = {"camera": {**size, "fov": 90, "transform": place}}
    content = {**annotation, "boxes": alternating_boxes(boxes)}
    files = {"image": scenes.picture(), "segmentation": scenes.segmentation("palette")}
    for number in range(frames):
        scenes.put(http, dataset, f"run/{number:06d}", content, **files)


def grid(scene: Scene, **query: str) -> str:
    """The address of the grid, sorted by box id unless `query` says otherwise."""
    search = "&".join(f"{k}={v}" for k, v in {"sort": "id", **query}.items())
    return f"#/datasets/{scene.dataset}/grid?{search}"


def queue(scene: Scene, **query: str) -> str:
    """The address of the queue: of all boxes, unless `bin` says otherwise."""
    chosen = {"bin": "all", **query}
    search = "&".join(f"{key}={value}" for key, value in chosen.items() if value)
    return f"#/datasets/{scene.dataset}/queue{'?' if search else ''}{search}"


def open_grid(user: Visitor, scene: Scene, **query: str) -> Page:
    """Open the grid, and wait until its list is loaded."""
    page = user.open(grid(scene, **query))
    expect(page.get_by_role("grid")).to_have_attribute("aria-busy", "false")
    return page


def open_queue(user: Visitor, scene: Scene, **query: str) -> Page:
    """Open the queue, and wait until the picture of its first box is shown."""
    page = user.open(queue(scene, **query))
    expect(page.locator(".stage")).to_have_attribute("data-picture", "shown")
    return page


def cell(page: Page, index: int) -> Locator:
    return page.locator(f"[data-index='{index}']")


def selected(page: Page) -> list[int]:
    """The indexes of the selected cells, sorted."""
    marked = page.locator(".cell[aria-selected=true]").all()
    return sorted(int(cell.get_attribute("data-index") or -1) for cell in marked)


def answers(scene: Scene) -> dict[str, str]:
    """The stored answers, by the sender's box id."""
    boxes = answered_boxes(scene)
    names = {box["id"]: box["review"]["verdict"] for box in boxes}
    assert len(names) == len(boxes), "boxes of several frames share their names"
    return names


def answered_boxes(scene: Scene) -> list[dict[str, Any]]:
    """Every box that has an answer on the server."""
    page = scenes.get(scene.http, f"/boxes?dataset={scene.dataset}&review=any")
    items: list[dict[str, Any]] = page["items"]
    return items


def review(scene: Scene, box_id: int, verdict: str) -> None:
    """Give an answer through the API, as another person would."""
    revision = scenes.get(scene.http, f"/boxes/{box_id}")["revision"]
    body = {"verdict": verdict, "seen_revision": revision}
    assert scene.http.post(f"/boxes/{box_id}/reviews", json=body).status_code == 201


def review_as(scene: Scene, reviewer: str, name: str, verdict: str) -> None:
    """Give an answer of somebody else on a box of the first frame."""
    now = datetime.now(timezone.utc).isoformat()
    answer = {"frame": scene.frame["key"], "box": name, "verdict": verdict}
    body = {"answers": [{**answer, "reviewer": reviewer, "created_at": now}]}
    stored = scene.http.post(f"/datasets/{scene.dataset}/reviews/import", json=body)
    assert stored.json()["imported"] == 1, stored.text


def queued_box_id(page: Page) -> str:
    """The sender's id of the box that the queue shows."""
    return page.locator(".inspector__head h2").inner_text().split()[-1]
