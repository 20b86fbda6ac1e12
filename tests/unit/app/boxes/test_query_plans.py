"""SQLite reads each page of boxes or frames through an index and does not sort it."""

from collections.abc import Callable, Iterator

import pytest
from sqlalchemy import select, text
from sqlalchemy.orm import Session

from app.boxes.current import TallyRepository
from app.boxes.filter import BoxProbes, to_filter
from app.boxes.orders import BoxPages
from app.db.tables import Decision
from tests.support import frames as scene
from tests.support.statements import Statement, statements_of
from unghost.wire.boxes import BoxSelection

pytestmark = pytest.mark.sqlite_files("plans as SQLite reports them")

BOXES = [
    {"class": name, "xyxy": xyxy}
    for name in ("car", "truck", "walker")
    for xyxy in (scene.ON_THE_CAR, scene.IN_THE_SKY, [0, 0, 64, 48], [90, 0, 99, 9])
]


@pytest.fixture(scope="module")
def street(services):
    street = services.dataset()
    for number in range(40):
        annotation = {**scene.annotation(), "boxes": BOXES, "number": number}
        street.put(f"{number:03}", annotation, segmentation=scene.segmentation())
    for box_id in street.box_ids()[:2]:
        street.review(box_id, "keep")
    return street


@pytest.fixture
def session(street) -> Iterator[Session]:
    with street.context.database.read() as session:
        yield session


def plan_of(session: Session, street, selection: BoxSelection, order: str) -> list[str]:
    """The steps of SQLite's query plans for the first page of a list."""
    chosen = to_filter(session, street.row(session), selection)
    tallies = TallyRepository(session).of_dataset(street.id)

    def read() -> None:
        ids, _ = BoxPages(session, chosen, tallies).page(order, "", 10)
        assert ids

    return plan_of_statements(session, read)


def plan_of_statements(session: Session, read: Callable[[], object]) -> list[str]:
    """The steps of SQLite's query plans for the statements that `read` runs."""
    with statements_of(session.connection()) as statements:
        read()
    return explain(session, statements)


def explain(session: Session, statements: list[Statement]) -> list[str]:
    connection = session.connection()
    return [
        row[3]
        for statement, parameters in statements
        for row in connection.exec_driver_sql(
            f"EXPLAIN QUERY PLAN {statement}", parameters
        )
    ]


PAGES = {
    "all by id": (BoxSelection(), "id", "by_class"),
    "not reviewed yet": (BoxSelection(review="undecided"), "id", "by_class"),
    "verdict": (BoxSelection(verdict="rejected"), "id", "by_reason"),
    "verdict, not reviewed yet": (
        BoxSelection(verdict="rejected", review="undecided"),
        "id",
        "by_reason",
    ),
    "reason": (BoxSelection(reason="visible"), "id", "by_reason"),
    "class": (BoxSelection(class_name="truck"), "id", "by_class"),
    "review": (BoxSelection(review="keep"), "id", "reviewed"),
    "doubt": (BoxSelection(), "doubt", "to_ask"),
    "match": (BoxSelection(class_name="car"), "match_percent", "by_match"),
    "match, falling": (BoxSelection(), "-match_percent", "by_match"),
    "crowding": (BoxSelection(), "crowding", "by_crowding"),
    "queue": (BoxSelection(review="none", bin="ask"), "doubt", "to_ask"),
    "verdict by doubt": (BoxSelection(verdict="kept"), "doubt", "to_ask"),
    "bin": (BoxSelection(bin="wall"), "doubt", "by_class"),
    "range by id": (BoxSelection(match_min=1, match_max=100), "id", "PRIMARY KEY"),
}


@pytest.mark.parametrize(("selection", "order", "index"), PAGES.values(), ids=PAGES)
def test_page_of_boxes_is_read_through_an_index_without_sorting(
    street, session, selection, order, index
):
    plan = plan_of(session, street, selection, order)

    reads = [step for step in plan if "decisions" in step]
    assert reads
    assert all(
        step.startswith("SEARCH") or "USING INTEGER PRIMARY KEY" in step
        for step in reads
    ), plan
    assert any(index in step for step in reads), plan
    assert not [step for step in plan if "TEMP B-TREE" in step], plan


@pytest.mark.parametrize("review", ["none", "undecided", "unsure"])
def test_boxes_by_id_are_read_through_the_primary_key(street, session, review):
    chosen = to_filter(session, street.row(session), BoxSelection(review=review))
    rows = select(Decision.box_id).where(
        Decision.box_id.in_(range(1, 500)), *chosen.conditions_by_id()
    )
    text_of = rows.compile(session.connection(), compile_kwargs={"literal_binds": True})

    (step,) = explain(session, [(str(text_of), ())])

    assert "USING INTEGER PRIMARY KEY" in step


def test_unanswered_toss_ups_are_read_through_the_toss_up_index(street, session):
    chosen = BoxSelection(review="none", toss_up=True)
    box_filter = to_filter(session, street.row(session), chosen)

    plan = plan_of_statements(session, lambda: BoxProbes(session).every(box_filter))

    assert [step for step in plan if "ix_decisions_toss_up" in step], plan


@pytest.mark.parametrize("selection", [{"conflict": True}, {"review": "decided"}])
def test_reviewed_boxes_are_read_through_the_review_index(street, session, selection):
    plan = plan_of(session, street, BoxSelection(**selection), "doubt")

    reads = [step for step in plan if "decisions" in step]
    indexes = ("ix_decisions_reviewed", "ix_decisions_to_ask")
    assert all(any(index in step for index in indexes) for step in reads), plan


def test_page_of_frames_is_read_through_an_index(session):
    rows = session.execute(
        text(
            "EXPLAIN QUERY PLAN SELECT id FROM frames WHERE dataset_id = 1 "
            "AND superseded_at IS NULL AND key > 'a' ORDER BY key LIMIT 10"
        )
    )

    (step,) = [row[3] for row in rows]
    assert "uq_frames_current_key" in step
