"""Boxes as they are asked for and answered: decisions, reviews, queue, history."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, TypeAlias, get_args

from pydantic import AwareDatetime, Field

from unghost.wire.model import (
    IfAbsent,
    Json,
    Page,
    RequestModel,
    ResponseModel,
    SparseModel,
    never_null,
)
from unghost.wire.words import (
    Answer,
    BoxSort,
    EvidenceName,
    FrameSort,
    HistoryKind,
    OcclusionLevel,
    QueueOrder,
    Reason,
    ReviewState,
    Verdict,
)

XYXY: TypeAlias = tuple[float, float, float, float]
"""Left, top, right, bottom, in pixels; of an edge, its two ends."""

Comment = Annotated[str, Field(max_length=2000, pattern=r"^[^\x00]*$")]
Percent = Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)]
Metres = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Id = Annotated[int, Field(ge=1, le=2**63 - 1)]
Revision = Annotated[int, Field(ge=0, le=2**31 - 1)]


class HiddenBy(ResponseModel):
    """A tag that covers part of a box and that the box's class does not accept."""

    tag: int
    name: str
    percent: float


class AcceptedTag(ResponseModel):
    """A tag whose pixels count for a box."""

    tag: int
    name: str
    rgb: tuple[int, int, int]


class ReviewMark(ResponseModel):
    """A person's answer on a box that is in force."""

    verdict: Answer
    reviewer: str
    revision: int
    comment: Annotated[str, IfAbsent("")]


class Decision(ResponseModel):
    """One box: the filter's verdict, why, the numbers, and what a person said.

    `verdict` is always the filter's, `effective_verdict` is what counts.
    """

    id: str = Field(description="The sender's own id.")
    box_id: int
    frame: str = Field(description="The frame's key.")
    frame_id: int
    class_name: str = Field(alias="class")
    verdict: Verdict
    reason: Reason
    explanation: Annotated[str, IfAbsent("")]
    evidence: EvidenceName | None
    match_percent: float | None
    threshold: float | None
    margin: float | None
    toss_up: Annotated[bool, IfAbsent(False)]
    large: Annotated[bool, IfAbsent(False)]
    matched_pixels: int | None
    box_pixels: int | None
    area_percent: float | None
    crowding: float | None
    explained_by: str | None
    hidden_by: Annotated[tuple[HiddenBy, ...], IfAbsent(())]
    accepted_tags: Annotated[tuple[AcceptedTag, ...], IfAbsent(())]
    lossy: Annotated[bool, IfAbsent(False)]
    distance: float | None
    xyxy: XYXY | None
    amodal_xyxy: XYXY | None
    visible_xyxy: XYXY | None
    tight_xyxy: XYXY | None
    visible_pixels: int | None
    occluded: Annotated[OcclusionLevel, IfAbsent(3)]
    truncated: float | None
    edges: tuple[XYXY, ...] | None
    config: str
    run: int
    revision: Annotated[int, IfAbsent(0)] = Field(
        description="How many answers the box has got, those that were taken back "
        "included: the `seen_revision` of the next one."
    )
    review: ReviewMark | None = Field(
        description="The answer in force; null if there is none, or none any more."
    )
    effective_verdict: Verdict


class Box(Decision):
    """A box with the boxes around it."""

    neighbours: Annotated[tuple[int, ...], IfAbsent(())] = Field(
        description="Boxes of the frame that overlap it."
    )


class Claim(ResponseModel):
    """Until when nobody else is given a box of the queue."""

    expires_at: AwareDatetime


class QueuedBox(Decision):
    """A box to look at."""

    claim: Claim


def _review_states(schema: dict[str, object]) -> None:
    schema["enum"] = ["", *get_args(ReviewState), None]


class BoxSelection(RequestModel):
    """Boxes of a list, by the same filters that the list takes."""

    verdict: Verdict | None = None
    effective: Verdict | None = None
    reason: Annotated[
        str | None, Field(description="Reasons, separated by commas.")
    ] = None
    class_name: str | None = Field(default=None, alias="class")
    review: Annotated[str | None, Field(json_schema_extra=_review_states)] = None
    toss_up: bool | None = None
    conflict: bool | None = Field(
        default=None,
        description="Whether a person's keep or reject contradicts the filter.",
    )
    match_min: Percent | None = None
    match_max: Percent | None = None
    margin_max: Percent | None = None
    distance_min: Metres | None = None
    distance_max: Metres | None = None


class BoxListQuery(BoxSelection):
    """The query of a list of boxes."""

    dataset: str = Field(description="Name of the dataset.")
    sort: BoxSort = "id"
    limit: int = Field(default=100, ge=1, le=1000, description="Most items of a page.")
    cursor: str | None = Field(default=None, max_length=2000)
    count: bool = Field(
        default=False, description="Whether to answer the `total` of the filter too."
    )


class FrameListQuery(BoxSelection):
    """The query of a list of frames: those that have such a box."""

    key: str = Field(default="", max_length=512, description="Prefix of keys.")
    sort: FrameSort = "key"
    limit: int = Field(default=100, ge=1, le=1000, description="Most items of a page.")
    cursor: str | None = Field(default=None, max_length=2000)


