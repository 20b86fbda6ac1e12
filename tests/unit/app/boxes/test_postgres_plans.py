"""Of fifty thousand boxes, PostgreSQL reads those of the requested page and few others.

Each statement is run with EXPLAIN ANALYZE, which reports how many rows were read.
"""

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from sqlalchemy.orm import Session

from app.access.audit import AuditTrail
from app.boxes.counts import count
from app.boxes.current import TallyRepository
from app.boxes.filter import to_filter
from app.boxes.orders import ORDERS, BoxPages
from app.boxes.queries import FrameRepository, PageRequest
from app.boxes.reader import describe_box
from app.catalog.datasets import DatasetRepository
from app.catalog.frames import frames_state, key_rows
from app.context import ServiceContext
from app.db.tables import Dataset
from app.review.bulk import review_many
from app.review.queue import count_queue, next_boxes
from app.review.service import review_box
from app.security import Principal
from tests.support.databases import migrated_postgres
from tests.support.large_datasets import BOXES_PER_FRAME, DatasetSpec, make_dataset
from tests.support.services import running_services
from tests.support.statements import statements_of
from unghost.wire.boxes import (
    BoxSelection,
    BulkIn,
    QueueIn,
    ReviewIn,
)

FRAMES = 2_000
FEW_FRAMES = 600
"""Frames of other datasets: more than any statement about frames may read."""
BOXES = BOXES_PER_FRAME * FRAMES
NAME = "many"
ADA = Principal(1, "ada", "reviewer")
PAGE = 20
MOST_ROWS = 5_000
"""Far more than a page, but only a tenth of all boxes."""
NOT_TESTED = {
    ("rejected", "-match_percent"),
    ("visible", "match_percent"),
    ("matches", "doubt"),
}
"""Not tested: they come last in the order, so both databases read all others first."""


@pytest.fixture(scope="module")
def context(tmp_path_factory) -> Iterator[ServiceContext]:
    """A context with a dataset of fifty thousand boxes, an older and a newer one."""
    folder = tmp_path_factory.mktemp("plans")
    with (
        migrated_postgres() as url,
        running_services(folder, database_url=url) as services,
    ):
        sizes = (FEW_FRAMES, 1), (FRAMES, BOXES_PER_FRAME), (FEW_FRAMES, 1)
        for name, size in zip(("older", NAME, "newer"), sizes, strict=True):
            spec = DatasetSpec(name, *size)
            make_dataset(services.context, spec, lambda _boxes: None)
        with services.context.database.write() as session:
            session.connection().exec_driver_sql("ANALYZE")
        yield services.context


@pytest.fixture
def session(context) -> Iterator[Session]:
    with context.database.read() as session:
        yield session


@pytest.fixture
def dataset_row(session) -> Dataset:
    return DatasetRepository(session).named(NAME)


def plans_of(session: Session, read: Callable[[], object]) -> list[tuple[str, Any]]:
    """The statements that `read` runs, each with the plan that PostgreSQL followed."""
    with statements_of(session.connection()) as statements:
        read()
    verb = "EXPLAIN (ANALYZE, FORMAT JSON) "
    connection = session.connection()
    return [
        (statement, connection.exec_driver_sql(verb + statement, parameters).scalar())
        for statement, parameters in statements
        if statement.lstrip().upper().startswith(("SELECT", "WITH"))
    ]


def plan_nodes(plan: Any) -> Iterator[dict[str, Any]]:
    yield plan
    for part in plan.get("Plans", ()):
        yield from plan_nodes(part)


def rows_read(plan: Any) -> int:
    """The number of rows that were read, including those that were filtered out."""
    return sum(
        node["Actual Loops"]
        * (node["Actual Rows"] + node.get("Rows Removed by Filter", 0))
        for node in plan_nodes(plan)
        if "Scan" in node["Node Type"] and node.get("Relation Name")
    )


def scans_of_plan(plan: Any) -> Iterator[tuple[int, str, str]]:
    """Rows, index and condition of each scan, for the message of a failed check."""
    for node in plan_nodes(plan):
        if "Scan" in node["Node Type"]:
            rows = rows_read({**node, "Plans": []})
            condition = f"{node.get('Index Cond')} / {node.get('Filter')}"
            yield rows, str(node.get("Index Name", node["Node Type"])), condition


