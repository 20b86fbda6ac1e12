"""Evidence of frames, one row per frame and measurement."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from sqlalchemy import ColumnElement, func, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.db.bulk import chunks, insert_rows
from app.db.tables import Frame, FrameEvidence, Measurement
from app.errors import NotFound


class EvidenceRow(NamedTuple):
    """The packed numbers of one frame; see `app.db.evidence_record`."""

    frame_id: int
    first_box_id: int
    box_count: int
    numbers: bytes
    tag_counts: bytes
    geometry: bytes
    segmentation: Mapping[str, Any] | None
    channels: bytes | None


class NumbersRow(NamedTuple):
    """What a decision needs of one frame."""

    frame_id: int
    first_box_id: int
    box_count: int
    numbers: bytes
    channels: bytes | None


class EvidenceRepository:
    """Rows of `evidence` and `measurements`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def measurement(self, dataset_id: int, digest: str) -> Measurement | None:
        """The measurement of a dataset with these options."""
        return self._session.scalar(
            select(Measurement).where(
                Measurement.dataset_id == dataset_id, Measurement.digest == digest
            )
        )

    def measurement_with_id(self, measurement_id: int) -> Measurement:
        """A measurement that another row refers to."""
        found = self._session.get(Measurement, measurement_id)
        if found is None:
            raise NotFound("measurement", measurement_id)
        return found

    def add_measurement(self, measurement: Measurement) -> Measurement:
        """Insert, or the one that someone else has just inserted."""
        self._session.add(measurement)
        try:
            with self._session.begin_nested():
                self._session.flush()
        except IntegrityError:
            found = self.measurement(measurement.dataset_id, measurement.digest)
            if found is None:
                raise
            return found
        return measurement

    def add(self, rows: list[dict[str, Any]]) -> None:
        """Insert evidence of frames."""
        insert_rows(self._session, FrameEvidence, rows)

    def of_frames(
        self, frame_ids: Iterable[int], measurement_id: int
    ) -> dict[int, EvidenceRow]:
        """Evidence by frame."""
        found: dict[int, EvidenceRow] = {}
        for chunk in chunks(dict.fromkeys(frame_ids)):
            found |= self._of_frames(chunk, measurement_id)
        return found

    def _of_frames(
        self, frame_ids: list[int], measurement_id: int
    ) -> dict[int, EvidenceRow]:
        rows = (
            select(
                FrameEvidence.frame_id,
                Frame.first_box_id,
                Frame.box_count,
                FrameEvidence.numbers,
                FrameEvidence.tag_counts,
                FrameEvidence.geometry,
                FrameEvidence.segmentation,
                FrameEvidence.channels,
            )
            .join(Frame, Frame.id == FrameEvidence.frame_id)
            .where(
                FrameEvidence.frame_id.in_(frame_ids),
                FrameEvidence.measurement_id == measurement_id,
            )
        )
        return {row[0]: EvidenceRow(*row) for row in self._session.execute(rows)}

    def reports(
        self, frame_ids: Iterable[int], measurement_id: int
    ) -> dict[int, Mapping[str, Any] | None]:
        """What was recognised in the segmentations of frames."""
        rows = select(FrameEvidence.frame_id, FrameEvidence.segmentation).where(
            FrameEvidence.frame_id.in_(list(frame_ids)),
            FrameEvidence.measurement_id == measurement_id,
        )
        return {row[0]: row[1] for row in self._session.execute(rows)}

    def lossy_boxes(self, measurement_id: int) -> int:
        """How many current boxes rest on a lossy segmentation."""
        rows = (
            select(func.coalesce(func.sum(Frame.box_count), 0))
            .join(FrameEvidence, FrameEvidence.frame_id == Frame.id)
            .where(
                FrameEvidence.measurement_id == measurement_id,
                FrameEvidence.lossy.is_(True),
                Frame.superseded_at.is_(None),
            )
        )
        return int(self._session.scalar(rows) or 0)

    def numbers(
        self,
        dataset_id: int,
        measurement_id: int,
        *,
        frames: tuple[int, int] | None = None,
    ) -> list[NumbersRow]:
        """The numbers of all current frames, in the order of their ids.

        `frames` are the first and the last id, if others are left out.
        """
        rows = (
            select(
                Frame.id,
                Frame.first_box_id,
                Frame.box_count,
                FrameEvidence.numbers,
                FrameEvidence.channels,
            )
            .join(FrameEvidence, FrameEvidence.frame_id == Frame.id)
            .where(
                Frame.dataset_id == dataset_id,
                Frame.superseded_at.is_(None),
                FrameEvidence.measurement_id == measurement_id,
            )
            .order_by(Frame.id)
        )
        if frames is not None:
            rows = rows.where(Frame.id.between(*frames))
        return [NumbersRow(*row) for row in self._session.execute(rows)]

    def unmeasured_frames(
        self,
        dataset_id: int,
        measurement_id: int,
        *,
        after: int = 0,
        until: int | None = None,
        limit: int | None = None,
    ) -> list[int]:
        """Current frames that this measurement does not cover yet, by their ids."""
        rows = (
            select(Frame.id)
            .where(*_unmeasured(dataset_id, measurement_id), Frame.id > after)
            .order_by(Frame.id)
            .limit(limit)
        )
        if until is not None:
            rows = rows.where(Frame.id <= until)
        return list(self._session.scalars(rows))

    def lacking(self, frame_ids: Iterable[int], measurement_id: int) -> set[int]:
        """Those of these frames that are there and that it does not cover yet.

        Only one transaction writes at a time: what is found holds until the commit.
        """
        found: set[int] = set()
        for chunk in chunks(frame_ids):
            rows = select(Frame.id).where(
                Frame.id.in_(chunk), ~_covered(measurement_id)
            )
            found.update(self._session.scalars(rows))
        return found

    def count_unmeasured(self, dataset_id: int, measurement_id: int) -> int:
        """How many frames `unmeasured_frames` would find."""
        rows = (
            select(func.count())
            .select_from(Frame)
            .where(*_unmeasured(dataset_id, measurement_id))
        )
        return self._session.scalar(rows) or 0


def _unmeasured(dataset_id: int, measurement_id: int) -> list[ColumnElement[bool]]:
    covered = _covered(measurement_id)
    return [Frame.dataset_id == dataset_id, Frame.superseded_at.is_(None), ~covered]


def _covered(measurement_id: int) -> ColumnElement[bool]:
    return (
        select(FrameEvidence.frame_id)
        .where(
            FrameEvidence.frame_id == Frame.id,
            FrameEvidence.measurement_id == measurement_id,
        )
        .exists()
    )