class BoxPage(Page[Decision], SparseModel):
    """One page of boxes; `total` and `snapshot` only with `count=true`."""

    total: int | None = Field(
        default=None,
        json_schema_extra=never_null,
        description="All boxes of the filter, exactly.",
    )
    snapshot: str | None = Field(
        default=None,
        json_schema_extra=never_null,
        description="Stands for these boxes as they are now: one answer on all of them "
        "names it.",
    )


@dataclass(frozen=True, kw_only=True)
class Selection:
    """All boxes of a filter as they were when the server counted them."""

    dataset: str
    filter: Json
    count: int
    snapshot: str


class QueueIn(RequestModel):
    """Which boxes are wanted next."""

    order: QueueOrder = "doubt"
    filters: BoxSelection = Field(
        default_factory=BoxSelection,
        description="Undecided boxes unless `review` or `conflict` is given; decided "
        "ones in an audit.",
    )
    limit: Annotated[int, Field(ge=1, le=50)] = 10
    exclude: list[Id] = Field(
        default_factory=list,
        max_length=1000,
        description="Boxes that are at hand already: not answered again; own claims "
        "on them are renewed.",
    )
    seed: Annotated[int, Field(ge=-(2**63), le=2**63 - 1)] | None = Field(
        default=None, description="Of the random order; one per dataset unless given."
    )


class Queue(ResponseModel):
    """Boxes to look at next, most urgent first, claimed for five minutes."""

    items: tuple[QueuedBox, ...]
    remaining: int = Field(
        description="Boxes of the filter that nobody has answered, claimed or not; of "
        "a filter on answers, all its boxes."
    )
    unsure: Annotated[int, IfAbsent(0)] = Field(
        description="Boxes that a person was unsure about; they come last."
    )
    claimed_by_others: Annotated[int, IfAbsent(0)]


class ReviewIn(RequestModel):
    """An answer on one box as it was seen."""

    verdict: Answer
    comment: Comment = ""
    seen_revision: Revision = Field(
        description="The box's `revision` that was seen: 0 if it was never answered."
    )


class Review(ResponseModel):
    """A person's answer, as it was stored."""

    box_id: int
    revision: int
    verdict: Answer
    reviewer: str
    comment: Annotated[str, IfAbsent("")]
    created_at: AwareDatetime
    effective_verdict: Verdict


class BulkIn(RequestModel):
    """One answer on many boxes: listed, or all of a filter, as they were seen."""

    dataset: Annotated[str, Field(max_length=100)]
    box_ids: Annotated[list[Id], Field(fail_fast=True)] | None = None
    seen_revisions: Annotated[list[Revision], Field(fail_fast=True)] | None = Field(
        default=None,
        description="The `revision` that was seen of each of `box_ids`, in their "
        "order; boxes that were answered since are left alone. Without it, boxes "
        "that have an answer are left alone.",
    )
    filter: BoxSelection | None = None
    snapshot: Annotated[str, Field(max_length=1000)] | None = Field(
        default=None,
        description="Of the list with this filter that was seen: `snapshot` of "
        "`GET /api/v1/boxes?count=true`. 412 if its boxes are not as they were then.",
    )
    expected_count: Annotated[int, Field(ge=0)] | None = Field(
        default=None, description="409 unless so many boxes are listed or selected."
    )
    verdict: Answer
    comment: Comment = ""


class ReviewBatch(ResponseModel):
    """One answer on many boxes: one act, one undo."""

    id: int
    dataset: str
    verdict: Answer
    count: int = Field(description="Boxes that were answered.")
    skipped: Annotated[tuple[int, ...], IfAbsent(())] = Field(
        description="Boxes that are gone, or of another dataset."
    )
    stale: Annotated[tuple[int, ...], IfAbsent(())] = Field(
        description="Boxes that were left alone because somebody answered them since."
    )


class UndoneBatch(ResponseModel):
    """What an undo put back; `skipped` are boxes that someone changed since."""

    id: int
    undone: int
    skipped: Annotated[tuple[int, ...], IfAbsent(())]


class HistoryEntry(SparseModel):
    """A decision or a review of a box's past; `kind` says which, and which keys it has.

    A decision has `run` and what follows from it, and `activated` if the run changed
    the verdict. A review has `revision`, `reviewer`, `comment`, the `batch` that it was
    given in, and `carried_from`, the box of an earlier revision that it was given on.
    """

    # In the order in which either kind of entry has its keys.
    kind: HistoryKind
    at: AwareDatetime
    run: int | None = None
    config: str | None = None
    revision: int | None = None
    reviewer: str | None = None
    verdict: Verdict | Answer | None = Field(
        description="The filter's or the person's; null where a run's numbers are gone."
    )
    reason: Reason | None = None
    match_percent: float | None = None
    threshold: float | None = None
    activated: bool | None = None
    comment: str | None = None
    batch: int | None = None
    carried_from: int | None = None


class History(ResponseModel):
    """What happened to a box, newest first."""

    items: tuple[HistoryEntry, ...]
