"""Requests and responses about boxes: decisions, reviews, the queue, the history."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final, Literal, TypeAlias, get_args

from pydantic import AwareDatetime, Field, JsonValue

from unghost.wire.model import (
    IfAbsent,
    Json,
    Page,
    RequestModel,
    ResponseModel,
    SparseModel,
    never_null,
    optional,
)
from unghost.wire.words import (
    Answer,
    Bin,
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

FrameKey = Annotated[str, Field(min_length=1, max_length=512)]
PlaceName = Annotated[str, Field(min_length=1, max_length=256)]


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
    created_at: Annotated[str, IfAbsent("")] = Field(
        description="When it was given (RFC 3339)."
    )


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
    distance_range: Annotated[tuple[float, float] | None, IfAbsent(None)]
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
    bin: Annotated[Bin, IfAbsent("ask")] = Field(
        description="Whether people are asked about it (`ask`), or why not."
    )
    doubt: Annotated[int, IfAbsent(0)] = Field(
        description="How much an answer is worth, from 1 to 100; 0 if nobody is asked."
    )
    question: Annotated[str | None, IfAbsent(None)] = Field(
        description="Why people are asked about it; null if they are not."
    )


class Box(Decision):
    """A box, and which boxes overlap it."""

    neighbours: Annotated[tuple[int, ...], IfAbsent(())] = Field(
        description="Ids of the boxes of the frame that overlap this one."
    )


class DepthBand(ResponseModel):
    """The pixels of a box between two depths."""

    near: float = Field(description="From this depth on, in metres.")
    far: float = Field(description="To this depth, in metres.")
    percent: float = Field(description="Share of the pixels in the box's rectangle.")


class DepthSlice(ResponseModel):
    """Where a box and the pixels in its rectangle are on one axis of depth."""

    near: float | None = Field(
        description="Nearest depth of the box, in metres; null if it is not 3D."
    )
    far: float | None = Field(description="Farthest depth of the box, in metres.")
    median: float | None = Field(
        description="Median depth of the pixels, in metres; null if all are sky."
    )
    bands: tuple[DepthBand, ...] = Field(
        description="The pixels by depth, from near to far, without the sky."
    )


class Alike(ResponseModel):
    """Boxes without an answer that are like another one.

    They have its class, its verdict with the reason, the cause of its doubt, what hides
    it, and its band of distance, which 50, 100, 150 and 200 m bound.
    """

    items: tuple[Decision, ...] = Field(
        description="At most 200, the `probable` first ones being probably the same."
    )
    total: int = Field(
        description="How many are alike of the first 2,000 boxes of its class, reason "
        "and band."
    )
    probable: int = Field(
        description="How many of `items` have nearly the same numbers: match and "
        "crowding differ by at most 10 points."
    )


class TrackedBox(Decision):
    """The box of an object in one frame of its recording."""

    offset: int = Field(
        description="How many frames later than the frame asked about; negative if "
        "before."
    )


class Track(ResponseModel):
    """One object in successive frames of its recording, in their order.

    A recording is the frames of a sequence in one folder. The object is the box of the
    same id and class, as long as its distance changes by at most 15 m from one frame to
    the next.
    """

    items: tuple[TrackedBox, ...] = Field(
        description="At most five frames each way, and the box itself."
    )


class Coached(ResponseModel):
    """Boxes by which somebody who is new to a dataset learns to answer."""

    items: tuple[Decision, ...] = Field(
        description="Five boxes, each harder than the one before. An instance image "
        "tells the truth: those with `visible_pixels` are seen, the others are ghosts. "
        "None if the dataset is not `coached`, if the caller has answered another box "
        "of it, or if it has too few such boxes."
    )


class Claim(ResponseModel):
    """The time until which a box of the queue is reserved for the caller."""

    expires_at: AwareDatetime


class QueuedBox(Decision):
    """A box of the queue, reserved (claimed) for the caller."""

    claim: Claim


_REVIEW_STATES: Final[list[JsonValue]] = ["", *get_args(ReviewState), None]


class BoxSelection(RequestModel):
    """Boxes of a list, by the same filters that the list takes."""

    verdict: Verdict | None = None
    effective: Verdict | None = None
    reason: Annotated[
        str | None, Field(description="Reasons, separated by commas.")
    ] = None
    class_name: str | None = optional(alias="class")
    review: Annotated[str | None, Field(json_schema_extra={"enum": _REVIEW_STATES})] = (
        None
    )
    toss_up: bool | None = None
    bin: Bin | None = optional(
        description="Only boxes to ask about, or only others of a kind."
    )
    conflict: bool | None = optional(
        description="Whether a person's keep or reject contradicts the filter."
    )
    match_min: Percent | None = optional(
        description="Only boxes with a match: not those outside the image."
    )
    match_max: Percent | None = None
    margin_max: Percent | None = None
    distance_min: Metres | None = None
    distance_max: Metres | None = None
    frame: FrameKey | None = optional(
        description="Only boxes of the frame with this key."
    )
    map: PlaceName | None = optional(description="Only boxes of frames on this map.")
    camera: PlaceName | None = optional(
        description="Only boxes of frames whose annotation has this `camera.name`."
    )
    sequence: PlaceName | None = optional(
        description="Only boxes of frames of this drive."
    )
    weather: PlaceName | None = optional(
        description="Only boxes of frames with this `weather.preset`; `other`: with a "
        "weather that has none."
    )


class BoxListQuery(BoxSelection):
    """The query of a list of boxes."""

    dataset: str = Field(description="Name of the dataset.")
    sort: BoxSort = "id"
    limit: Limit = 100
    cursor: Cursor = None
    count: bool = Field(
        default=False, description="Whether to return `total` and `snapshot` too."
    )
    fields: str | None = optional(
        max_length=1000,
        description="Names of fields, separated by commas: each item has these alone, "
        "whatever its schema requires. Default: all.",
        examples=["frame,id,class,effective_verdict"],
    )


BOX_FIELDS: Final = tuple(
    field.alias or name for name, field in Decision.model_fields.items()
)
"""The names of all fields of a box in a list."""


class BoxColumns(SparseModel):
    """Boxes as columns: lists of equal length, in the same order.

    Those that were asked for. The other names are those of the tables that exports
    have.
    """

    box_id: list[int]
    frame: list[str] = Field(description="Keys of the frames.")
    map: list[str | None]
    camera: list[str | None] = Field(description="`camera.name` of the annotations.")
    sequence: list[str | None] = Field(description="Drives that the frames are of.")
    weather: list[str | None] = Field(
        description="`weather.preset` of the annotations; `other` without one."
    )
    box: list[str] = Field(description="The ids that the sender gave the boxes.")
    class_name: list[str] = Field(alias="class")
    verdict: list[Verdict]
    effective_verdict: list[Verdict]
    reason: list[Reason]
    match_percent: list[float | None]
    threshold: list[float | None]
    margin: list[float | None]
    toss_up: list[bool]
    large: list[bool]
    matched_pixels: list[int | None]
    box_pixels: list[int]
    unknown_pixels: list[int | None]
    area_percent: list[float | None]
    crowding: list[float | None]
    explained_by: list[str | None]
    lossy: list[bool]
    distance: list[float | None]
    distance_from: list[float | None] = Field(
        description="Where the distance is not known: from so many metres on."
    )
    distance_to: list[float | None] = Field(description="Up to so many metres.")
    x_min: list[float | None] = Field(
        description="Left edges of the corrected rectangles, in pixels."
    )
    y_min: list[float | None] = Field(description="Their top edges.")
    x_max: list[float | None] = Field(description="Their right edges.")
    y_max: list[float | None] = Field(description="Their bottom edges.")
    review: list[Literal["keep", "reject", "unsure"] | None] = Field(
        description="The current answers of people."
    )
    revision: list[int]
    bin: list[Bin] = Field(
        description="Whether people are asked about a box (`ask`), or why not."
    )
    hidden_by: list[str] = Field(
        description="Tags in the boxes that their classes do not accept, with percent. "
        "Only if it is asked for, like those that follow."
    )
    reviewer: list[str | None]
    comment: list[str | None]
    config: list[str]


BOX_COLUMNS: Final = tuple(
    field.alias or name for name, field in BoxColumns.model_fields.items()
)
"""The names of all columns of boxes."""

USUAL_COLUMNS: Final = BOX_COLUMNS[: BOX_COLUMNS.index("hidden_by")]
"""The columns of boxes where none are asked for."""


class BoxTableQuery(BoxSelection):
    """The query of a table of boxes."""

    dataset: str = Field(description="Name of the dataset.")
    fields: str | None = optional(
        max_length=1000,
        description="Names of columns, separated by commas; default: all but those "
        "that take long.",
        examples=["frame,box,class,verdict"],
    )
    limit: Annotated[int, Field(ge=1, le=50_000)] = Field(
        default=10_000,
        description="Maximum number of boxes; whole frames are added until the next "
        "one would exceed it.",
    )
    cursor: Cursor = None


class BoxTable(ResponseModel):
    """Boxes as columns, in order of frame; `next_cursor` tells the boxes after them."""

    columns: BoxColumns = Field(description="The columns that were asked for.")
    rows: int = Field(description="Length of each column; may be 0 before the end.")
    next_cursor: str | None


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

    total: int | None = optional(
        json_schema_extra=never_null,
        description="Number of all boxes that match the filter.",
    )
    snapshot: str | None = optional(
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
        "boxes, or with the order `audit` those with keep or reject. Without any "
        "filter, the orders `doubt` and `class` have those of the bin `ask`.",
    )
    limit: Annotated[int, Field(ge=1, le=50)] = 10
    exclude: list[Id] = Field(
        default_factory=list,
        max_length=1000,
        description="Ids of boxes that the caller has already: they are left out, and "
        "the caller's claims on them are renewed.",
    )
    seed: Annotated[int, Field(ge=-(2**63), le=2**63 - 1)] | None = optional(
        description="Number that the random order is drawn from; default: one per "
        "dataset."
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


MOST_LOOKED_MS: Final = 86_400_000
"""The longest look at a box that an answer can say: a day."""


class ReviewIn(RequestModel):
    """An answer on one box."""

    verdict: Answer
    comment: Comment = ""
    seen_revision: Revision = Field(
        description="`revision` of the box when it was seen; 0 if it had no answer. "
        "Refused with 412 if somebody has answered since."
    )
    looked_ms: Annotated[int, Field(ge=0, le=MOST_LOOKED_MS)] | None = optional(
        description="For how many milliseconds the person had the box and its picture "
        "on the screen before the answer."
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


MOST_IMPORTED: Final = 200
"""Answers in one request that imports some."""

MOST_UNKNOWN: Final = 10
"""Answers on boxes that are not there, which a response lists."""


class ImportedAnswer(RequestModel):
    """An answer on one box, given somewhere else."""

    frame: Annotated[str, Field(min_length=1, max_length=512)]
    box: Annotated[str, Field(max_length=256)] = Field(
        description="The id of the box in its frame."
    )
    verdict: Literal["keep", "reject", "unsure"]
    reviewer: Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^\x00]*$")]
    comment: Comment = ""
    created_at: AwareDatetime = Field(description="When it was given.")


class AnswersIn(RequestModel):
    """Answers that were given somewhere else, at most 200."""

    answers: Annotated[
        list[ImportedAnswer], Field(min_length=1, max_length=MOST_IMPORTED)
    ]


class ImportedAnswers(ResponseModel):
    """What became of answers that were imported."""

    imported: int
    already: int = Field(description="Answers that the boxes have.")
    newer: int = Field(
        description="Answers that were not stored, since the box has a newer one."
    )
    unknown: int = Field(description="Answers on boxes that the dataset does not have.")
    unknown_boxes: Annotated[tuple[str, ...], IfAbsent(())] = Field(
        description="The first of these, as frame and box."
    )


class BulkIn(RequestModel):
    """A bulk answer, on the boxes of `box_ids` or on all that match `filter`."""

    dataset: Annotated[str, Field(max_length=100)]
    box_ids: Annotated[list[Id], Field(fail_fast=True)] | None = None
    seen_revisions: Annotated[list[Revision], Field(fail_fast=True)] | None = optional(
        description="`revision` of each of `box_ids` when it was seen, in the same "
        "order. Boxes that were answered since are not changed. Without it, boxes that "
        "have an answer are not changed."
    )
    filter: BoxSelection | None = None
    snapshot: Annotated[str, Field(max_length=1000)] | None = optional(
        description="`snapshot` that `GET /api/v1/boxes?count=true` returned for this "
        "filter. Refused with 412 if its boxes have changed since."
    )
    expected_count: Annotated[int, Field(ge=0)] | None = optional(
        description="Number of boxes expected; refused with 409 if it is another."
    )
    looked_at: Annotated[int, Field(ge=0, le=2**31 - 1)] | None = optional(
        description="How many of the boxes the person had on the screen before."
    )
    verdict: Answer
    comment: Comment = ""


class ReviewBatch(ResponseModel):
    """A bulk answer: one answer on many boxes, which is undone as a whole."""

    id: int
    dataset: str
    verdict: Answer
    count: int = Field(
        description="Number of boxes that were answered; 0 if all have this very "
        "answer of the caller already."
    )
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
    given in, with the number of its boxes (`batch_size`) and of those that the person
    had on the screen before (`looked_at`), the revision that it `undoes`,
    `carried_from`, the box of an earlier revision of the frame that it was given on,
    `imported_by`, who imported it from a file, and `looked_ms`, for how long the person
    had the box on the screen. If the queue chose the box for its author, it has the
    order (`chosen_by`) and the filters (`chosen_from`) of the queue.
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
    batch_size: int | None = optional(
        description="How many boxes the bulk answer has answered."
    )
    looked_at: int | None = optional(
        description="How many of these the person had on the screen before."
    )
    undoes: int | None = None
    carried_from: int | None = None
    imported_by: str | None = None
    looked_ms: int | None = None
    chosen_by: QueueOrder | None = None
    chosen_from: dict[str, object] | None = None
    probability: float | None = optional(
        description="Of being among the boxes of the random order up to this one. Only "
        "of a queue with all boxes of its classes."
    )


class History(Page[HistoryEntry]):
    """One page of what happened to a box, newest first."""
