"""Frames as they are answered: in lists, alone, and by their files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy.orm import Session

from app.db.tables import Dataset, Frame
from app.errors import BadRequest, NoSuchFile, NotFound
from app.repositories.datasets import DatasetRepository
from app.repositories.decisions import DecisionRepository
from app.repositories.evidence import EvidenceRepository
from app.repositories.frames import (
    FileRow,
    FrameFilter,
    FramePage,
    FrameRepository,
)
from app.repositories.reviews import ReviewRepository
from app.repositories.tallies import TallyKey
from app.security import Principal
from app.services.audit import Act, AuditTrail
from app.services.decisions import DecisionReader
from app.services.frame_answer import describe_files
from app.services.frame_replacement import retire
from app.services.others_answers import require_own
from app.services.statistics import count, summary
from app.services.timestamps import rfc3339

_MAX_ID: Final = 2**63 - 1
_ID_DIGITS: Final = 19


@dataclass(frozen=True)
class PageRequest:
    """Which page of a list, and in which order: ``key`` or ``id``, ``-`` backwards."""

    sort: str
    cursor: str | None
    limit: int


def page_of_frames(
    session: Session, wanted: FrameFilter, page: PageRequest
) -> tuple[list[Frame], str | None]:
    """Frames of one page, and the cursor of the next."""
    by_key = page.sort.endswith("key")
    after: str | int | None = page.cursor
    if page.cursor is not None and not by_key:
        if not page.cursor.isascii() or not page.cursor.isdecimal():
            raise BadRequest(f"cursor {page.cursor[:80]!r} is not one of ours")
        after = min(int(page.cursor[:_ID_DIGITS]), _MAX_ID)
    chosen = FramePage(by_key, page.sort.startswith("-"), after, page.limit)
    rows = FrameRepository(session).page(wanted, chosen)
    if len(rows) <= page.limit:
        return rows, None
    last = rows[page.limit - 1]
    return rows[: page.limit], last.key if by_key else str(last.id)


def frame_summaries(
    session: Session, dataset: Dataset, frames: Sequence[Frame]
) -> list[dict[str, Any]]:
    """Rows of a list of frames."""
    facts = _Facts(session, dataset, [frame.id for frame in frames])
    return [facts.summary(frame) for frame in frames]


class _Facts:
    """What rows of frames are made of beside the frames: read once for all of them."""

    def __init__(self, session: Session, dataset: Dataset, ids: Sequence[int]) -> None:
        self.files = FrameRepository(session).files(ids)
        self._tallies = DecisionRepository(session).per_frame(ids)
        measurement = dataset.active_measurement_id or 0
        self.reports = EvidenceRepository(session).reports(ids, measurement)

    def summary(self, frame: Frame) -> dict[str, Any]:
        """The row of one frame."""
        files, report = self.files[frame.id], self.reports.get(frame.id)
        return {
            "id": frame.id,
            "key": frame.key,
            "revision": frame.revision,
            "width": frame.width,
            "height": frame.height,
            "map": frame.map,
            "has_image": "image" in files,
            "has_segmentation": "segmentation" in files,
            "lossy": bool((report or {}).get("lossy")),
            "created_at": rfc3339(frame.created_at),
            "counts": summary(count(_keyed(self._tallies[frame.id]))),
        }


def describe_frame(session: Session, frame_id: int) -> dict[str, Any]:
    """A frame with everything the review page shows of it."""
    frames = FrameRepository(session)
    frame = frames.with_id(frame_id, annotation=True)
    dataset = DatasetRepository(session).with_id(frame.dataset_id)
    facts = _Facts(session, dataset, [frame.id])
    previous_id, next_id = frames.neighbours(frame)
    annotation = frame.annotation
    return facts.summary(frame) | {
        "dataset": dataset.name,
        "camera": annotation.get("camera"),
        "carla_version": frame.carla_version,
        "captured_at": frame.captured_at,
        "weather": annotation.get("weather"),
        "superseded": frame.superseded_at is not None,
        "segmentation": facts.reports.get(frame.id),
        "files": describe_files(frame.id, facts.files[frame.id]),
        "previous_id": previous_id,
        "next_id": next_id,
        "boxes": DecisionReader(session, dataset).of_frame(frame),
    }


def describe_stored(session: Session, frame_id: int) -> dict[str, Any]:
    """A frame as the answer to its upload."""
    frame = describe_frame(session, frame_id)
    for name in ("previous_id", "next_id"):
        del frame[name]
    decisions = frame.pop("boxes")
    return {
        "frame": frame,
        "segmentation": frame["segmentation"],
        "decisions": decisions,
    }


def frame_id_of(session: Session, dataset: str, key: str) -> int:
    """The id of the newest revision under a key; NotFound."""
    found = DatasetRepository(session).named(dataset)
    current = FrameRepository(session).current(found.id, key)
    if current is None:
        raise NotFound("frame", key)
    return current.id


def frame_file(session: Session, frame_id: int, kind: str) -> FileRow:
    """A file of a frame; NotFound if it has none of this kind."""
    FrameRepository(session).with_id(frame_id)
    found = FrameRepository(session).files([frame_id])[frame_id].get(kind)
    if found is None:
        raise NoSuchFile(kind, frame_id)
    return found


def remove_frame(audit: AuditTrail, by: Principal, dataset: Dataset, key: str) -> None:
    """Delete a frame with all its revisions, and the answers on them.

    Raises
    ------
    NotFound
        There is no such frame.
    Forbidden
        Other people's answers are among them, and this is no admin.
    """
    session = audit.session
    frames = FrameRepository(session)
    current = frames.current(dataset.id, key)
    if current is None:
        raise NotFound("frame", key)
    answers = ReviewRepository(session).reviewers_of(dataset.id, key)
    of_others = require_own(by, answers, f"deleting frame {key!r}")
    retire(session, current)
    frames.remove(dataset.id, key)
    audit.note(
        Act.FRAME_DELETED,
        key,
        dataset=dataset.name,
        answers=sum(answers.values()),
        of_others=of_others,
    )


def _keyed(rows: Sequence[Any]) -> dict[TallyKey, int]:
    return {
        TallyKey(row.class_id, row.reason, row.toss_up, row.review): row.boxes
        for row in rows
    }
