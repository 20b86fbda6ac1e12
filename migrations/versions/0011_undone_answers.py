"""Each answer that undoes another one says which, also if both are on one box only."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from app.db.migrate import refuse_to_lose

revision = "0011"
down_revision: str | None = "0010"
branch_labels = None
depends_on = None

OF_UNDONE_BATCHES = """
UPDATE reviews SET undoes = (
    SELECT undone.revision
    FROM review_batches JOIN reviews AS undone
        ON undone.batch_id + 0 = review_batches.undoes_id
    WHERE review_batches.id = reviews.batch_id AND undone.box_id = reviews.box_id
)
WHERE batch_id IN (SELECT id FROM review_batches WHERE undoes_id IS NOT NULL)
"""
"""So far only the undo of a bulk answer was stored as an undo.

Written with `+ 0` so that answers are looked up by their box. By their batch, all
answers of the batch would be read for each of its boxes.
"""


def upgrade() -> None:
    op.add_column("reviews", sa.Column("undoes", sa.Integer(), nullable=True))
    op.execute(OF_UNDONE_BATCHES)


def downgrade() -> None:
    # Of the undo of a bulk answer, the batches say what it has undone.
    on_one_box = "undoes IS NOT NULL AND batch_id IS NULL"
    refuse_to_lose("reviews", on_one_box, what="which answers were undone")
    op.drop_column("reviews", "undoes")
