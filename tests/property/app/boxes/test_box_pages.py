"""Lists of boxes, read page by page, equal filtering and sorting all boxes."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product, repeat
from typing import Any, NamedTuple

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlalchemy import create_engine, delete, insert
from sqlalchemy.orm import Session

from app.boxes.counts import count_in_tallies, tallies_of
from app.boxes.current import TallyRepository, replace_tallies
from app.boxes.filter import BoxFilter, BoxProbes, class_thresholds
from app.boxes.orders import ORDERS, RARE, BoxPages
from app.db.base import Base
from app.db.tables import Decision
from filter_core.config.filter import FilterConfig
from filter_core.decisions.doubt import Bin
from filter_core.verdicts import Reason, Verdict

DATASET, OTHER = 1, 2
DECISIONS = Base.metadata.tables[Decision.__tablename__]


class Limits(NamedTuple):
    """The thresholds of a class. A large box has to reach `kept_large` to be kept."""

    small: float
    large: float
    kept_large: float


PAPER = [Limits(10.0, 50.0, 50.0), Limits(2.5, 30.0, 30.0)]
PUBLISHED = [Limits(60.0, 50.0, 60.0), Limits(2.5, 30.0, 30.0)]
MATCHES = st.one_of(
    st.sampled_from([0.0, 2.5, 5.0, 10.0, 12.0, 15.0, 30.0, 50.0, 55.0, 60.0, 100.0]),
    st.floats(0, 100),
)
GEOMETRIC = [Reason.OUTSIDE_IMAGE, Reason.DEGENERATE, Reason.NO_SEGMENTATION]


@dataclass(frozen=True)
class Row:
    """The columns of a decision that lists use."""

    box_id: int
    class_id: int
    reason: Reason
    match: float | None
    crowding: float
    large: bool
    toss_up: bool
    doubt: int
    review: str | None

    def threshold(self, thresholds: list[Limits]) -> float | None:
        of_class = thresholds[self.class_id - 1]
        if self.reason is Reason.BELOW_THRESHOLD:
            return of_class.small
        if self.reason is Reason.LARGE_BELOW_THRESHOLD:
            return of_class.large
        if self.reason is Reason.VISIBLE:
            return of_class.kept_large if self.large else of_class.small
        return None

    def as_columns(self) -> dict[str, Any]:
        return {
            "box_id": self.box_id,
            "dataset_id": DATASET,
            "frame_id": 1,
            "class_id": self.class_id,
            "match_percent": self.match,
            "crowding": self.crowding,
            "distance": None,
            "reason": int(self.reason),
            "large": self.large,
            "toss_up": self.toss_up,
            "doubt": self.doubt,
            "review": self.review,
            "revision": 0,
        }


def decided(match: float, large: bool, limits: Limits, published: bool):
    """The reason by thresholds: of profile carlasimu if `published`, else of paper."""
    small = match <= limits.small if published else match < limits.small
    big = match <= limits.large if published else match < limits.large
    if large and big:
        return Reason.LARGE_BELOW_THRESHOLD
    if small and (published or not large):
        return Reason.BELOW_THRESHOLD
    return Reason.VISIBLE


# Of each box: class, answer, crowding; whether it is large, and a toss-up; doubt. One
# choice among all combinations costs a fifth of six choices.
PLAIN_COLUMNS = st.sampled_from(
    [
        *product(
            (1, 2),
            (None, None, "keep", "reject", "unsure"),
            (0.0, 49.9, 80.0),
            (False, True),
            (False, True),
            (-2, -1, 0, 1, 7, 100),
        )
    ]
)
# A match, or for some boxes a reason that does not depend on the match.
MATCH_OR_REASON = st.one_of(
    MATCHES, st.sampled_from([*GEOMETRIC, Reason.NO_VISIBLE_PIXELS])
)


@st.composite
def decision_rows(draw, published: bool) -> list[Row]:
    thresholds = PUBLISHED if published else PAPER
    rows = []
    for box_id in range(1, draw(st.integers(0, 40)) + 1):
        class_id, answer, crowding, large, toss_up, doubt = draw(PLAIN_COLUMNS)
        drawn = draw(MATCH_OR_REASON)
        if isinstance(drawn, Reason):
            reason = drawn
            match = None if reason in GEOMETRIC else 0.0
            large, toss_up = False, False
        else:
            match = drawn
            reason = decided(match, large, thresholds[class_id - 1], published)
        flags = large, toss_up, doubt
        rows.append(Row(box_id, class_id, reason, match, crowding, *flags, answer))
    return rows


REASONS = [
    (int(Reason.VISIBLE),),
    (int(Reason.BELOW_THRESHOLD), int(Reason.OUTSIDE_IMAGE)),
    tuple(int(each) for each in Reason if each.verdict is Verdict.REJECTED),
    (0,),
]
FILTERS = st.fixed_dictionaries(
    {},
    optional={
        "reasons": st.sampled_from(REASONS),
        "class_ids": st.sampled_from([(1,), (2,), (1, 2), ()]),
        "review": st.sampled_from(["undecided", "decided", "keep", "none", "any"]),
        "effective": st.sampled_from(Verdict),
        "toss_up": st.booleans(),
        "bin": st.sampled_from(Bin),
        "conflict": st.booleans(),
        "match_min": st.just(10.0),
        "match_max": st.just(55.0),
        "margin_max": st.just(5.0),
    },
)

REVIEWS = {
    "undecided": (None, "unsure"),
    "decided": ("keep", "reject"),
    "keep": ("keep",),
    "none": (None,),
    "any": ("keep", "reject", "unsure"),
}


def effective(row: Row) -> Verdict:
    verdict_of = {"keep": Verdict.KEPT, "reject": Verdict.REJECTED}
    return verdict_of.get(row.review or "", row.reason.verdict)


def selected(row: Row, chosen: dict[str, Any], thresholds) -> bool:
    """Whether a row passes all filters, each by its definition."""
    match = -1.0 if row.match is None else row.match
    return (
        (not chosen.get("reasons") or int(row.reason) in chosen["reasons"])
        and (chosen.get("class_ids") is None or row.class_id in chosen["class_ids"])
        and ("review" not in chosen or row.review in REVIEWS[chosen["review"]])
        and ("effective" not in chosen or effective(row) is chosen["effective"])
        and ("toss_up" not in chosen or row.toss_up is chosen["toss_up"])
        and ("bin" not in chosen or min(row.doubt, 1) == chosen["bin"])
        and ("conflict" not in chosen or is_conflict(row) is chosen["conflict"])
        and ("match_min" not in chosen or match >= chosen["match_min"])
        and ("match_max" not in chosen or 0 <= match <= chosen["match_max"])
        and ("margin_max" not in chosen or is_within(row, thresholds, 5.0))
    )


def is_conflict(row: Row) -> bool:
    said = (row.review, row.reason.verdict)
    return said in [("keep", Verdict.REJECTED), ("reject", Verdict.KEPT)]


def is_within(row: Row, thresholds, percent: float) -> bool:
    threshold = row.threshold(thresholds)
    if threshold is None or row.match is None:
        return False
    return threshold - percent <= row.match <= threshold + percent


def key(row: Row, order: str, thresholds: list[Limits]) -> Any:
    """The sort key of an order; rows of equal keys may come in any order."""
    match = (row.match is None, row.match or 0.0)
    return {
        "id": row.box_id,
        "doubt": -row.doubt,
        "match_percent": match,
        "-match_percent": (match[0], -match[1]),
        "crowding": -row.crowding,
    }[order]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    path = tmp_path_factory.mktemp("pages") / "boxes.sqlite3"
    engine = create_engine(f"sqlite:///{path}")
    Base.metadata.create_all(engine)
    with Session(engine) as session:
        yield session
    engine.dispose()


def store_decisions(session: Session, rows: list[Row]) -> None:
    session.execute(delete(Decision))
    columns = [row.as_columns() for row in rows]
    strangers = [
        row | {"box_id": row["box_id"] + 100_000, "dataset_id": OTHER}
        for row in columns
    ]
    if rows:
        # The table's own insert: that of the class needs a statement for each change of
        # the columns that are null.
        session.execute(insert(DECISIONS), columns + strangers)
    alike = (
        (row.class_id, int(row.reason), row.toss_up, row.doubt, row.review)
        for row in rows
    )
    replace_tallies(session, DATASET, tallies_of(alike))


def stored_thresholds(thresholds: list[Limits], published: bool):
    """The same thresholds as the service has them: of a configuration's classes."""
    names = [f"class {number}" for number in range(1, 1 + len(thresholds))]
    classes = {
        name: {"threshold_small_box": each.small, "threshold_big_box": each.large}
        for name, each in zip(names, thresholds, strict=True)
    }
    profile = "carlasimu" if published else "paper"
    config = FilterConfig.from_mapping({"profile": profile, "classes": classes})
    return class_thresholds(config, {name: at for at, name in enumerate(names, 1)})


