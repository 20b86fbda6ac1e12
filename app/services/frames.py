"""Frames as they are answered: in lists, alone, and by their files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy.orm import Session

from app.access.audit import Act, AuditTrail
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
from app.repositories.latest_answers import LatestAnswers
from app.repositories.tallies import TallyKey
from app.security import Principal
from app.services.decisions import DecisionReader, StoredDecision
from app.services.frame_answer import stored_files
from app.services.frame_replacement import retire
from app.services.others_answers import require_own
from app.services.statistics import count, summary
from unghost.wire.frames import FrameDetails

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
) -> list[dict[str, object]]:
    """Rows of a list of frames, each a `wire.FrameSummary` as a dict."""
    facts = _Facts(session, dataset, [frame.id for frame in frames])
    return [facts.summary(frame) for frame in frames]


class _Facts:
    """What answers on frames are made of beside their rows: read once for them all."""

    def __init__(self, session: Session, dataset: Dataset, ids: Sequence[int]) -> None:
        self.dataset = dataset
        self.files = FrameRepository(session).files(ids)
        self._tallies = DecisionRepository(session).per_frame(ids)
        measurement = dataset.active_measurement_id or 0
        self.reports = EvidenceRepository(session).reports(ids, measurement)

    def summary(self, frame: Frame) -> dict[str, object]:
        """What a list says of one frame."""
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
            "created_at": frame.created_at,
            "counts": summary(count(_keyed(self._tallies[frame.id]))),
        }

    def details(self, frame: Frame) -> FrameDetails:
        """What there is to say of one frame beside its boxes."""
        annotation = frame.annotation
        return FrameDetails(
            **self.summary(frame),
            dataset=self.dataset.name,
            camera=annotation.get("camera"),
            carla_version=frame.carla_version,
            captured_text=frame.captured_at,
            weather=annotation.get("weather"),
            superseded=frame.superseded_at is not None,
            segmentation=self.reports.get(frame.id),
            files=stored_files(frame.id, self.files[frame.id]),
        )


def describe_frame(session: Session, frame_id: int) -> dict[str, Any]:
    """A `wire.Frame`; its decisions are dicts, since there may be thousands of them."""
    frame, details, decisions = _described(session, frame_id)
    previous_id, next_id = FrameRepository(session).neighbours(frame)
    return details.model_dump() | {
        "previous_id": previous_id,
        "next_id": next_id,
        "boxes": decisions,
    }


def describe_stored(session: Session, frame_id: int) -> dict[str, Any]:
    """A `wire.StoredFrame`, the answer to an upload; its decisions are dicts."""
    _, details, decisions = _described(session, frame_id)
    return {
        "frame": details,
        "segmentation": details.segmentation,
        "decisions": decisions,
    }


def decisions_of(session: Session, frame_id: int) -> list[StoredDecision]:
    """Decisions on the boxes of a frame."""
    frame = FrameRepository(session).with_id(frame_id, annotation=True)
    dataset = DatasetRepository(session).with_id(frame.dataset_id)
    return DecisionReader(session, dataset).of_frame(frame)


def _described(
    session: Session, frame_id: int
) -> tuple[Frame, FrameDetails, list[StoredDecision]]:
    frame = FrameRepository(session).with_id(frame_id, annotation=True)
    dataset = DatasetRepository(session).with_id(frame.dataset_id)
    details = _Facts(session, dataset, [frame.id]).details(frame)
    return frame, details, DecisionReader(session, dataset).of_frame(frame)


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
    answers = LatestAnswers(session).reviewers_of(dataset.id, key)
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
