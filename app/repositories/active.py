"""What is active in a dataset, read in one statement: every upload asks for it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, Final, NamedTuple

from sqlalchemy import Engine, and_, bindparam, exists, select
from sqlalchemy.orm import Session

from app.db.bulk import first_row, run
from app.db.tables import ConfigVersion, Dataset, Frame, Measurement, Problem
from app.errors import NotFound


class ActiveRow(NamedTuple):
    """The active configuration, run and measurement of a dataset."""

    dataset_id: int
    config_id: int
    run_id: int
    measurement_id: int
    config_digest: str
    measurement_digest: str
    classes_are_frozen: bool


class KeyRow(NamedTuple):
    """What is known under a frame's key: `frame_id` is None if there is no frame."""

    frame_id: int | None
    content_digest: str | None
    has_problem: bool


# Built once: putting a statement together costs more than running it.
_ACTIVE: Final = (
    select(
        Dataset.id,
        Dataset.active_config_id,
        Dataset.active_run_id,
        Dataset.active_measurement_id,
        ConfigVersion.digest,
        Measurement.digest,
        Dataset.classes_frozen_at.is_not(None),
    )
    .join(ConfigVersion, ConfigVersion.id == Dataset.active_config_id)
    .join(Measurement, Measurement.id == Dataset.active_measurement_id)
    .where(Dataset.name == bindparam("name"), Dataset.removed_at.is_(None))
)
_ACTIVE_AND_KEY: Final = _ACTIVE.add_columns(
    Frame.id,
    Frame.content_digest,
    exists().where(Problem.dataset_id == Dataset.id, Problem.key == bindparam("key")),
).outerjoin(
    Frame,
    and_(
        Frame.dataset_id == Dataset.id,
        Frame.key == bindparam("key"),
        Frame.superseded_at.is_(None),
    ),
)
_WIDTH: Final = len(ActiveRow._fields)


def key_rows(
    session: Session, dataset_id: int, keys: Collection[str]
) -> dict[str, KeyRow]:
    """What a dataset has under each of these keys."""
    frames = select(Frame.key, Frame.id, Frame.content_digest).where(
        Frame.dataset_id == dataset_id,
        Frame.key.in_(keys),
        Frame.superseded_at.is_(None),
    )
    refused = select(Problem.key).where(
        Problem.dataset_id == dataset_id, Problem.key.in_(keys)
    )
    found = {row.key: (row.id, row.content_digest) for row in session.execute(frames)}
    problems = set(session.scalars(refused))
    absent = (None, None)
    return {key: KeyRow(*found.get(key, absent), key in problems) for key in keys}


def active_row(session: Session, name: str) -> ActiveRow:
    """By the dataset's name; NotFound."""
    found = run(session, _ACTIVE, name=name).first()
    if found is None:
        raise NotFound("dataset", name)
    return ActiveRow._make(found)


def active_row_and_key(
    session: Session, name: str, key: str
) -> tuple[ActiveRow, KeyRow]:
    """By the dataset's name, and what it has under a frame's key; NotFound."""
    found = run(session, _ACTIVE_AND_KEY, name=name, key=key).first()
    return _active_and_key(found, name)


def glance(engine: Engine, name: str, key: str) -> tuple[ActiveRow, KeyRow]:
    """The same as it is now, for those who will look again."""
    return _active_and_key(first_row(engine, _ACTIVE_AND_KEY, name=name, key=key), name)


def _active_and_key(found: Sequence[Any] | None, name: str) -> tuple[ActiveRow, KeyRow]:
    if found is None:
        raise NotFound("dataset", name)
    return ActiveRow._make(found[:_WIDTH]), KeyRow._make(found[_WIDTH:])
