"""The grid of 100,000 boxes: few cells are in the document, whatever its length."""

from collections.abc import Iterator

import httpx
import pytest
from playwright.sync_api import Browser, Page, Request, expect
from sqlalchemy import insert, select

from app.db.tables import Frame, FrameFile
from tests.support.large_datasets import NAME, fill, open_context
from tests.support.page import many_boxes
from tests.support.page.many_boxes import cell
from tests.support.page.stage import bounds
from tests.support.page.windows import WIDE, route_loaded
from tests.support.servers import RunningServer

pytestmark = [pytest.mark.browser, pytest.mark.long]

BOXES = 100_000
CROPS = "/boxes/crops?"
NODES = "document.querySelectorAll('*').length"


@pytest.fixture(scope="module")
def dataset_of_100000_boxes(http: httpx.Client, server: RunningServer) -> str:
    """100,000 boxes, written directly to the database; all frames share one image."""
    many_boxes.fill(http, "one-picture", frames=1, boxes=1)
    (frame,) = http.get("/datasets/one-picture/frames").json()["items"]
    files = http.get(f"/frames/{frame['id']}").json()["files"]
    context = open_context(server.data)
    dataset_id = fill(context, BOXES, lambda _: None)
    with context.database.write() as session:
        ids = session.scalars(select(Frame.id).where(Frame.dataset_id == dataset_id))
        image = {"kind": "image", "sha256": files["image"]["sha256"]}
        session.execute(insert(FrameFile), [{"frame_id": n, **image} for n in ids])
    context.close()
    context.database.close()
    return NAME


@pytest.fixture
def page(
    browser: Browser, server: RunningServer, signed_in, dataset_of_100000_boxes: str
) -> Iterator[Page]:
    context = browser.new_context(storage_state=signed_in, viewport=WIDE)
    grid = context.new_page()
    grid.goto(f"{server.url}/#/datasets/{dataset_of_100000_boxes}/grid?sort=id")
    expect(grid.get_by_role("grid")).to_have_attribute("aria-busy", "false")
    yield grid
    context.close()


def scroll_to(page: Page, share: float) -> None:
    page.get_by_role("grid").evaluate(
        "(grid, share) => { grid.scrollTop = share * grid.scrollHeight; }", share
    )


def top_of(page: Page, index: int) -> float:
    box = bounds(cell(page, index))
    return box["y"]


def test_scrollbar_and_status_show_the_number_of_boxes(page):
    grid = page.get_by_role("grid")

    expect(page.locator(".grid-status p")).to_have_text("100 000 boxes")
    columns = int(grid.get_attribute("aria-colcount") or 0)
    assert int(grid.get_attribute("aria-rowcount") or 0) == -(-BOXES // columns)
    pitch = top_of(page, columns) - top_of(page, 0)
    assert abs(grid.evaluate("g => g.scrollHeight") / (BOXES / columns) - pitch) < 1


def test_few_cells_are_rendered_at_the_end_of_a_long_list(page):
    at_start = page.evaluate(NODES)

    page.keyboard.press("End")

    expect(cell(page, BOXES - 1)).to_be_visible()
    expect(cell(page, 0)).to_have_count(0)
    assert page.evaluate(NODES) < 1.5 * at_start
    assert page.locator(".cell").count() < 150


def test_scrolling_far_ahead_loads_the_boxes_there(page):
    scroll_to(page, 0.05)

    cell(page, 0).wait_for(state="detached")
    expect(page.locator(".cell:has(.cell__class)").first).to_be_visible(timeout=30_000)
    first = page.locator(".cell").first.get_attribute("data-index")
    assert int(first or 0) > 0.04 * BOXES


def test_unloaded_cells_show_placeholders_until_loaded(page):
    route_loaded(page, "**/api/v1/boxes?**cursor**", lambda route: None)
    scroll_to(page, 0.02)
    expect(page.locator(".cell__none.shimmer").first).to_be_visible()
    expect(page.locator(".cell").first).to_have_accessible_name("Loading")

    page.unroute("**/api/v1/boxes?**cursor**")
    page.reload()
    scroll_to(page, 0.02)

    expect(page.locator(".cell:has(.cell__class) img").first).to_be_visible()


def test_crop_requests_are_limited_and_cancelled_when_scrolled_past(page):
    under_way: set[str] = set()
    most: list[int] = []

    def record_request(request: Request) -> None:
        if CROPS in request.url:
            under_way.add(request.url)
            most.append(len(under_way))

    route_loaded(page, f"**{CROPS}**", lambda route: None)
    page.on("request", record_request)
    page.on("requestfailed", lambda request: under_way.discard(request.url))
    with page.expect_request(lambda request: CROPS in request.url):
        scroll_to(page, 0.001)

    with page.expect_event("requestfailed") as cancelled:
        scroll_to(page, 0.002)

    assert max(most) <= 8
    assert CROPS in cancelled.value.url
    page.unroute(f"**{CROPS}**")
    scroll_to(page, 0)
    expect(cell(page, 0).locator("img")).to_be_visible()


def test_range_of_thousands_of_boxes_is_one_bulk_answer(page, http):
    scroll_to(page, 0.03)
    cell(page, 0).wait_for(state="detached")
    expect(page.locator(".cell:has(.cell__class)").first).to_be_visible()
    page.get_by_role("grid").focus()
    page.keyboard.press("Home")
    cell(page, 0).click()
    scroll_to(page, 0.02)
    cell(page, 0).wait_for(state="detached")
    last = page.locator(".cell:has(.cell__class)").nth(20)
    expect(last).to_be_visible()
    index = int(last.get_attribute("data-index") or 0)
    last.click(modifiers=["Shift"])
    assert index > 1500
    expect(page.locator(".bar__count b")).to_have_text(
        f"{index + 1:,}".replace(",", " ")
    )

    page.keyboard.press("x")

    expect(page.locator(".toast")).to_contain_text("boxes rejected")
    counts = http.get("/boxes?dataset=million&review=reject&count=true&limit=1").json()
    assert counts["total"] == index + 1
    page.keyboard.press("z")
    expect(page.locator(".toast").last).to_contain_text("answers undone")
