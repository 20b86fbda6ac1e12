"""Frames have the camera and the drive of their annotations as columns."""

from __future__ import annotations

import json

import sqlalchemy as sa
from alembic import op

revision = "0022"
down_revision: str | None = "0021"
branch_labels = None
depends_on = None

_NAMES = ("camera", "sequence")
_LONGEST = 256
_AT_A_TIME = 1000


def upgrade() -> None:
    for name in _NAMES:
        op.add_column("frames", sa.Column(name, sa.String(_LONGEST), nullable=True))
    _fill(op.get_bind())
    op.create_index(
        "ix_frames_by_place",
        "frames",
        ["dataset_id", "sequence", "camera", "map", "id"],
        sqlite_where=sa.text("superseded_at IS NULL"),
        postgresql_where=sa.text("superseded_at IS NULL"),
    )


def downgrade() -> None:
    op.drop_index("ix_frames_by_place", "frames")
    for name in _NAMES:
        op.drop_column("frames", name)


def _fill(connection: sa.Connection) -> None:
    """Read the annotations that say one of them, some frames at a time."""
    last = 0
    rows = sa.text(
        "SELECT id, annotation FROM frames WHERE id > :last AND (annotation LIKE "
        "'%\"sequence\"%' OR annotation LIKE '%\"name\"%') ORDER BY id LIMIT :most"
    )
    change = sa.text(
        "UPDATE frames SET camera = :camera, sequence = :sequence WHERE id = :id"
    )
    while found := connection.execute(rows, {"last": last, "most": _AT_A_TIME}).all():
        last = found[-1].id
        told = [{"id": row.id, **_told(row.annotation)} for row in found]
        connection.execute(change, told)


def _told(text: str) -> dict[str, str | None]:
    annotation = json.loads(text)
    camera = annotation.get("camera")
    return {
        "camera": _text(camera.get("name") if isinstance(camera, dict) else None),
        "sequence": _text(annotation.get("sequence")),
    }


def _text(value: object) -> str | None:
    """A text that a column can hold."""
    if not isinstance(value, str) or "\0" in value or len(value) > _LONGEST:
        return None
    return value if value == value.encode("utf-8", "ignore").decode() else None
