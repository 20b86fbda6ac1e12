"""Requests and responses about boxes: decisions, reviews, the queue, the history."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final, TypeAlias, get_args

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

MAX_COMMENT: Final = 2000
"""Characters of a comment."""
Comment = Annotated[str, Field(max_length=MAX_COMMENT, pattern=r"^[^\x00]*$")]
Percent = Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)]
Metres = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Id = Annotated[int, Field(ge=1, le=2**63 - 1)]
Limit = Annotated[
    int, Field(ge=1, le=1000, description="Maximum number of items on a page.")
]
Cursor = Annotated[str | None, Field(max_length=2000)]
Revision = Annotated[int, Field(ge=0, le=2**31 - 1)]


class HiddenBy(ResponseModel):
    """A tag that covers part of a box and that the box's class does not accept."""

    tag: int
    name: str
    rgb: Annotated[tuple[int, int, int], IfAbsent((255, 255, 255))]
    percent: float


class AcceptedTag(ResponseModel):
    """A tag whose pixels count for a box."""

    tag: int
    name: str
    rgb: tuple[int, int, int]


class ReviewMark(ResponseModel):
    """The current answer of a person on a box."""

    verdict: Answer
    reviewer: str
    revision: int
    comment: Annotated[str, IfAbsent("")]


class Decision(ResponseModel):
    """One box: the filter's verdict, its reason and numbers, and a person's answer.

    `verdict` is the filter's. `effective_verdict` is a person's keep or reject if there
    is one, else the filter's verdict.
    """

    id: str = Field(description="The id that the sender gave the box.")
    box_id: int
    frame: str = Field(description="Key of the frame.")
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
    unknown_pixels: Annotated[int | None, IfAbsent(None)]
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
        description="How many answers the box has been given, including undone ones. "
        "Send it as `seen_revision` with the next answer."
    )
    review: ReviewMark | None = Field(
        description="The current answer; null if there is none or it was undone."
    )
    effective_verdict: Verdict


class Box(Decision):
    """A box, and which boxes overlap it."""

    neighbours: Annotated[tuple[int, ...], IfAbsent(())] = Field(
        description="Ids of the boxes of the frame that overlap this one."
    )


class Claim(ResponseModel):
    """The time until which a box of the queue is reserved for the caller."""

    expires_at: AwareDatetime


class QueuedBox(Decision):
    """A box of the queue, reserved (claimed) for the caller."""

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
    match_min: Percent | None = Field(
        default=None,
        description="Only boxes with a match: not those outside the image.",
    )
    match_max: Percent | None = None
    margin_max: Percent | None = None
    distance_min: Metres | None = None
    distance_max: Metres | None = None


class BoxListQuery(BoxSelection):
    """The query of a list of boxes."""

    dataset: str = Field(description="Name of the dataset.")
    sort: BoxSort = "id"
    limit: Limit = 100
    cursor: Cursor = None
    count: bool = Field(
        default=False, description="Whether to return `total` and `snapshot` too."
    )


class FrameListQuery(BoxSelection):
    """The query of a list of frames: those that have such a box."""

    key: str = Field(
        default="",
        max_length=512,
        description="Only frames whose key begins with this.",
    )
    sort: FrameSort = "key"
    limit: Limit = 100
    cursor: Cursor = None


class BoxPage(Page[Decision], SparseModel):
    """One page of boxes; `total` and `snapshot` only with `count=true`."""

    total: int | None = Field(
        default=None,
        json_schema_extra=never_null,
        description="Number of all boxes that match the filter.",
    )
    snapshot: str | None = Field(
        default=None,
        json_schema_extra=never_null,
        description="Identifies the present state of the matching boxes. Send it with "
        "one answer on all of them.",
    )


@dataclass(frozen=True, kw_only=True)
class Selection:
    """All boxes that match a filter, as they were when the server counted them."""

    dataset: str
    filter: Json
    count: int
    snapshot: str


