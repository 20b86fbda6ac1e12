"""SQL of measurements and of the evidence of frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from sqlalchemy import ColumnElement, Select, bindparam, exists, func, select
from sqlalchemy.exc import IntegrityError

from app.catalog.frames import current_in
from app.db.base import Repository, existing
from app.db.bulk import chunks, insert_rows
from app.db.tables import Frame, FrameEvidence, Measurement
from filter_core.pipeline import SegmentationReport


class EvidenceRow(NamedTuple):
    """The packed numbers of one frame; see `app.measuring.evidence`."""

    frame_id: int
    first_box_id: int
    box_count: int
    numbers: bytes
    tag_counts: bytes
    geometry: bytes
    segmentation: SegmentationReport | None
    channels: bytes | None
    key: str

    @property
    def palette(self) -> str | None:
        """The tag family of the segmentation; None if none was measured."""
        return None if self.segmentation is None else self.segmentation["palette"]

    @property
    def lossy(self) -> bool:
        """Whether the segmentation had lost colours."""
        return self.segmentation is not None and self.segmentation["lossy"]


class NumbersRow(NamedTuple):
    """The columns of a frame's evidence that decisions need."""

    frame_id: int
    first_box_id: int
    box_count: int
    numbers: bytes
    channels: bytes | None


def _numbers(measurement_id: int) -> Select[int, int, int, bytes, bytes | None]:
    packed = (FrameEvidence.numbers, FrameEvidence.channels)
    return (
        select(Frame.id, Frame.first_box_id, Frame.box_count, *packed)
        .join(FrameEvidence, FrameEvidence.frame_id == Frame.id)
        .where(FrameEvidence.measurement_id == measurement_id)
    )


_OF_FRAMES: Final = (
    select(FrameEvidence.frame_id, Frame.first_box_id, Frame.box_count)
    .add_columns(FrameEvidence.numbers, FrameEvidence.tag_counts)
    .add_columns(FrameEvidence.geometry, FrameEvidence.segmentation)
    .add_columns(FrameEvidence.channels, Frame.key)
    .join(Frame, Frame.id == FrameEvidence.frame_id)
    .where(FrameEvidence.measurement_id == bindparam("measurement"))
    .where(FrameEvidence.frame_id.in_(bindparam("frames", expanding=True)))
)


class EvidenceRepository(Repository):
    """Rows of `evidence` and `measurements`."""

    def measurement(self, dataset_id: int, digest: str) -> Measurement | None:
        """The measurement of a dataset with these options."""
        rows = select(Measurement).where(Measurement.dataset_id == dataset_id)
        return self._session.scalar(rows.where(Measurement.digest == digest))

    def measurement_with_id(self, measurement_id: int) -> Measurement:
        """The measurement with an id from another row."""
        measurement = self._session.get(Measurement, measurement_id)
        return existing(measurement, "measurement", measurement_id)

    def add_measurement(self, measurement: Measurement) -> Measurement:
        """Insert; returns the existing one if another transaction has inserted it."""
        self._session.add(measurement)
        try:
            with self._session.begin_nested():
                self._session.flush()
        except IntegrityError:
            stored = self.measurement(measurement.dataset_id, measurement.digest)
            if stored is None:
                raise
            return stored
        return measurement

    def add(self, rows: Sequence[Mapping[str, object]]) -> None:
        """Insert evidence of frames."""
        insert_rows(self._session, FrameEvidence, rows)

    def of_frames(
        self, frame_ids: Iterable[int], measurement_id: int
    ) -> dict[int, EvidenceRow]:
        evidence: dict[int, EvidenceRow] = {}
        connection = self._session.connection()
        for chunk in chunks(dict.fromkeys(frame_ids)):
            frames = {"measurement": measurement_id, "frames": chunk}
            for row in connection.execute(_OF_FRAMES, frames):
                evidence[row[0]] = EvidenceRow(*row)
        return evidence

    def reports(
        self, frame_ids: Iterable[int], measurement_id: int
    ) -> dict[int, SegmentationReport | None]:
        """How the segmentations of frames were read, by frame."""
        rows = select(FrameEvidence.frame_id, FrameEvidence.segmentation).where(
            FrameEvidence.frame_id.in_(list(frame_ids)),
            FrameEvidence.measurement_id == measurement_id,
        )
        return {row[0]: row[1] for row in self._session.execute(rows)}

    def lossy_boxes(self, measurement_id: int) -> int:
        """How many current boxes have a lossy segmentation."""
        is_lossy = FrameEvidence.lossy.is_(True), Frame.superseded_at.is_(None)
        rows = (
            select(func.coalesce(func.sum(Frame.box_count), 0))
            .join(FrameEvidence, FrameEvidence.frame_id == Frame.id)
            .where(FrameEvidence.measurement_id == measurement_id, *is_lossy)
        )
        return int(self._session.scalar(rows) or 0)

    def numbers(
        self,
        dataset_id: int,
        measurement_id: int,
        *,
        frames: tuple[int, int] | None = None,
    ) -> list[NumbersRow]:
        """The numbers of current frames, in order of id.

        `frames` are the first and the last id of a range; None selects all frames.
        """
        rows = _numbers(measurement_id).where(*current_in(dataset_id))
        rows = rows.order_by(Frame.id)
        if frames is not None:
            rows = rows.where(Frame.id.between(*frames))
        return [NumbersRow(*row) for row in self._session.execute(rows)]

    def numbers_of_frames(
        self, frame_ids: Iterable[int], measurement_id: int
    ) -> list[NumbersRow]:
        numbers: list[NumbersRow] = []
        for chunk in chunks(dict.fromkeys(frame_ids)):
            rows = _numbers(measurement_id).where(Frame.id.in_(chunk))
            numbers += [NumbersRow(*row) for row in self._session.execute(rows)]
        return numbers

    def unmeasured_frames(
        self,
        dataset_id: int,
        measurement_id: int,
        *,
        after: int = 0,
        until: int | None = None,
        limit: int | None = None,
    ) -> list[int]:
        """Current frames that this measurement does not cover yet, in order of id."""
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
        """Which of the frames exist and have no evidence in this measurement yet.

        Only one transaction writes at a time: the result stays valid until the commit.
        """
        lacking: set[int] = set()
        for chunk in chunks(frame_ids):
            rows = select(Frame.id).where(Frame.id.in_(chunk))
            lacking.update(self._session.scalars(rows.where(~_covered(measurement_id))))
        return lacking

    def count_unmeasured(self, dataset_id: int, measurement_id: int) -> int:
        """How many frames `unmeasured_frames` would find."""
        rows = select(func.count()).select_from(Frame)
        unmeasured = rows.where(*_unmeasured(dataset_id, measurement_id))
        return self._session.scalar(unmeasured) or 0


def _unmeasured(dataset_id: int, measurement_id: int) -> list[ColumnElement[bool]]:
    return [*current_in(dataset_id), ~_covered(measurement_id)]


def _covered(measurement_id: int) -> ColumnElement[bool]:
    return exists().where(
        FrameEvidence.frame_id == Frame.id,
        FrameEvidence.measurement_id == measurement_id,
    )
