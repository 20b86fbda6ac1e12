"""Lists compare boxes with thresholds in SQL, with the same results as the decisions.

Every reason occurs, and numbers of the evidence lie below, at and above thresholds.
"""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from sqlalchemy import create_engine, insert, select
from sqlalchemy.orm import Session

from app.boxes.filter import BoxFilter, class_thresholds, selected
from app.db.base import Base
from app.db.tables import Decision
from app.measuring.columns import DatasetColumns
from filter_core.arrays import NOT_MEASURED, floats_or_none
from filter_core.config.filter import FilterConfig
from filter_core.decisions.doubt import Bin, doubts
from filter_core.decisions.rules import decide
from filter_core.evidence_numbers import BoxState, ChannelNumbers
from filter_core.verdicts import Reason
from tests.support.evidence import evidence_of

DATASET = 1
DECISIONS = Base.metadata.tables[Decision.__tablename__]
CLASSES = ("car", "pole", "misc")
SPECIAL: tuple[dict[str, object], ...] = (
    {"state": BoxState.OUTSIDE_IMAGE},
    {"state": BoxState.COVERS_IMAGE},
    {"state": BoxState.DEGENERATE},
    {"distance": 300.0},
    {"accept_mask": 0},
    {"measured": False, "match_percent": np.nan},
    {"match_percent": 0.0},
    {"match_percent": 0.0, "unknown_pixels": 500},
)
MATCHES = (2.0, 3.0, 4.0, 7.0, 9.9, 10.0, 10.1, 14.0, 49.0, 50.0, 51.0, 54.0, 90.0)
MEASURED: tuple[dict[str, object], ...] = tuple(
    {"match_percent": match, "area_percent": area}
    for match in MATCHES
    for area in (1.0, 90.0)
)
BOXES = (*SPECIAL, *MEASURED)
COLUMNS = {
    "ordered": "owned_pixels",
    "depth": "depth_pixels",
    "instance": "instance_pixels",
    "lidar": "lidar_points",
}
"""The number by which each channel decides."""

CONFIGS = [
    FilterConfig.from_mapping(
        {
            "profile": profile,
            "evidence": evidence,
            "max_distance": 200,
            "classes": {
                "pole": {"threshold_small_box": 3, "threshold_big_box": 2},
                "misc": "pass",
            },
        }
    )
    for profile in ("paper", "carlasimu")
    for evidence in ("semantic", *COLUMNS)
]


def evidence_for(config):
    """Evidence of boxes of both classes, with several numbers of the channel."""
    column = COLUMNS.get(config.evidence)
    numbers = (NOT_MEASURED, 0, 9) if column else (NOT_MEASURED,)
    rows = list(product(range(len(CLASSES)), BOXES, numbers))
    evidence = evidence_of(
        [box | {"class_index": index} for index, box, _ in rows], CLASSES
    )
    if column is None:
        return evidence
    channels = ChannelNumbers.absent(len(rows))
    getattr(channels, column)[:] = [number for *_, number in rows]
    channels.explained_by[:] = 0
    return replace(evidence, channels=channels)


class StoredDecisions:
    """The boxes of a configuration: decided, and stored in a database."""

    def __init__(self, session, config):
        self.session, self.config, evidence = session, config, evidence_for(config)
        self.decisions = decide(evidence, config)
        count = len(evidence)
        self.ids = np.arange(1, count + 1)
        class_ids = evidence.class_index.astype(np.int64) + 1
        self.numbers = DatasetColumns(
            (0, 0), True, self.ids, self.ids, class_ids, evidence
        )
        self.thresholds = class_thresholds(
            config, dict(zip(CLASSES, (1, 2, 3), strict=True))
        )
        columns = {
            "box_id": self.ids.tolist(),
            "class_id": class_ids.tolist(),
            "match_percent": floats_or_none(evidence.match_percent),
            "distance": floats_or_none(evidence.distance),
            "reason": self.decisions.reason.tolist(),
            "large": self.decisions.large.tolist(),
            "toss_up": self.decisions.toss_up.tolist(),
            "doubt": doubts(evidence, config, self.decisions).doubt.tolist(),
        }
        same = {"dataset_id": DATASET, "frame_id": 1, "revision": 0, "crowding": 0.0}
        names = list(columns)
        session.execute(
            insert(DECISIONS),
            [
                dict(zip(names, row, strict=True)) | same
                for row in zip(*columns.values(), strict=True)
            ],
        )


@pytest.fixture(scope="module")
def engine():
    """One engine for all configurations, so that each statement is compiled once."""
    engine = create_engine("sqlite://")
    Base.metadata.create_all(engine)
    yield engine
    engine.dispose()


@pytest.fixture(
    scope="module",
    params=CONFIGS,
    ids=lambda config: f"{config.profile}-{config.evidence}",
)
def stored(request, engine):
    """The decisions of one configuration; tests only read them. None is committed."""
    with Session(engine) as session:
        yield StoredDecisions(session, request.param)


@pytest.mark.parametrize(
    "selection",
    [
        *({"margin_max": margin} for margin in (0.0, 0.5, 5.0, 60.0)),
        *({"bin": bin_} for bin_ in Bin),
    ],
    ids=str,
)
def test_selected_boxes_are_the_same_in_sql_and_on_columns(stored, selection):
    box_filter = BoxFilter(DATASET, thresholds=stored.thresholds, **selection)
    chosen = selected(stored.numbers, stored.config, box_filter)
    rows = select(Decision.box_id).where(*box_filter.conditions())

    by_columns = stored.ids[chosen].tolist()

    assert sorted(stored.session.scalars(rows)) == by_columns


def test_every_reason_occurs():
    reasons = {
        reason
        for config in CONFIGS
        for reason in decide(evidence_for(config), config).reason.tolist()
    }

    assert reasons == set(map(int, Reason))