def read_all_pages(
    session: Session, chosen: BoxFilter, order: str, limits, rare: int = RARE
) -> list[int]:
    tallies = TallyRepository(session).of_dataset(DATASET)
    box_ids: list[int] = []
    cursor: str | None = ""
    sizes = iter(limits)
    while cursor is not None:
        pages = BoxPages(session, chosen, tallies, rare=rare)
        limit = next(sizes, 7)
        ids, cursor = pages.page(order, cursor, limit)
        assert len(ids) == limit or cursor is None
        box_ids += ids
    return box_ids


@pytest.mark.parametrize("published", [False, True], ids=["paper", "carlasimu"])
@pytest.mark.parametrize(
    ("order", "rare"), [*((order, RARE) for order in ORDERS), ("doubt", 0)]
)
@settings(suppress_health_check=list(HealthCheck))
@given(
    data=st.data(), selection=FILTERS, limits=st.lists(st.integers(1, 9), max_size=5)
)
def test_pages_list_all_boxes_of_the_filter_in_order(
    session, order, rare, published, data, selection, limits
):
    thresholds = PUBLISHED if published else PAPER
    rows = data.draw(decision_rows(published))
    store_decisions(session, rows)
    limits_of = stored_thresholds(thresholds, published)
    query = BoxFilter(DATASET, thresholds=limits_of, **selection)

    box_ids = read_all_pages(session, query, order, limits, rare)

    expected = [row for row in rows if selected(row, selection, thresholds)]
    assert sorted(box_ids) == [row.box_id for row in expected]
    by_id = {row.box_id: row for row in rows}
    keys = [key(by_id[box_id], order, thresholds) for box_id in box_ids]
    assert keys == sorted(keys)
    tallies = TallyRepository(session).of_dataset(DATASET)
    counted = BoxProbes(session).count(query)
    if not query.is_beyond_tallies:
        assert count_in_tallies(tallies, query) == counted
    assert counted == len(expected)


