"""What the server says about frames, boxes and their decisions, as frozen values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Literal, TypeAlias

from unghost.reading import Result

Verdict: TypeAlias = Literal["kept", "rejected", "unmeasured"]
Answer: TypeAlias = Literal["keep", "reject", "unsure", "clear"]
XYXY: TypeAlias = tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Counts(Result):
    """How many of what there are; what does not apply is 0."""

    frames: int = 0
    boxes: int = 0
    kept: int = 0
    rejected: int = 0
    unmeasured: int = 0
    reviewed: int = 0
    to_review: int = 0
    problems: int = 0


@dataclass(frozen=True, kw_only=True)
class Dataset(Result):
    """A named set of frames with one list of classes and one active run."""

    name: str
    description: str | None = None
    classes: tuple[str, ...] = ()
    classes_frozen: bool = False
    palette: str = "auto"
    encoding: str = "auto"
    channel_order: str = "auto"
    lossy_segmentation: str = "refuse"
    has_ignore_mask: bool = False
    created_at: datetime | None = None
    config: str | None = None
    active_run: int | None = None
    thumbnail_frame_id: int | None = None
    counts: Counts = field(default_factory=Counts)


@dataclass(frozen=True, kw_only=True)
class HiddenBy(Result):
    """A tag that covers part of a box and that the box's class does not accept."""

    tag: int
    name: str
    percent: float


@dataclass(frozen=True, kw_only=True)
class ReviewMark(Result):
    """A person's latest answer on a box."""

    verdict: Answer
    revision: int
    reviewer: str | None = None
    comment: str | None = None


@dataclass(frozen=True, kw_only=True)
class Claim(Result):
    """Until when nobody else is given a box of the queue."""

    expires_at: datetime


@dataclass(frozen=True, kw_only=True)
class Decision(Result):
    """One box: the filter's verdict, why, the numbers, and what a person said.

    `verdict` is always the filter's, `effective_verdict` is what counts. `revision`
    counts the answers that the box has got; an answer names the one that was seen.
    What only a server knows (`box_id`, `run`, `review`) is None in decisions made
    locally.
    """

    id: str
    verdict: Verdict
    reason: str
    class_name: str | None = field(default=None, metadata={"key": "class"})
    box_id: int | None = None
    frame: str | None = None
    frame_id: int | None = None
    evidence: str | None = None
    explanation: str | None = None
    match_percent: float | None = None
    threshold: float | None = None
    margin: float | None = None
    toss_up: bool = False
    large: bool = False
    lossy: bool = False
    matched_pixels: int | None = None
    box_pixels: int | None = None
    area_percent: float | None = None
    crowding: float | None = None
    distance: float | None = None
    explained_by: str | None = None
    hidden_by: tuple[HiddenBy, ...] = ()
    xyxy: XYXY | None = None
    amodal_xyxy: XYXY | None = None
    visible_xyxy: XYXY | None = None
    tight_xyxy: XYXY | None = None
    visible_pixels: int | None = None
    occluded: int = 3
    truncated: float | None = None
    edges: tuple[XYXY, ...] | None = None
    config: str | None = None
    run: int | None = None
    revision: int = 0
    review: ReviewMark | None = None
    effective_verdict: Verdict | None = None
    neighbours: tuple[int, ...] = ()
    claim: Claim | None = None


@dataclass(frozen=True, kw_only=True)
class SegmentationReport(Result):
    """What was recognised in a frame's segmentation."""

    palette: str | None = None
    encoding: str | None = None
    channel_order: str | None = None
    lossy: bool = False
    unknown_percent: float = 0.0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class StoredFile(Result):
    """One file of a frame, as the server keeps it."""

    url: str
    sha256: str
    media_type: str | None = None
    size_bytes: int | None = None


@dataclass(frozen=True, kw_only=True)
class Frame(Result):
    """One image with its boxes; a listing leaves out everything after `counts`."""

    id: int
    key: str
    revision: int = 1
    width: int | None = None
    height: int | None = None
    has_image: bool = False
    has_segmentation: bool = False
    lossy: bool = False
    map: str | None = None
    created_at: datetime | None = None
    counts: Counts = field(default_factory=Counts)
    dataset: str | None = None
    camera: Mapping[str, Any] | None = None
    carla_version: str | None = None
    captured_at: datetime | None = None
    weather: Mapping[str, Any] | None = None
    segmentation: SegmentationReport | None = None
    files: Mapping[str, StoredFile] = field(default_factory=dict)
    previous_id: int | None = None
    next_id: int | None = None
    boxes: tuple[Decision, ...] = ()


@dataclass(frozen=True, kw_only=True)
class StoredFrame(Result):
    """The answer to an upload; `created` is False if the same was there already."""

    frame: Frame
    decisions: tuple[Decision, ...] = ()
    segmentation: SegmentationReport | None = None
    created: bool = True


@dataclass(frozen=True, kw_only=True)
class HistoryEntry(Result):
    """A decision or a review of a box's past; `kind` says which.

    `verdict` is the filter's or the person's; None of a run whose numbers are gone.
    """

    kind: Literal["decision", "review"]
    at: datetime
    verdict: Verdict | Answer | None = None
    run: int | None = None
    config: str | None = None
    reason: str | None = None
    match_percent: float | None = None
    threshold: float | None = None
    revision: int | None = None
    reviewer: str | None = None
    comment: str | None = None
    batch: int | None = None


@dataclass(frozen=True, kw_only=True)
class Review(Result):
    """A person's answer, as it was stored."""

    box_id: int
    revision: int
    verdict: Answer
    reviewer: str | None = None
    comment: str | None = None
    created_at: datetime | None = None
    effective_verdict: Verdict | None = None


@dataclass(frozen=True, kw_only=True)
class ReviewBatch(Result):
    """One answer on many boxes.

    It was not given for those that are gone (`skipped`), nor for those that somebody
    had answered (`stale`).
    """

    id: int
    count: int
    dataset: str | None = None
    verdict: Answer | None = None
    skipped: tuple[int, ...] = ()
    stale: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Selection:
    """All boxes of a filter as they were when the server counted them."""

    dataset: str
    filter: Mapping[str, Any]
    count: int
    snapshot: str


@dataclass(frozen=True, kw_only=True)
class UndoneBatch(Result):
    """What an undo restored; `skipped` are boxes that someone changed since."""

    id: int
    undone: int
    skipped: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True)
class RefusedFrame(Result):
    """A frame that was sent and refused, with the problem it was refused for."""

    id: int
    key: str
    error: Mapping[str, Any]
    created_at: datetime | None = None
