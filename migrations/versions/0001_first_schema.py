"""The first schema: datasets, frames, evidence, decisions, reviews, access."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from app.db.migrate import refuse_to_lose

revision = "0001"
down_revision: str | None = None
branch_labels = None
depends_on = None

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
}
KEY = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    op.create_table(
        "blobs",
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("size_bytes", KEY, nullable=False),
        sa.Column("media_type", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("sha256", name=op.f("pk_blobs")),
    )
    op.create_table(
        "datasets",
        sa.Column("id", KEY, nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("description", sa.Text(), nullable=False),
        sa.Column("palette", sa.String(length=32), nullable=False),
        sa.Column("encoding", sa.String(length=16), nullable=False),
        sa.Column("channel_order", sa.String(length=8), nullable=False),
        sa.Column("lossy_segmentation", sa.String(length=16), nullable=False),
        sa.Column("ignore_mask", sa.Text(), nullable=True),
        sa.Column("active_config_id", KEY, nullable=True),
        sa.Column("active_run_id", KEY, nullable=True),
        sa.Column("active_measurement_id", KEY, nullable=True),
        sa.Column("classes_frozen_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("created_by", sa.String(length=100), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_datasets")),
        sa.UniqueConstraint("name", name=op.f("uq_datasets_name")),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "id_blocks",
        sa.Column("name", sa.String(length=16), nullable=False),
        sa.Column("next_id", KEY, nullable=False),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_id_blocks")),
    )
    op.create_table(
        "idempotency_keys",
        sa.Column("token_id", KEY, nullable=False),
        sa.Column("key", sa.String(length=200), nullable=False),
        sa.Column("request_digest", sa.String(length=64), nullable=False),
        sa.Column("status", sa.Integer(), nullable=False),
        sa.Column("media_type", sa.String(length=64), nullable=False),
        sa.Column("headers", sa.String(length=2000), nullable=False),
        sa.Column("body", sa.LargeBinary(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("token_id", "key", name=op.f("pk_idempotency_keys")),
    )
    op.create_table(
        "tokens",
        sa.Column("id", KEY, nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("role", sa.String(length=16), nullable=False),
        sa.Column("hash", sa.String(length=64), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("revoked_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "role in ('viewer', 'reviewer', 'admin')", name=op.f("ck_tokens_role")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_tokens")),
        sa.UniqueConstraint("hash", name=op.f("uq_tokens_hash")),
        sa.UniqueConstraint("name", name=op.f("uq_tokens_name")),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "config_versions",
        sa.Column("id", KEY, nullable=False),
        sa.Column("dataset_id", KEY, nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("body", sa.Text(), nullable=False),
        sa.Column("unused_keys", sa.Text(), nullable=False),
        sa.Column("created_by", sa.String(length=100), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["dataset_id"],
            ["datasets.id"],
            name=op.f("fk_config_versions_dataset_id"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_config_versions")),
        sa.UniqueConstraint(
            "dataset_id", "digest", name=op.f("uq_config_versions_dataset_id_digest")
        ),
        sqlite_autoincrement=True,
    )
    op.create_index(
        op.f("ix_config_versions_digest"), "config_versions", ["digest"], unique=False
    )
    op.create_table(
        "dataset_classes",
        sa.Column("id", KEY, nullable=False),
        sa.Column("dataset_id", KEY, nullable=False),
        sa.Column("position", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.ForeignKeyConstraint(
            ["dataset_id"],
            ["datasets.id"],
            name=op.f("fk_dataset_classes_dataset_id"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_dataset_classes")),
        sa.UniqueConstraint(
            "dataset_id", "name", name=op.f("uq_dataset_classes_dataset_id_name")
        ),
        sa.UniqueConstraint(
            "dataset_id",
            "position",
            name=op.f("uq_dataset_classes_dataset_id_position"),
        ),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "exports",
        sa.Column("id", KEY, nullable=False),
        sa.Column("dataset_id", KEY, nullable=False),
        sa.Column("format", sa.String(length=32), nullable=False),
        sa.Column("options", sa.Text(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("run_id", KEY, nullable=True),
        sa.Column("sha256", sa.String(length=64), nullable=True),
        sa.Column("size_bytes", KEY, nullable=True),
        sa.Column("media_type", sa.String(length=64), nullable=True),
        sa.Column("counts", sa.Text(), nullable=True),
        sa.Column("error", sa.Text(), nullable=True),
        sa.Column("created_by", sa.String(length=100), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("finished_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "state in ('queued', 'running', 'done', 'failed')",
            name=op.f("ck_exports_state"),
        ),
        sa.ForeignKeyConstraint(
            ["dataset_id"],
            ["datasets.id"],
            name=op.f("fk_exports_dataset_id"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_exports")),
        sqlite_autoincrement=True,
    )
    op.create_index(
        op.f("ix_exports_dataset_id_id"), "exports", ["dataset_id", "id"], unique=False
    )
    op.create_table(
        "frames",
        sa.Column("id", KEY, nullable=False),
        sa.Column("dataset_id", KEY, nullable=False),
        sa.Column("key", sa.String(length=512), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("superseded_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("content_digest", sa.String(length=64), nullable=False),
        sa.Column("config_id", KEY, nullable=False),
        sa.Column("run_id", KEY, nullable=False),
        sa.Column("first_box_id", KEY, nullable=False),
        sa.Column("box_count", sa.Integer(), nullable=False),
        sa.Column("width", sa.Integer(), nullable=True),
        sa.Column("height", sa.Integer(), nullable=True),
        sa.Column("carla_version", sa.String(length=200), nullable=True),
        sa.Column("map", sa.String(length=200), nullable=True),
        sa.Column("captured_at", sa.String(length=64), nullable=True),
        sa.Column("annotation", sa.Text(), nullable=False),
        sa.Column("created_by", sa.String(length=100), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["dataset_id"],
            ["datasets.id"],
            name=op.f("fk_frames_dataset_id"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_frames")),
        sa.UniqueConstraint(
            "dataset_id",
            "key",
            "revision",
            name=op.f("uq_frames_dataset_id_key_revision"),
        ),
    )
    op.create_index(
        op.f("ix_frames_dataset_id_id"), "frames", ["dataset_id", "id"], unique=False
    )
    op.create_index(
        "uq_frames_current_key",
        "frames",
        ["dataset_id", "key"],
        unique=True,
        sqlite_where=sa.text("superseded_at IS NULL"),
        postgresql_where=sa.text("superseded_at IS NULL"),
    )
    op.create_table(
        "login_sessions",
        sa.Column("hash", sa.String(length=64), nullable=False),
        sa.Column("token_id", KEY, nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["token_id"],
            ["tokens.id"],
            name=op.f("fk_login_sessions_token_id"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("hash", name=op.f("pk_login_sessions")),
    )
    op.create_index(
        op.f("ix_login_sessions_token_id"), "login_sessions", ["token_id"], unique=False
    )
    op.create_table(
        "measurements",
        sa.Column("id", KEY, nullable=False),
        sa.Column("dataset_id", KEY, nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("pixel_digest", sa.String(length=64), nullable=False),
        sa.Column("options", sa.Text(), nullable=False),
        sa.Column("filter_core_version", sa.String(length=32), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["dataset_id"],
            ["datasets.id"],
            name=op.f("fk_measurements_dataset_id"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_measurements")),
        sa.UniqueConstraint(
            "dataset_id", "digest", name=op.f("uq_measurements_dataset_id_digest")
        ),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "problems",
        sa.Column("id", KEY, nullable=False),
        sa.Column("dataset_id", KEY, nullable=False),
        sa.Column("key", sa.String(length=512), nullable=False),
        sa.Column("error", sa.Text(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["dataset_id"],
            ["datasets.id"],
            name=op.f("fk_problems_dataset_id"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_problems")),
        sqlite_autoincrement=True,
    )
    op.create_index(
        op.f("ix_problems_dataset_id_id"),
        "problems",
        ["dataset_id", "id"],
        unique=False,
    )
    op.create_table(
        "review_batches",
        sa.Column("id", KEY, nullable=False),
        sa.Column("dataset_id", KEY, nullable=False),
        sa.Column("verdict", sa.String(length=8), nullable=False),
        sa.Column("undoes_id", KEY, nullable=True),
        sa.Column("reviewer", sa.String(length=100), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["dataset_id"],
            ["datasets.id"],
            name=op.f("fk_review_batches_dataset_id"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_review_batches")),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "tallies",
        sa.Column("dataset_id", KEY, nullable=False),
        sa.Column("class_id", KEY, nullable=False),
        sa.Column("reason", sa.SmallInteger(), nullable=False),
        sa.Column("toss_up", sa.Boolean(), nullable=False),
        sa.Column("review", sa.String(length=8), nullable=False),
        sa.Column("boxes", KEY, nullable=False),
        sa.ForeignKeyConstraint(
            ["dataset_id"],
            ["datasets.id"],
            name=op.f("fk_tallies_dataset_id"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint(
            "dataset_id",
            "class_id",
            "reason",
            "toss_up",
            "review",
            name=op.f("pk_tallies"),
        ),
    )
    op.create_table(
        "boxes",
        sa.Column("id", KEY, autoincrement=False, nullable=False),
        sa.Column("frame_id", KEY, nullable=False),
        sa.Column("class_id", KEY, nullable=False),
        sa.Column("source_id", sa.String(length=200), nullable=False),
        sa.ForeignKeyConstraint(
            ["class_id"],
            ["dataset_classes.id"],
            name=op.f("fk_boxes_class_id"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["frame_id"],
            ["frames.id"],
            name=op.f("fk_boxes_frame_id"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_boxes")),
    )
    op.create_index(op.f("ix_boxes_frame_id"), "boxes", ["frame_id"], unique=False)
    op.create_table(
        "evidence",
        sa.Column("id", KEY, nullable=False),
        sa.Column("frame_id", KEY, nullable=False),
        sa.Column("measurement_id", KEY, nullable=False),
        sa.Column("numbers", sa.LargeBinary(), nullable=False),
        sa.Column("tag_counts", sa.LargeBinary(), nullable=False),
        sa.Column("geometry", sa.LargeBinary(), nullable=False),
        sa.Column("segmentation", sa.Text(), nullable=True),
        sa.Column("lossy", sa.Boolean(), nullable=False),
        sa.ForeignKeyConstraint(
            ["frame_id"],
            ["frames.id"],
            name=op.f("fk_evidence_frame_id"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["measurement_id"],
            ["measurements.id"],
            name=op.f("fk_evidence_measurement_id"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_evidence")),
        sa.UniqueConstraint(
            "frame_id",
            "measurement_id",
            name=op.f("uq_evidence_frame_id_measurement_id"),
        ),
    )
    op.create_index(
        "ix_evidence_lossy",
        "evidence",
        ["measurement_id"],
        sqlite_where=sa.text("lossy IS 1"),
        postgresql_where=sa.text("lossy IS true"),
    )
    op.create_index(
        op.f("ix_evidence_measurement_id"), "evidence", ["measurement_id"], unique=False
    )
    op.create_table(
        "frame_files",
        sa.Column("frame_id", KEY, nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(
            ["frame_id"],
            ["frames.id"],
            name=op.f("fk_frame_files_frame_id"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["sha256"], ["blobs.sha256"], name=op.f("fk_frame_files_sha256")
        ),
        sa.PrimaryKeyConstraint("frame_id", "kind", name=op.f("pk_frame_files")),
    )
    op.create_index(
        op.f("ix_frame_files_sha256"), "frame_files", ["sha256"], unique=False
    )
    op.create_table(
        "runs",
        sa.Column("id", KEY, nullable=False),
        sa.Column("dataset_id", KEY, nullable=False),
        sa.Column("config_id", KEY, nullable=False),
        sa.Column("measurement_id", KEY, nullable=True),
        sa.Column("previous_run_id", KEY, nullable=True),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("activate", sa.Boolean(), nullable=False),
        sa.Column("total", KEY, nullable=False),
        sa.Column("done", KEY, nullable=False),
        sa.Column("changed", KEY, nullable=False),
        sa.Column("counts", sa.Text(), nullable=False),
        sa.Column("error", sa.Text(), nullable=True),
        sa.Column("created_by", sa.String(length=100), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("finished_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint("kind in ('decide', 'measure')", name=op.f("ck_runs_kind")),
        sa.CheckConstraint(
            "state in ('queued', 'running', 'done', 'failed', 'cancelled')",
            name=op.f("ck_runs_state"),
        ),
        sa.ForeignKeyConstraint(
            ["config_id"],
            ["config_versions.id"],
            name=op.f("fk_runs_config_id"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["dataset_id"],
            ["datasets.id"],
            name=op.f("fk_runs_dataset_id"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["measurement_id"],
            ["measurements.id"],
            name=op.f("fk_runs_measurement_id"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_runs")),
        sqlite_autoincrement=True,
    )
    op.create_index(
        op.f("ix_runs_dataset_id_id"), "runs", ["dataset_id", "id"], unique=False
    )
    op.create_table(
        "decisions",
        sa.Column("box_id", KEY, autoincrement=False, nullable=False),
        sa.Column("dataset_id", KEY, nullable=False),
        sa.Column("frame_id", KEY, nullable=False),
        sa.Column("class_id", KEY, nullable=False),
        sa.Column("match_percent", sa.Double(), nullable=True),
        sa.Column("crowding", sa.Double(), nullable=False),
        sa.Column("distance", sa.Double(), nullable=True),
        sa.Column("reason", sa.SmallInteger(), nullable=False),
        sa.Column("large", sa.Boolean(), nullable=False),
        sa.Column("toss_up", sa.Boolean(), nullable=False),
        sa.Column("review", sa.String(length=8), nullable=True),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.CheckConstraint(
            "review in ('keep', 'reject', 'unsure')", name=op.f("ck_decisions_review")
        ),
        sa.CheckConstraint("reason between 1 and 14", name=op.f("ck_decisions_reason")),
        sa.ForeignKeyConstraint(
            ["box_id"],
            ["boxes.id"],
            name=op.f("fk_decisions_box_id"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("box_id", name=op.f("pk_decisions")),
    )
    op.create_index(
        "ix_decisions_by_class",
        "decisions",
        ["dataset_id", "class_id", "box_id"],
        unique=False,
    )
    op.create_index(
        "ix_decisions_by_match",
        "decisions",
        ["dataset_id", "class_id", "match_percent"],
        unique=False,
    )
    op.create_index(
        "ix_decisions_by_reason",
        "decisions",
        ["dataset_id", "reason", "box_id"],
        unique=False,
    )
    op.create_index(
        "ix_decisions_by_crowding",
        "decisions",
        ["dataset_id", "crowding"],
        unique=False,
    )
    op.create_index(
        op.f("ix_decisions_frame_id"), "decisions", ["frame_id"], unique=False
    )
    op.create_index(
        "ix_decisions_large",
        "decisions",
        ["dataset_id", "class_id", "match_percent"],
        unique=False,
        sqlite_where=sa.text("large IS 1"),
        postgresql_where=sa.text("large IS true"),
    )
    op.create_index(
        "ix_decisions_reviewed",
        "decisions",
        ["dataset_id", "review", "box_id"],
        unique=False,
        sqlite_where=sa.text("review IS NOT NULL"),
        postgresql_where=sa.text("review IS NOT NULL"),
    )
    op.create_index(
        "ix_decisions_toss_up",
        "decisions",
        ["dataset_id", "class_id", "match_percent"],
        unique=False,
        sqlite_where=sa.text("toss_up IS 1"),
        postgresql_where=sa.text("toss_up IS true"),
    )
    op.create_table(
        "flips",
        sa.Column("run_id", KEY, autoincrement=False, nullable=False),
        sa.Column("first_box_id", KEY, autoincrement=False, nullable=False),
        sa.Column("last_box_id", KEY, nullable=False),
        sa.Column("boxes", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["run_id"], ["runs.id"], name=op.f("fk_flips_run_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("run_id", "first_box_id", name=op.f("pk_flips")),
    )
    op.create_table(
        "reviews",
        sa.Column("id", KEY, nullable=False),
        sa.Column("box_id", KEY, nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("verdict", sa.String(length=8), nullable=False),
        sa.Column("comment", sa.Text(), nullable=False),
        sa.Column("reviewer", sa.String(length=100), nullable=False),
        sa.Column("carried_from", KEY, nullable=True),
        sa.Column("batch_id", KEY, nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "verdict in ('keep', 'reject', 'unsure', 'clear')",
            name=op.f("ck_reviews_verdict"),
        ),
        sa.ForeignKeyConstraint(
            ["batch_id"],
            ["review_batches.id"],
            name=op.f("fk_reviews_batch_id"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["box_id"], ["boxes.id"], name=op.f("fk_reviews_box_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_reviews")),
        sa.UniqueConstraint(
            "box_id", "revision", name=op.f("uq_reviews_box_id_revision")
        ),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_reviews_batch_id"), "reviews", ["batch_id"], unique=False)
    op.execute(
        "INSERT INTO id_blocks (name, next_id) VALUES ('frames', 1), ('boxes', 1)"
    )
    # For people who open the database in a shell.
    cases = " ".join(f"WHEN {code} THEN '{name}'" for code, name in REASONS.items())
    op.execute(
        "CREATE VIEW readable_decisions AS "
        "SELECT d.box_id, s.name AS dataset, f.key AS frame, b.source_id AS id, "
        "c.name AS class, "
        "CASE d.reason WHEN 14 THEN 'kept' WHEN 6 THEN 'unmeasured' "
        f"ELSE 'rejected' END AS verdict, CASE d.reason {cases} END AS reason, "
        "d.match_percent, d.crowding, d.toss_up, d.review "
        "FROM decisions d JOIN boxes b ON b.id = d.box_id "
        "JOIN frames f ON f.id = d.frame_id "
        "JOIN dataset_classes c ON c.id = d.class_id "
        "JOIN datasets s ON s.id = d.dataset_id"
    )


def downgrade() -> None:
    for table in ("datasets", "reviews", "tokens"):
        refuse_to_lose(table)
    op.execute("DROP VIEW readable_decisions")
    op.drop_index(op.f("ix_reviews_batch_id"), table_name="reviews")
    op.drop_table("reviews")
    op.drop_table("flips")
    op.drop_index(
        "ix_decisions_toss_up",
        table_name="decisions",
        sqlite_where=sa.text("toss_up IS 1"),
        postgresql_where=sa.text("toss_up IS true"),
    )
    op.drop_index(
        "ix_decisions_reviewed",
        table_name="decisions",
        sqlite_where=sa.text("review IS NOT NULL"),
        postgresql_where=sa.text("review IS NOT NULL"),
    )
    op.drop_index(
        "ix_decisions_large",
        table_name="decisions",
        sqlite_where=sa.text("large IS 1"),
        postgresql_where=sa.text("large IS true"),
    )
    op.drop_index(op.f("ix_decisions_frame_id"), table_name="decisions")
    op.drop_index("ix_decisions_by_crowding", table_name="decisions")
    op.drop_index("ix_decisions_by_reason", table_name="decisions")
    op.drop_index("ix_decisions_by_match", table_name="decisions")
    op.drop_index("ix_decisions_by_class", table_name="decisions")
    op.drop_table("decisions")
    op.drop_index(op.f("ix_runs_dataset_id_id"), table_name="runs")
    op.drop_table("runs")
    op.drop_index(op.f("ix_frame_files_sha256"), table_name="frame_files")
    op.drop_table("frame_files")
    op.drop_index(op.f("ix_evidence_measurement_id"), table_name="evidence")
    op.drop_index("ix_evidence_lossy", table_name="evidence")
    op.drop_table("evidence")
    op.drop_index(op.f("ix_boxes_frame_id"), table_name="boxes")
    op.drop_table("boxes")
    op.drop_table("tallies")
    op.drop_table("review_batches")
    op.drop_index(op.f("ix_problems_dataset_id_id"), table_name="problems")
    op.drop_table("problems")
    op.drop_table("measurements")
    op.drop_index(op.f("ix_login_sessions_token_id"), table_name="login_sessions")
    op.drop_table("login_sessions")
    op.drop_index(
        "uq_frames_current_key",
        table_name="frames",
        sqlite_where=sa.text("superseded_at IS NULL"),
        postgresql_where=sa.text("superseded_at IS NULL"),
    )
    op.drop_index(op.f("ix_frames_dataset_id_id"), table_name="frames")
    op.drop_table("frames")
    op.drop_index(op.f("ix_exports_dataset_id_id"), table_name="exports")
    op.drop_table("exports")
    op.drop_table("dataset_classes")
    op.drop_index(op.f("ix_config_versions_digest"), table_name="config_versions")
    op.drop_table("config_versions")
    op.drop_table("tokens")
    op.drop_table("idempotency_keys")
    op.drop_table("id_blocks")
    op.drop_table("datasets")
    op.drop_table("blobs")
