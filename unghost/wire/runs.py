"""Requests and responses about configurations, previews, runs and exports."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final, Literal

from pydantic import (
    AwareDatetime,
    Field,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)

from unghost.wire.boxes import XYXY
from unghost.wire.datasets import FilterConfigIn, Histogram, VerdictCounts
from unghost.wire.model import (
    IfAbsent,
    Json,
    Message,
    RequestModel,
    ResponseModel,
    SparseModel,
)
from unghost.wire.words import (
    FINISHED,
    ExportFormat,
    FlipCause,
    Images,
    Include,
    JobState,
    Reason,
    Rectangle,
    RejectedBoxes,
    RunKind,
    Verdict,
)

MAX_BANDS: Final = 16
MAX_BAND: Final = 100_000
"""Metres."""

Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class ConfigVersion(ResponseModel):
    """One immutable version of a dataset's filter configuration, with its digest."""

    digest: str
    config: Json
    unused_keys: Annotated[tuple[str, ...], IfAbsent(())]
    created_by: str
    created_at: AwareDatetime
    active: bool


class ActivateIn(RequestModel):
    """The version to activate."""

    digest: Digest


class PreviewIn(RequestModel):
    """A configuration to try; nothing is written."""

    config: FilterConfigIn
    limit: Annotated[
        int, Field(ge=0, le=1000, description="Maximum number of boxes to list.")
    ] = 100
    bins: Annotated[int, Field(ge=2, le=200)] = 50


class FlipSide(ResponseModel):
    """A box's verdict on one side of a change, its reason, and what was compared.

    `threshold` is null where no threshold applied.
    """

    verdict: Verdict
    reason: Reason
    match_percent: Annotated[float | None, IfAbsent(None)]
    threshold: Annotated[float | None, IfAbsent(None)]


class Flip(ResponseModel):
    """A flip: a box whose verdict changes.

    `match_percent` is that of `after`; `xyxy` is null for a box without a rectangle in
    the image.
    """

    box_id: int
    frame_id: int
    class_name: str = Field(alias="class")
    xyxy: Annotated[XYXY | None, IfAbsent(None)]
    match_percent: float | None
    before: FlipSide
    after: FlipSide
    cause: Annotated[FlipCause | None, IfAbsent(None)] = Field(
        description="What changed the verdict besides the configuration: class_known: "
        "the name of its class is understood now; edge_rounded: an edge that was "
        "rounded is a whole number again. null: nothing else is known to have."
    )


class FlipCounts(ResponseModel):
    """How many boxes change from kept to rejected, and the reverse."""

    kept_to_rejected: Annotated[int, IfAbsent(0)]
    rejected_to_kept: Annotated[int, IfAbsent(0)]


class _OfAll(ResponseModel):
    total: int = Field(description="Boxes whose verdicts differ.")


# Bases are written from right to left: that is the order of the keys in a response.
class Flips(FlipCounts, _OfAll):
    """How many verdicts would change, and the boxes nearest to their new threshold."""

    by_class: Mapping[str, FlipCounts]
    items: tuple[Flip, ...]


class Preview(ResponseModel):
    """The verdicts that a configuration would give; nothing is stored.

    `needs_pixels`: images have to be measured again, so there is no preview, and all
    later fields are null.
    """

    config: str
    needs_pixels: bool
    counts: VerdictCounts | None
    by_reason: Mapping[Reason, int] | None
    by_class: Mapping[str, VerdictCounts] | None
    reasons_by_class: Mapping[str, Mapping[Reason, int]] | None
    histograms: Histogram | None
    flips: Flips | None


def _in_either_form(value: object, check: ValidatorFunctionWrapHandler) -> object:
    """One error instead of one for each of the two forms."""
    try:
        return check(value)
    except ValidationError as exc:
        raise ValueError(_EITHER_FORM) from exc


_EITHER_FORM: Final = (
    "expected a configuration, or a digest of 64 hexadecimal digits of one"
)


class RunIn(RequestModel):
    """Apply a configuration: its digest, or its keys and values."""

    config: Annotated[Digest | FilterConfigIn, WrapValidator(_in_either_form)]
    scope: Literal["dataset"] = "dataset"
    activate: bool = False
    measure_again: Annotated[
        bool,
        Field(
            description="Read the images again if an earlier version of Unghost has "
            "measured the numbers, also where those would do."
        ),
    ] = False


class RunCounts(VerdictCounts, SparseModel):
    """Boxes by verdict; an empty object until the run is done, which is read as 0."""

    kept: int = 0
    rejected: int = 0
    unmeasured: int = 0


