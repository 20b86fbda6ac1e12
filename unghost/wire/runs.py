"""Requests and responses about configurations, previews, runs and exports."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final, Literal

from pydantic import (
    AwareDatetime,
    BeforeValidator,
    Field,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
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
    optional,
)
from unghost.wire.quality import Confusion
from unghost.wire.words import (
    FINISHED,
    EvidenceName,
    ExportFormat,
    FlipCause,
    Images,
    Include,
    JobState,
    Reason,
    Rectangle,
    RejectedBoxes,
    RunKind,
    SplitBy,
    Truth,
    Verdict,
)

MAX_BANDS: Final = 16
MAX_BAND: Final = 100_000
"""Metres."""
MAX_PICTURES: Final = 1000

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
    """The configuration to activate: a stored version, or one to store."""

    digest: Digest | None = None
    config: FilterConfigIn | str | None = optional(
        description="Instead of `digest`: keys and values, or the text of a YAML file. "
        "Keys that are not named have their defaults."
    )

    @model_validator(mode="after")
    def _is_one_of_both(self) -> ActivateIn:
        if (self.digest is None) == (self.config is None):
            present = "neither" if self.digest is None else "both"
            raise ValueError(f"expected digest or config, found {present}")
        return self


class PreviewIn(RequestModel):
    """A configuration to try; nothing is written."""

    config: FilterConfigIn
    limit: Annotated[
        int, Field(ge=0, le=1000, description="Maximum number of boxes to list.")
    ] = 100
    bins: Annotated[int, Field(ge=2, le=200)] = 50
    truth: Truth | None = optional(
        description="With what the verdicts are compared, before and after; null: with "
        "nothing."
    )


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
    visible: Annotated[bool | None, IfAbsent(None)] = Field(
        description="Whether the object is visible by the `truth` of a preview; null: "
        "that is not known."
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


class TruthScores(ResponseModel):
    """The boxes whose truth is known, by their verdicts before and after."""

    boxes: int
    before: Confusion
    after: Confusion


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
    histograms: Histogram | None = Field(
        description="Of the boxes that tags decide, by match_percent."
    )
    own_histograms: Annotated[Histogram | None, IfAbsent(None)] = Field(
        description="Of the boxes that other evidence decides, by the share of their "
        "pixels that are their object's own; its thresholds are `min_visible_percent`."
    )
    decided_by: Annotated[Mapping[EvidenceName, int] | None, IfAbsent(None)] = Field(
        description="How many boxes each kind of evidence decides; `semantic`: tags, "
        "or a rule that needs no pixels."
    )
    flips: Flips | None
    scores: Annotated[TruthScores | None, IfAbsent(None)] = Field(
        description="Null without `truth`."
    )


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


def _listed(value: object) -> object:
    """A single number as a list, as earlier versions took it."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return [value] if is_number else value


class ExportOptions(RequestModel):
    """The options of an export."""

    include: Include = Field(
        default="effective",
        description="Which boxes. effective: those whose effective verdict is "
        "kept; kept: those that the filter keeps; all: every box.",
    )
    include_unmeasured: bool = Field(
        default=True,
        description="Also boxes without a verdict (unmeasured), as they came. "
        "false: every frame with such a box is left out as a whole; no effect if "
        "include is all.",
    )
    rejected: RejectedBoxes = Field(
        default="drop",
        description="What to do with rejected boxes. drop: leave them out; "
        "dontcare: mark them to be ignored.",
    )
    boxes: Rectangle = Field(
        default="visible",
        description="Which rectangle of a box to write, if it has several.",
    )
    images: Images = Field(
        default="copy",
        description="Whether to include the images (copy) or not (none).",
    )
    allow_missing_images: bool = Field(
        default=False,
        description="If images are included, also write frames without an image, "
        "which many programs cannot read. They are left out otherwise.",
    )
    split: Annotated[
        list[Annotated[float, Field(ge=0, le=1)]],
        BeforeValidator(_listed),
        Field(
            max_length=3,
            description="Shares of the parts train, val and test, whose sum is 1; of "
            "one number the rest is for val. Whole sequences go into a part, chosen by "
            "their names and map, so that they keep it when others are added. Empty: "
            "every frame keeps the part that it came with, and of those without one "
            "80 % are for training, each by its key.",
        ),
    ] = Field(default=[])
    split_by: SplitBy = Field(
        default="sequence",
        description="What the shares of split are of. sequence: whole sequences; "
        "map: the frames of each map, exactly, whatever their sequences.",
    )
    val_maps: str = Field(
        default="",
        max_length=2000,
        description="Names of maps, separated by commas, all of whose frames are "
        "the part val; all others are train. Instead of split.",
    )
    bands: list[Annotated[int, Field(ge=1, le=MAX_BAND)]] = Field(
        default=[],
        max_length=MAX_BANDS,
        description="Distances in metres; the labels are written once more for each, "
        "with the boxes up to it. carlasimu: instead of 50, 100, 150 and 200.",
    )
    pictures: int = Field(
        default=0,
        ge=0,
        le=MAX_PICTURES,
        description="The first frames of which the archive has pictures before and "
        "after the filter, with a contact sheet and a page.",
    )
    drawn: bool = Field(
        default=False,
        description="Also a picture of each frame with all its boxes, and one with "
        "those that are written.",
    )

    @classmethod
    def read(cls, raw: Json) -> ExportOptions:
        """Take the options of an earlier export as they are, without a check."""
        return cls.model_construct(None, **raw)


VersionName = Annotated[
    str, Field(pattern=r"^[A-Za-z0-9](?:[A-Za-z0-9._-]{0,98}[A-Za-z0-9])?$")
]


class ExportIn(RequestModel):
    """A request for an export."""

    format: Annotated[
        ExportFormat, Field(description="The format to write; see docs/formats.md.")
    ]
    options: ExportOptions = ExportOptions()
    name: VersionName | None = optional(
        description="Name of a version: its file is kept until it is deleted, and can "
        "be downloaded again, byte for byte.",
        examples=["v1"],
    )
    since: VersionName | None = optional(
        description="Name of a version: only frames that are new or have changed since "
        "are written; `removed` in manifest.json lists those that are gone."
    )


class Parts(ResponseModel):
    """The parts that an export has or would have, such as train and val."""

    frames: Annotated[Mapping[str, int], IfAbsent({})] = Field(
        description="Frames in each part."
    )
    sequences: Annotated[Mapping[str, int], IfAbsent({})] = Field(
        description="Whole sequences in each part, if shares were asked for."
    )
    split: Annotated[Mapping[str, int], IfAbsent({})] = Field(
        description="Frames by what tells their part: as_it_came, by_sequence, "
        "without_sequence (by shares, each by itself), by_frame (by its key)."
    )


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
    name: Annotated[str | None, IfAbsent(None)] = Field(
        description="Name of the version; null of an export that is none."
    )
    since: Annotated[str | None, IfAbsent(None)] = Field(
        description="The version whose unchanged frames were left out."
    )
    version: Annotated[str | None, IfAbsent(None)] = Field(
        description="Digest of all frames with their files, decisions and answers, and "
        "of the configuration; equal digests: equal data. null until it is done."
    )
    download: str | None

    @property
    def finished(self) -> bool:
        """Nothing more will happen to it."""
        return self.state in FINISHED


class DownloadLink(ResponseModel):
    """A link that downloads one export without a token, and until when."""

    url: str
    expires_at: AwareDatetime
