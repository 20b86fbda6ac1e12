"""Requests and responses about datasets, and the counts of their boxes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final, TypeAlias

from pydantic import (
    AwareDatetime,
    ConfigDict,
    Field,
    RootModel,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic.config import JsonDict

from unghost.wire.model import (
    Fault,
    IfAbsent,
    Json,
    Message,
    RequestModel,
    ResponseModel,
    SparseModel,
    never_null,
    optional,
    properties_of,
)
from unghost.wire.words import (
    Bin,
    ChannelOrder,
    Encoding,
    EvidenceChoice,
    LossyPolicy,
    Palette,
    Reason,
)

ClassName = Annotated[str, Field(max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$")]
Description = Annotated[str, Field(max_length=2000, pattern=r"^[^\x00]*$")]
Rule = Annotated[
    str,
    Field(
        max_length=500,
        pattern=r"^[^\x00]*$",
        description="By which rule people keep boxes, shown beside each question.",
    ),
]
_COACHED: Final = (
    "Whether the queue begins, for somebody who has answered none of its boxes, with "
    "five whose truth instance images tell, and says after each answer whether it was "
    "right."
)
Pixel = Annotated[float, Field(allow_inf_nan=False)]
Point = Annotated[list[Pixel], Field(min_length=2, max_length=2)]
Polygon = Annotated[list[Point], Field(min_length=3, max_length=1000, fail_fast=True)]
Polygons = Annotated[list[Polygon], Field(min_length=1, max_length=100, fail_fast=True)]

MAX_CLASSES: Final = 1_000
"""Most classes of a dataset: those it is created with and those its frames add."""

ClassNames = Annotated[list[ClassName], Field(max_length=MAX_CLASSES)]

MAX_POINTS: Final = 10_000
"""Most points of an ignore mask; each preview of thresholds reads all of them."""


class IgnoreMask(RequestModel):
    """Pixels that are never counted, such as the bonnet: as polygons or as a PNG."""

    polygons: Polygons | None = optional(
        description="Corners of each polygon, in pixels; at most 10,000 in all."
    )
    png: Annotated[str, Field(max_length=2_000_000)] | None = optional(
        description="A PNG of the frames' size, in Base64; pixels that are not black "
        "are ignored."
    )

    @model_validator(mode="after")
    def _check_polygons_or_png(self) -> IgnoreMask:
        if (self.polygons is None) == (self.png is None):
            raise ValueError("expected either polygons or png")
        points = sum(map(len, self.polygons or ()))
        if points > MAX_POINTS:
            raise ValueError(f"expected at most {MAX_POINTS} points, found {points}")
        return self


class FilterConfigIn(RootModel[dict[str, object]]):
    """A filter configuration: keys of docs/configuration.md with their values."""


class RecordingIn(RootModel[dict[str, object]]):
    """A description of a recording: what its recording.yaml says, as JSON."""


class DatasetIn(RequestModel):
    """A new dataset."""

    name: Annotated[
        str,
        Field(
            pattern=r"^[A-Za-z0-9](?:[A-Za-z0-9._-]{0,98}[A-Za-z0-9])?$",
            description="Letters, digits, dots, dashes, underscores; unique "
            "regardless of case.",
        ),
    ]
    description: Description = ""
    rule: Rule = ""
    coached: bool = Field(default=False, description=_COACHED)
    classes: ClassNames | None = optional(
        description="Names of the classes in their order; default: the eight classes "
        "of CARLA."
    )
    palette: Palette = "auto"
    encoding: Encoding = "auto"
    channel_order: ChannelOrder = "auto"
    lossy_segmentation: LossyPolicy = "refuse"
    ignore_mask: IgnoreMask | None = None
    config: FilterConfigIn | None = optional(
        description="Its first configuration; default: that of the service."
    )
    recording: RecordingIn | None = optional(
        description="How the folder of its frames is read, kept to read it so again; "
        "it changes no setting."
    )


_CLEARED_BY_NULL: Final = ("ignore_mask", "recording")


def _values_are_needed(schema: JsonDict) -> None:
    for name, value in properties_of(schema):
        if name not in _CLEARED_BY_NULL:
            never_null(value)
            value.pop("default", None)


class DatasetPatch(RequestModel):
    """Changes of a dataset; those to reading segmentations measure all frames again."""

    model_config = ConfigDict(json_schema_extra=_values_are_needed)

    description: Description | None = None
    rule: Rule | None = None
    coached: bool | None = optional(description=_COACHED)
    palette: Palette | None = None
    encoding: Encoding | None = None
    channel_order: ChannelOrder | None = None
    lossy_segmentation: LossyPolicy | None = None
    ignore_mask: IgnoreMask | None = optional(description="null removes the mask.")
    recording: RecordingIn | None = optional(
        description="Replaces the description; null removes it."
    )

    @field_validator("*", mode="before")
    @classmethod
    def _refuse_null(cls, value: object, field: ValidationInfo) -> object:
        if value is None and field.field_name not in _CLEARED_BY_NULL:
            raise ValueError("expected a value, found null; leave the key out instead")
        return value


class ClassPatch(RequestModel):
    """What becomes of a class of a dataset: a new name, or part of another class."""

    model_config = ConfigDict(json_schema_extra=_values_are_needed)

    name: ClassName | None = optional(
        description="Its new name, which no class of the dataset has."
    )
    merge_into: ClassName | None = optional(
        description="The class of the dataset that gets its boxes."
    )

    @model_validator(mode="after")
    def _check_name_or_merge(self) -> ClassPatch:
        if (self.name is None) == (self.merge_into is None):
            raise ValueError("expected either name or merge_into")
        return self


class _OfFrames(ResponseModel):
    frames: int


class _OfBoxes(ResponseModel):
    boxes: int


class VerdictCounts(ResponseModel):
    """How many boxes have each verdict."""

    kept: int
    rejected: int
    unmeasured: int


Counts: TypeAlias = VerdictCounts
"""What all counts have in common, under the name by which `unghost` offers it."""


# Bases are written from right to left: that is the order of the keys in a response.
class FrameCounts(VerdictCounts, _OfBoxes):
    """Boxes of a frame: by the filter's verdict, and by what people said.

    `reviewed` boxes have a keep or a reject. `to_review` counts boxes that have neither
    and that people are asked about: those of the bin `ask`, as the queue has them.
    """

    reviewed: int
    to_review: int


class DatasetCounts(FrameCounts, _OfFrames):
    """Boxes of a dataset, its frames, and the frames that were refused (`problems`)."""

    problems: int


class Dataset(ResponseModel):
    """A named set of frames with one list of classes and one active run."""

    name: str
    description: Annotated[str, IfAbsent("")]
    rule: Annotated[str, IfAbsent("")] = Field(
        description="By which rule people keep boxes, shown beside each question."
    )
    coached: Annotated[bool, IfAbsent(False)] = Field(description=_COACHED)
    classes: tuple[str, ...]
    classes_frozen: Annotated[bool, IfAbsent(False)]
    renamed_classes: Annotated[Mapping[str, str], IfAbsent({})] = Field(
        description="What a class is called now, by the name that boxes come with."
    )
    palette: Palette
    encoding: Encoding
    channel_order: ChannelOrder
    lossy_segmentation: LossyPolicy
    has_ignore_mask: Annotated[bool, IfAbsent(False)]
    recording: Annotated[Json | None, IfAbsent(None)] = Field(
        description="How the folder of its frames is read, as recording.yaml says it; "
        "null if nobody has told."
    )
    created_at: AwareDatetime
    config: str = Field(description="Digest of the active configuration.")
    evidence: Annotated[EvidenceChoice, IfAbsent("semantic")] = Field(
        description="By what its boxes are decided, as the configuration says."
    )
    active_run: int
    thumbnail_frame_id: int | None
    counts: DatasetCounts


class FrameProblem(SparseModel):
    """Why a frame was refused; `more_errors` only if some errors are not listed."""

    code: str
    detail: Annotated[Message, IfAbsent("")]
    errors: Annotated[tuple[Fault, ...], IfAbsent(())]
    more_errors: int = 0


class RefusedFrame(ResponseModel):
    """A frame that was sent and refused, and why."""

    id: int
    key: str
    error: FrameProblem
    created_at: AwareDatetime


class MapCounts(_OfBoxes, _OfFrames):
    """The frames of a map, a weather, a camera or a drive, and their boxes."""


class Stats(FrameCounts, _OfFrames):
    """Counts of the boxes of a dataset.

    `unsure`: a person answered unsure. `conflicts`: a person answered the opposite of
    the filter. `toss_ups`: too few pixels to be certain on which side of the threshold
    they are. `lossy`: measured in a segmentation whose colours were not exact.
    `effective` counts effective verdicts, all others the verdicts of the filter. `bins`
    counts boxes that have no keep or reject: what is left to review, and to whom.
    """

    unsure: int
    conflicts: int
    toss_ups: int
    bins: Annotated[Mapping[Bin, int], IfAbsent({})]
    lossy: int
    effective: VerdictCounts
    by_reason: Mapping[Reason, int]
    by_class: Mapping[str, VerdictCounts]
    reasons_by_class: Annotated[Mapping[str, Mapping[Reason, int]], IfAbsent({})]
    by_map: Annotated[Mapping[str, MapCounts], IfAbsent({})] = Field(
        description="Frames and boxes by map, of the frames that name one."
    )
    by_weather: Annotated[Mapping[str, MapCounts], IfAbsent({})] = Field(
        description="The same by preset of the weather; `other` without a preset."
    )
    by_camera: Annotated[Mapping[str, MapCounts], IfAbsent({})] = Field(
        description="The same by `camera.name` of the annotations."
    )
    by_sequence: Annotated[Mapping[str, MapCounts], IfAbsent({})] = Field(
        description="The same by drive."
    )
    config: str
    run: int


class Histogram(ResponseModel):
    """Boxes per bin of match_percent, for each class that occurs.

    `edges` has one number more than each class has counts. `thresholds` are those of
    the active configuration, in percent. `unknown_percent` is the share of the pixels
    in the boxes of a class whose tag or colour is not known, for classes with such
    pixels.
    """

    edges: tuple[float, ...]
    classes: Mapping[str, tuple[int, ...]]
    thresholds: Mapping[str, float]
    unknown_percent: Annotated[Mapping[str, float], IfAbsent({})]