class Failure(ResponseModel):
    """Why a run or an export failed, or why the file of an export is gone.

    `code` is for programs, `detail` for people.
    """

    code: str
    detail: Annotated[Message, IfAbsent("")]


class Run(ResponseModel):
    """A run: one configuration applied to a dataset, its progress and its result."""

    id: int
    dataset: str
    kind: RunKind
    state: JobState
    config: str
    activate: bool
    total: int
    done: int
    changed: int = Field(
        description="Boxes with another verdict or reason than before."
    )
    counts: Annotated[RunCounts, IfAbsent(RunCounts())]
    error: Failure | None
    created_by: str
    created_at: AwareDatetime
    started_at: AwareDatetime | None
    finished_at: AwareDatetime | None

    @property
    def finished(self) -> bool:
        """Nothing more will happen to it."""
        return self.state in FINISHED


class _Compared(ResponseModel):
    run: int
    against: int
    compared: Annotated[int, IfAbsent(0)] = Field(
        description="Boxes for which numbers of both runs are stored."
    )


class Diff(FlipCounts, _OfAll, _Compared):
    """The boxes whose verdicts differ between two runs: counts, and a page of boxes."""

    by_class: Annotated[Mapping[str, int], IfAbsent({})] = Field(
        description="Boxes whose verdicts differ."
    )
    sides_by_class: Annotated[Mapping[str, FlipCounts], IfAbsent({})] = Field(
        description="How many of these boxes change from kept to rejected, and the "
        "reverse."
    )
    by_cause: Annotated[Mapping[FlipCause, int], IfAbsent({})] = Field(
        description="Of how many of these boxes the cause is known, by the cause; see "
        "the causes of items."
    )
    items: Annotated[tuple[Flip, ...], IfAbsent(())]
    next_cursor: str | None


class ExportOptions(RequestModel):
    """The options of an export."""

    include: Annotated[
        Include,
        Field(
            description="Which boxes. effective: those whose effective verdict is "
            "kept; kept: those that the filter keeps; all: every box."
        ),
    ] = "effective"
    include_unmeasured: Annotated[
        bool,
        Field(
            description="Also boxes without a verdict (unmeasured), as they came. "
            "false: every frame with such a box is left out as a whole; no effect if "
            "include is all."
        ),
    ] = True
    rejected: Annotated[
        RejectedBoxes,
        Field(
            description="What to do with rejected boxes. drop: leave them out; "
            "dontcare: mark them to be ignored."
        ),
    ] = "drop"
    boxes: Annotated[
        Rectangle,
        Field(description="Which rectangle of a box to write, if it has several."),
    ] = "visible"
    images: Annotated[
        Images, Field(description="Whether to include the images (copy) or not (none).")
    ] = "copy"
    allow_missing_images: Annotated[
        bool,
        Field(
            description="If images are included, also write frames without an image, "
            "which many programs cannot read. They are left out otherwise."
        ),
    ] = False
    split: Annotated[
        float,
        Field(
            ge=0,
            le=1,
            description="About this share of the frames is for training, 0 to 1. A "
            "hash of its key and map decides the part of a frame, so that it keeps its "
            "part when others are added.",
        ),
    ] = 0.8
    bands: list[Annotated[int, Field(ge=1, le=MAX_BAND)]] = Field(
        default=[],
        max_length=MAX_BANDS,
        description="Distances in metres; the labels are written once more for each, "
        "with the boxes up to it.",
    )

    @classmethod
    def read(cls, raw: Json) -> ExportOptions:
        """Take the options of an earlier export as they are, without a check."""
        return cls.model_construct(None, **raw)


class ExportIn(RequestModel):
    """A request for an export."""

    format: Annotated[
        ExportFormat,
        Field(description="The format to write; see docs/formats.md."),
    ]
    options: ExportOptions = ExportOptions()


class Export(ResponseModel):
    """A file of labels that is being written, or is ready to be downloaded.

    Frames are counted: `done` of `total` are written. If it is done and `download` is
    null, its file was deleted, and `error` says why.
    """

    id: int
    dataset: str
    format: ExportFormat
    options: ExportOptions
    state: JobState
    total: int
    done: int
    size_bytes: int | None
    sha256: str | None
    counts: Json | None
    error: Failure | None
    created_by: Annotated[str, IfAbsent("")]
    created_at: AwareDatetime
    finished_at: AwareDatetime | None
    download: str | None

    @property
    def finished(self) -> bool:
        """Nothing more will happen to it."""
        return self.state in FINISHED


class DownloadLink(ResponseModel):
    """A link that downloads one export without a token, and until when."""

    url: str
    expires_at: AwareDatetime
