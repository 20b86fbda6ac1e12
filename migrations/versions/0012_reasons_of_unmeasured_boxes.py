"""Boxes of a class that is not known are unmeasured, no longer rejected.

Reason 5 stays for profile `carlasimu`, which drops such boxes, and for what earlier
runs have changed.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision: str | None = "0011"
branch_labels = None
depends_on = None

REJECTED_CLASS, NO_SEGMENTATION, UNMAPPED_CLASS = 5, 6, 15
REASONS = {
    1: "outside_image",
    2: "covers_image",
    3: "degenerate",
    4: "out_of_range",
    5: "unmapped_class",
    6: "no_segmentation",
    7: "no_visible_pixels",
    8: "large_below_threshold",
    9: "below_threshold",
    10: "explained_by_nearer",
    11: "hidden_by_depth",
    12: "hidden_by_instance",
    13: "too_few_lidar_points",
    14: "visible",
    15: "unmapped_class",
    16: "passed",
    17: "unknown_pixels",
}
FORMER = {code: name for code, name in REASONS.items() if code <= 14}
INDEXES = sa.text(
    "SELECT name, sql FROM sqlite_master "
    "WHERE type = 'index' AND tbl_name = 'decisions' AND sql IS NOT NULL"
)
TALLIES = sa.table(
    "tallies",
    *map(sa.column, ("dataset_id", "class_id", "reason", "toss_up", "review", "boxes")),
)


def upgrade() -> None:
    _allow(REASONS)
    by_paper = [
        dataset
        for dataset, body in op.get_bind().execute(
            sa.text(
                "SELECT d.id, c.body FROM datasets d "
                "JOIN config_versions c ON c.id = d.active_config_id"
            )
        )
        if json.loads(body).get("profile", "paper") == "paper"
    ]
    _replace({REJECTED_CLASS: UNMAPPED_CLASS}, by_paper)


def downgrade() -> None:
    datasets = op.get_bind().scalars(sa.text("SELECT id FROM datasets")).all()
    unmeasured = {16: NO_SEGMENTATION, 17: NO_SEGMENTATION}
    _replace({UNMAPPED_CLASS: REJECTED_CLASS, **unmeasured}, datasets)
    _allow(FORMER)


def _allow(reasons: dict[int, str]) -> None:
    # SQLite makes the table anew: the view has to go first, and Alembic would lose the
    # conditions of its indexes.
    op.execute("DROP VIEW readable_decisions")
    indexes: list[tuple[str, str]] = []
    if op.get_bind().dialect.name == "sqlite":
        indexes = [(name, sql) for name, sql in op.get_bind().execute(INDEXES)]
    with op.batch_alter_table("decisions") as decisions:
        decisions.drop_constraint(op.f("ck_decisions_reason"), type_="check")
        decisions.create_check_constraint(
            op.f("ck_decisions_reason"), f"reason between 1 and {max(reasons)}"
        )
    for name, sql in indexes:
        op.execute(f"DROP INDEX {name}")
        op.execute(sql)
    cases = " ".join(f"WHEN {code} THEN '{name}'" for code, name in reasons.items())
    unmeasured = ", ".join(str(code) for code in reasons if code == 6 or code > 14)
    op.execute(
        "CREATE VIEW readable_decisions AS "
        "SELECT d.box_id, s.name AS dataset, f.key AS frame, b.source_id AS id, "
        "c.name AS class, "
        f"CASE WHEN d.reason = 14 THEN 'kept' WHEN d.reason IN ({unmeasured}) "
        "THEN 'unmeasured' ELSE 'rejected' END AS verdict, "
        f"CASE d.reason {cases} END AS reason, "
        "d.match_percent, d.crowding, d.toss_up, d.review "
        "FROM decisions d JOIN boxes b ON b.id = d.box_id "
        "JOIN frames f ON f.id = d.frame_id "
        "JOIN dataset_classes c ON c.id = d.class_id "
        "JOIN datasets s ON s.id = d.dataset_id"
    )


def _replace(reasons: dict[int, int], datasets: Iterable[int]) -> None:
    """Replace reasons in decisions and in their tallies, where equal ones add up."""
    connection = op.get_bind()
    for dataset in datasets:
        for former, new in reasons.items():
            connection.execute(
                sa.text(
                    "UPDATE decisions SET reason = :new "
                    "WHERE dataset_id = :dataset AND reason = :former"
                ),
                {"new": new, "dataset": dataset, "former": former},
            )
        touched = (TALLIES.c.dataset_id == dataset) & TALLIES.c.reason.in_(
            {*reasons, *reasons.values()}
        )
        boxes: Counter[tuple[object, ...]] = Counter()
        for row in connection.execute(sa.select(TALLIES).where(touched)):
            reason = reasons.get(row.reason, row.reason)
            boxes[row.class_id, reason, row.toss_up, row.review] += row.boxes
        connection.execute(sa.delete(TALLIES).where(touched))
        for (class_id, reason, toss_up, review), count in boxes.items():
            connection.execute(
                sa.insert(TALLIES).values(
                    dataset_id=dataset,
                    class_id=class_id,
                    reason=reason,
                    toss_up=toss_up,
                    review=review,
                    boxes=count,
                )
            )
