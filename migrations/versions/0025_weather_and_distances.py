"""Frames have their weather as a column, and boxes the ends of their distance."""

from __future__ import annotations

import json

import sqlalchemy as sa
from alembic import op

revision = "0025"
down_revision: str | None = "0024"
branch_labels = None
depends_on = None

_LONGEST = 256
_AT_A_TIME = 1000
_ENDS = ("distance_from", "distance_to")


def upgrade() -> None:
    op.add_column("frames", sa.Column("weather", sa.String(_LONGEST), nullable=True))
    for name in _ENDS:
        op.add_column("decisions", sa.Column(name, sa.Double(), nullable=True))
    _fill(op.get_bind())


def downgrade() -> None:
    for name in _ENDS:
        op.drop_column("decisions", name)
    op.drop_column("frames", "weather")


def _fill(connection: sa.Connection) -> None:
    """Read the annotations that say one of them, some frames at a time."""
    last = 0
    rows = sa.text(
        "SELECT id, first_box_id, annotation FROM frames WHERE id > :last AND "
        "(annotation LIKE '%\"weather\"%' OR annotation LIKE '%\"distance_range\"%') "
        "ORDER BY id LIMIT :most"
    )
    name = sa.text("UPDATE frames SET weather = :weather WHERE id = :id")
    range_of_box = sa.text(
        "UPDATE decisions SET distance_from = :low, distance_to = :high "
        "WHERE box_id = :id AND distance IS NULL"
    )
    while found := connection.execute(rows, {"last": last, "most": _AT_A_TIME}).all():
        last = found[-1].id
        annotations = [json.loads(row.annotation) for row in found]
        weathers = [
            {"id": row.id, "weather": _weather(annotation.get("weather"))}
            for row, annotation in zip(found, annotations, strict=True)
        ]
        connection.execute(name, weathers)
        ranges = [
            {"id": row.first_box_id + place, "low": low, "high": high}
            for row, annotation in zip(found, annotations, strict=True)
            for place, box in enumerate(annotation.get("boxes") or ())
            if isinstance(box, dict) and box.get("distance_range")
            for low, high in [box["distance_range"]]
        ]
        if ranges:
            connection.execute(range_of_box, ranges)


def _weather(value: object) -> str | None:
    """The preset, as a new frame has it; ``other`` without one."""
    if not isinstance(value, dict):
        return None
    preset = value.get("preset")
    is_name = isinstance(preset, str) and 0 < len(preset) <= _LONGEST
    return str(preset) if is_name else "other"