@pytest.mark.parametrize(
    ("classes", "order", "selection"),
    [
        (40, "doubt", {}),
        (100, "doubt", {"margin_max": 5.0}),
        (100, "doubt", {"review": "none"}),
        pytest.param(100, "match_percent", {"margin_max": 5.0}, marks=pytest.mark.long),
        pytest.param(100, "id", {"margin_max": 5.0}, marks=pytest.mark.long),
    ],
)
def test_dataset_of_many_classes_is_listed_in_the_same_order(
    session, order, classes, selection
):
    """Even the classes of one tier of the order need more than one statement."""
    thresholds = [PAPER[number % 2] for number in range(classes)]
    rows: list[Row] = []
    for class_id, limits in enumerate(thresholds, 1):
        for match, flags in product((1.0, 12.0, 40.0, 60.0), range(4)):
            large, toss_up = bool(flags & 1), bool(flags & 2)
            reason = decided(match, large, limits, published=False)
            answer = "keep" if len(rows) % 7 == 0 else None
            crowding = 70.0 if len(rows) % 5 == 0 else 0.0
            at = len(rows) + 1
            columns = large, toss_up, len(rows) % 9 - 2, answer
            rows.append(Row(at, class_id, reason, match, crowding, *columns))
    store_decisions(session, rows)
    limits_of = stored_thresholds(thresholds, published=False)
    query = BoxFilter(DATASET, thresholds=limits_of, **selection)

    box_ids = read_all_pages(session, query, order, repeat(400), rare=1)

    expected = [row.box_id for row in rows if selected(row, selection, thresholds)]
    assert sorted(box_ids) == expected
    keys = [key(rows[box_id - 1], order, thresholds) for box_id in box_ids]
    assert keys == sorted(keys)