def check(session: Session, read: Callable[[], object], most: int = MOST_ROWS) -> None:
    """Check that `read` runs statements, and that none reads more than `most` rows."""
    plans = plans_of(session, read)
    assert plans
    for statement, ((explained,)) in plans:
        looked_at = rows_read(explained["Plan"])
        plan = sorted(scans_of_plan(explained["Plan"]), key=lambda scan: -scan[0])[:3]
        assert looked_at <= most, f"{looked_at} rows: {statement[:200]}\n{plan}"


SELECTIONS = {
    "all": BoxSelection(),
    "undecided": BoxSelection(review="undecided"),
    "rejected": BoxSelection(verdict="rejected"),
    "visible": BoxSelection(reason="visible"),
    "trucks": BoxSelection(class_name="truck"),
    "unanswered": BoxSelection(review="none"),
    "near": BoxSelection(margin_max=2),
    "toss-ups": BoxSelection(toss_up=True),
    "to ask": BoxSelection(bin="ask", review="none"),
    "matches": BoxSelection(match_min=20, match_max=60),
}


PAGES = [
    pytest.param(
        *(name, order),
        marks=() if order == "doubt" or name == "unanswered" else pytest.mark.long,
    )
    for name in SELECTIONS
    for order in ORDERS
    if (name, order) not in NOT_TESTED
]


@pytest.mark.parametrize(("name", "order"), PAGES)
def test_page_of_boxes_reads_few_rows(session, dataset_row, name, order):
    chosen = to_filter(session, dataset_row, SELECTIONS[name])
    pages = BoxPages(
        session, chosen, TallyRepository(session).of_dataset(dataset_row.id)
    )
    ids, cursor = pages.page(order, "", PAGE)

    assert len(ids) == PAGE
    check(session, lambda: pages.page(order, "", PAGE))
    check(session, lambda: pages.page(order, cursor or "", PAGE))


@pytest.mark.parametrize("order", ["doubt", "random", "class"])
def test_queue_reads_few_rows(context, session, dataset_row, order):
    request = QueueIn(order=order, limit=PAGE)
    queue = count_queue(context, NAME, "ada", request)

    with context.database.write() as writing:
        arguments = (writing, dataset_row, "ada", request, queue)
        batch = next_boxes(*arguments)
        check(writing, lambda: next_boxes(*arguments))

    boxes = count(TallyRepository(session).of_dataset(dataset_row.id))
    expected = BOXES if order == "random" else boxes.bins["ask"]
    items: Any = batch["items"]
    assert (len(items), batch["remaining"]) == (PAGE, expected)


def test_storing_a_review_reads_no_other_reviews(context, session, dataset_row):
    """PostgreSQL's statistics do not include the many answers given just before."""
    frames = FrameRepository(session)
    (frame,) = frames.page(dataset_row.id, PageRequest("key", None, 0))
    ids = list(range(frame.first_box_id, frame.first_box_id + BOXES // 10))
    many = BulkIn(dataset=NAME, verdict="keep", box_ids=ids)
    keep = ReviewIn(verdict="keep", seen_revision=0)

    with context.database.write() as writing:
        audit = AuditTrail(writing, ADA)
        assert review_many(context, audit, many, ADA).count == len(ids)
        check(
            writing, lambda: review_box(audit, ids[-1] + 1, keep, ADA, most=9), most=50
        )
        writing.rollback()


def test_counts_are_read_from_tallies(session, dataset_row):
    def read():
        assert count(TallyRepository(session).of_dataset(dataset_row.id)).boxes == BOXES
        frames_state(session, dataset_row.id)

    check(session, read, most=500)


def test_finding_frames_by_key_reads_few_rows(session, dataset_row):
    frames = FrameRepository(session)
    (some,) = frames.page(dataset_row.id, PageRequest("key", "", 0))
    keys = [f"{some.id + number:08d}" for number in range(50)]

    def read():
        for sort in ("key", "id"):
            frames.page(dataset_row.id, PageRequest(sort, None, PAGE))
        frames.page(dataset_row.id, PageRequest("key", "", PAGE), keys[30])
        frames.next_frames(dataset_row.id, after=keys[3], limit=PAGE)
        frames.neighbours(some)
        assert len(key_rows(session, dataset_row.id, keys)) == 50

    check(session, read, most=500)


def test_describing_a_box_by_id_reads_few_rows(session, dataset_row):
    frame = FrameRepository(session).page(dataset_row.id, PageRequest("key", "", 1))[0]

    check(session, lambda: describe_box(session, frame.first_box_id + 3), most=500)
