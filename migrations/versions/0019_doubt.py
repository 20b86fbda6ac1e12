"""The doubt about each box is stored, and tallies count its bins.

The values follow when the service starts: `refresh_doubt` in `app/runs/activate.py`
computes them.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision: str | None = "0018"
branch_labels = None
depends_on = None

KEY = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
MATCH = ("dataset_id", "class_id", "match_percent")
FORMER: dict[str, tuple[tuple[str, ...], str]] = {
    "ix_decisions_large": (MATCH, "large IS true"),
    "ix_decisions_unanswered": (MATCH, "review IS NULL"),
}
TO_ASK = ("dataset_id", "review", "doubt", "box_id", "class_id", "reason")


def upgrade() -> None:
    for name in FORMER:
        op.drop_index(_named(name), table_name="decisions")
    op.add_column(
        "decisions",
        sa.Column("doubt", sa.SmallInteger(), nullable=False, server_default="0"),
    )
    op.create_index(
        "ix_decisions_to_ask",
        "decisions",
        list(TO_ASK),
        sqlite_where=sa.text("doubt > 0"),
        postgresql_where=sa.text("doubt > 0"),
    )
    op.add_column(
        "datasets",
        sa.Column("doubt_version", sa.Integer(), nullable=False, server_default="0"),
    )
    _replace_tallies("bin")


def downgrade() -> None:
    _replace_tallies()
    op.drop_column("datasets", "doubt_version")
    op.drop_index("ix_decisions_to_ask", table_name="decisions")
    op.drop_column("decisions", "doubt")
    for name, (columns, where) in FORMER.items():
        _create(name, columns, where)


def _replace_tallies(*more: str) -> None:
    """Make the table anew: its primary key has another column, or one less."""
    key = ("dataset_id", "class_id", "reason", "toss_up")
    former = ", ".join((*key, "review"))
    op.rename_table("tallies", "former_tallies")
    if op.get_bind().dialect.name == "postgresql":
        for kind, owner in (("pk", "tallies"), ("fk", "tallies_dataset_id")):
            op.execute(
                f"ALTER TABLE former_tallies RENAME CONSTRAINT {kind}_{owner} "
                f"TO former_{kind}_{owner}"
            )
    op.create_table(
        "tallies",
        sa.Column("dataset_id", KEY, nullable=False),
        sa.Column("class_id", KEY, nullable=False),
        sa.Column("reason", sa.SmallInteger(), nullable=False),
        sa.Column("toss_up", sa.Boolean(), nullable=False),
        *(
            sa.Column(name, sa.SmallInteger(), nullable=False, server_default="0")
            for name in more
        ),
        sa.Column("review", sa.String(length=8), nullable=False),
        sa.Column("boxes", KEY, nullable=False),
        sa.ForeignKeyConstraint(
            ["dataset_id"],
            ["datasets.id"],
            name=op.f("fk_tallies_dataset_id"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint(*key, *more, "review", name=op.f("pk_tallies")),
    )
    op.execute(
        f"INSERT INTO tallies ({former}, boxes) "
        f"SELECT {former}, sum(boxes) FROM former_tallies GROUP BY {former}"
    )
    op.drop_table("former_tallies")


def _named(name: str) -> str:
    is_postgres = op.get_bind().dialect.name == "postgresql"
    return f"{name}_and_box" if is_postgres else name


def _create(name: str, columns: tuple[str, ...], where: str) -> None:
    is_postgres = op.get_bind().dialect.name == "postgresql"
    op.create_index(
        _named(name),
        "decisions",
        [*columns, "box_id"] if is_postgres else list(columns),
        sqlite_where=sa.text(where.replace("true", "1")),
        postgresql_where=sa.text(where),
    )