class QueueIn(RequestModel):
    """Selects the next boxes of the queue."""

    order: QueueOrder = "doubt"
    filters: BoxSelection = Field(
        default_factory=BoxSelection,
        description="Which boxes. Unless `review` or `conflict` is given: undecided "
        "boxes, or with the order `audit` those with keep or reject.",
    )
    limit: Annotated[int, Field(ge=1, le=50)] = 10
    exclude: list[Id] = Field(
        default_factory=list,
        max_length=1000,
        description="Ids of boxes that the caller has already: they are left out, and "
        "the caller's claims on them are renewed.",
    )
    seed: Annotated[int, Field(ge=-(2**63), le=2**63 - 1)] | None = Field(
        default=None,
        description="Number that the random order is drawn from; default: one per "
        "dataset.",
    )


class Queue(ResponseModel):
    """The next boxes to review, in the requested order, claimed for five minutes."""

    items: tuple[QueuedBox, ...]
    remaining: int = Field(
        description="Boxes that match the filter and that nobody has answered, claimed "
        "or not; with a filter on answers, all boxes that match."
    )
    unsure: Annotated[int, IfAbsent(0)] = Field(
        description="Boxes that a person was unsure about; they come last."
    )
    claimed_by_others: Annotated[int, IfAbsent(0)]


class ReviewIn(RequestModel):
    """An answer on one box."""

    verdict: Answer
    comment: Comment = ""
    seen_revision: Revision = Field(
        description="`revision` of the box when it was seen; 0 if it had no answer. "
        "Refused with 412 if somebody has answered since."
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
    """A bulk answer, on the boxes of `box_ids` or on all that match `filter`."""

    dataset: Annotated[str, Field(max_length=100)]
    box_ids: Annotated[list[Id], Field(fail_fast=True)] | None = None
    seen_revisions: Annotated[list[Revision], Field(fail_fast=True)] | None = Field(
        default=None,
        description="`revision` of each of `box_ids` when it was seen, in the same "
        "order. Boxes that were answered since are not changed. Without it, boxes that "
        "have an answer are not changed.",
    )
    filter: BoxSelection | None = None
    snapshot: Annotated[str, Field(max_length=1000)] | None = Field(
        default=None,
        description="`snapshot` that `GET /api/v1/boxes?count=true` returned for this "
        "filter. Refused with 412 if its boxes have changed since.",
    )
    expected_count: Annotated[int, Field(ge=0)] | None = Field(
        default=None,
        description="Number of boxes expected; refused with 409 if it is another.",
    )
    verdict: Answer
    comment: Comment = ""


class ReviewBatch(ResponseModel):
    """A bulk answer: one answer on many boxes, which is undone as a whole."""

    id: int
    dataset: str
    verdict: Answer
    count: int = Field(description="Number of boxes that were answered.")
    skipped: Annotated[tuple[int, ...], IfAbsent(())] = Field(
        description="Ids of boxes that no longer exist or belong to another dataset."
    )
    stale: Annotated[tuple[int, ...], IfAbsent(())] = Field(
        description="Ids of boxes that were not changed, because somebody has answered "
        "them since."
    )


class UndoneBatch(ResponseModel):
    """How many boxes an undo restored; `skipped` are those answered again since."""

    id: int
    undone: int
    skipped: Annotated[tuple[int, ...], IfAbsent(())]


class HistoryEntry(SparseModel):
    """A decision or a review in the past of a box; `kind` says which of the two.

    A decision has `run` and what follows from it, and `activated` if the run changed
    the verdict. A review has `revision`, `reviewer`, `comment`, the `batch` that it was
    given in, the revision that it `undoes`, and `carried_from`, the box of an earlier
    revision of the frame that it was given on.
    """

    # In the order in which either kind of entry has its keys.
    kind: HistoryKind
    at: AwareDatetime
    run: int | None = None
    config: str | None = None
    revision: int | None = None
    reviewer: str | None = None
    verdict: Verdict | Answer | None = Field(
        description="The filter's or the person's; null if the numbers of the run are "
        "not stored any more."
    )
    reason: Reason | None = None
    match_percent: float | None = None
    threshold: float | None = None
    activated: bool | None = None
    comment: str | None = None
    batch: int | None = None
    undoes: int | None = None
    carried_from: int | None = None


class History(Page[HistoryEntry]):
    """One page of what happened to a box, newest first."""
