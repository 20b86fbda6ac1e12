"""Requests and responses about frames, also those of batches and of images."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Annotated, Final, Literal, get_args

from pydantic import AwareDatetime, Field, PrivateAttr, field_validator

from unghost.wire.boxes import Decision
from unghost.wire.datasets import FrameCounts, VerdictCounts
from unghost.wire.model import (
    IfAbsent,
    Json,
    Message,
    Problem,
    RequestModel,
    ResponseModel,
    SparseModel,
    never_null,
    optional,
    time_of,
)
from unghost.wire.words import EdgeKind, FileKind, LayerName, Verdict


class FrameSummary(ResponseModel):
    """A frame in a list of frames: its sizes, and the counts of its boxes."""

    id: int
    key: str
    revision: Annotated[int, IfAbsent(1)]
    width: int | None
    height: int | None
    map: str | None
    has_image: Annotated[bool, IfAbsent(False)]
    has_segmentation: Annotated[bool, IfAbsent(False)]
    lossy: Annotated[bool, IfAbsent(False)]
    created_at: AwareDatetime
    counts: FrameCounts


class DistanceBand(VerdictCounts):
    """Boxes of a range of distances, by effective verdict."""

    distance_from: float | None = Field(
        description="Least distance in metres; null for boxes without a distance."
    )
    distance_to: float | None = Field(
        description="Distance in metres that boxes do not reach; null if none is."
    )


class PlaceCounts(VerdictCounts):
    """Boxes of a map or a weather, by effective verdict."""

    name: str | None = Field(description="Null for boxes of frames without one.")


class Report(ResponseModel):
    """Where the ghosts of a dataset are."""

    by_distance: tuple[DistanceBand, ...] = Field(
        description="The bands that have boxes, the nearest first. A box with a "
        "`distance_range` is in the band that has all of it."
    )
    by_map: Annotated[tuple[PlaceCounts, ...], IfAbsent(())] = Field(
        description="By map, in order of name; empty if no frame has one."
    )
    by_weather: Annotated[tuple[PlaceCounts, ...], IfAbsent(())] = Field(
        description="By preset of the weather; `other` is a weather without a preset."
    )
    worst_frames: tuple[FrameSummary, ...] = Field(
        description="The twelve frames with the most rejected boxes."
    )


class SegmentationReport(ResponseModel):
    """What was recognised in a frame's segmentation."""

    palette: str
    encoding: str
    channel_order: str
    lossy: Annotated[bool, IfAbsent(False)]
    unknown_percent: Annotated[float, IfAbsent(0.0)]
    notes: Annotated[tuple[str, ...], IfAbsent(())]


class StoredFile(ResponseModel):
    """One file of a frame, as the server stores it."""

    url: str
    sha256: str
    media_type: str
    size_bytes: int


class FrameDetails(FrameSummary):
    """A frame without its boxes."""

    dataset: str
    camera: Json | None
    carla_version: str | None
    captured_text: str | None = Field(
        alias="captured_at",
        description="When it was recorded, as it was sent (RFC 3339).",
    )
    weather: Json | None
    sequence: Annotated[str | None, IfAbsent(None)] = Field(
        description="The drive that the frame is of, as its annotation says."
    )
    split: Annotated[str | None, IfAbsent(None)] = Field(
        description="The part of its data set that it came with, such as val."
    )
    superseded: Annotated[bool, IfAbsent(False)] = Field(
        description="Whether there is a newer revision."
    )
    segmentation: SegmentationReport | None
    files: Annotated[Mapping[FileKind, StoredFile], IfAbsent({})]

    @property
    def captured_at(self) -> datetime | None:
        """When it was recorded; None also of a time that is not written to RFC 3339."""
        try:
            return None if self.captured_text is None else time_of(self.captured_text)
        except ValueError:
            return None


class Frame(FrameDetails):
    """A frame with its boxes and their decisions, and the previous and next frame."""

    previous_id: int | None
    next_id: int | None
    boxes: Annotated[tuple[Decision, ...], IfAbsent(())]


MOST_BOXES_SET_ASIDE: Final = 10
"""The most ids in `boxes_set_aside` of a response."""

_ANSWERS_SET_ASIDE: Final = (
    "Answers of people on the replaced frame that were not carried over, since their "
    "boxes have changed or are gone. 0 if no frame was replaced."
)
_BOXES_SET_ASIDE: Final = (
    "The ids that these boxes had in their frame, in order; "
    f"at most {MOST_BOXES_SET_ASIDE}."
)

_IMAGE_NOTES: Final = (
    "What a person should know about how the depth and instance image were read, such "
    "as that one is not used as evidence. Empty if the frame was stored already."
)


class StoredFrame(ResponseModel):
    """A stored frame, with what was recognised and the decisions on its boxes."""

    frame: FrameDetails
    segmentation: SegmentationReport | None
    decisions: Annotated[tuple[Decision, ...], IfAbsent(())]
    answers_set_aside: Annotated[int, IfAbsent(0)] = Field(
        description=_ANSWERS_SET_ASIDE
    )
    boxes_set_aside: Annotated[tuple[str, ...], IfAbsent(())] = Field(
        description=_BOXES_SET_ASIDE
    )
    notes: Annotated[tuple[str, ...], IfAbsent(())] = Field(description=_IMAGE_NOTES)
    _created: bool = PrivateAttr(default=True)

    @property
    def created(self) -> bool:
        """False if the same was stored already: a response of 200 and not 201."""
        return self._created

    @classmethod
    def answered(cls, raw: Json, *, created: bool) -> StoredFrame:
        """Read a response whose status says whether the frame is new."""
        made = cls.read(raw)
        made._created = created
        return made


class KnownFramesIn(RequestModel):
    """Keys of frames to look for."""

    keys: list[str] = Field(max_length=1000)


class KnownFrame(ResponseModel):
    """A frame that is stored."""

    key: str
    frame_id: int
    digest: str = Field(
        description="Digest of the content, as defined in the guide to the API."
    )


class KnownFrames(ResponseModel):
    """The frames that are stored; the other keys are unknown."""

    items: tuple[KnownFrame, ...]


class BatchLine(SparseModel):
    """The outcome of one frame of a batch.

    `status` is the HTTP status that sending the frame alone would have had. A refused
    frame has a `problem`, and neither id nor decisions.
    """

    key: Message
    status: int
    frame_id: int | None
    decisions: VerdictCounts | None
    answers_set_aside: Annotated[int, IfAbsent(0)] = Field(
        description=_ANSWERS_SET_ASIDE
    )
    boxes_set_aside: Annotated[tuple[str, ...], IfAbsent(())] = Field(
        description=_BOXES_SET_ASIDE
    )
    notes: tuple[str, ...] = Field(
        default=(), description=f"{_IMAGE_NOTES} Absent if there are none."
    )
    problem: Problem | None = optional(json_schema_extra=never_null)


class BatchEnd(SparseModel):
    """The last line of a batch: the number of frames by outcome."""

    end: Literal[True]
    problem: Problem | None = optional(
        json_schema_extra=never_null,
        description="Why the rest of the archive was not read.",
    )
    frames: int
    stored: int
    same: int = Field(
        description="Frames that were already stored with the same content."
    )
    refused: int


_Version = Annotated[
    str,
    Field(
        max_length=100,
        description="Any word. With it, a browser may keep the picture without asking "
        "again, so another picture needs another word.",
    ),
]


class ThumbnailQuery(RequestModel):
    """Options of a frame's image as a small picture."""

    width: int = Field(
        default=384, ge=16, le=16_383, description="Maximum width in pixels."
    )
    v: _Version = ""


MOST_PAD: Final = 10
LEAST_ROWS: Final = 16
MOST_ROWS: Final = 2048


class CropQuery(RequestModel):
    """Options of the image crop around a box."""

    layer: LayerName = "image"
    pad: float = Field(
        default=0.25,
        ge=0,
        le=MOST_PAD,
        allow_inf_nan=False,
        description="Added on every side, as a fraction of the longer side of the box.",
    )
    least: int = Field(
        default=0,
        ge=0,
        le=4096,
        description="Least width and height of the part, in pixels of the frame.",
    )
    height: int = Field(
        default=256,
        ge=LEAST_ROWS,
        le=MOST_ROWS,
        description="Maximum height in pixels.",
    )
    v: _Version = ""


_CROP: Final = r"\d{1,18}-\d{1,2}(\.\d{1,4})?-\d{2,4}"
CROPS_PATTERN: Final = rf"^{_CROP}(,{_CROP}){{0,31}}$"


class CropsQuery(RequestModel):
    """Which crops of the image, around several boxes, a response holds."""

    crops: str = Field(
        pattern=CROPS_PATTERN,
        description="Up to 32, separated by commas: the id of the box, `pad` and "
        "`height`, as one crop has them, joined by hyphens.",
        examples=["7-0.25-256,12-0.5-192"],
    )
    v: _Version = ""

    @field_validator("crops")
    @classmethod
    def _check(cls, crops: str) -> str:
        for words in crops.split(","):
            _, pad, height = words.split("-")
            if float(pad) > MOST_PAD or not LEAST_ROWS <= int(height) <= MOST_ROWS:
                raise ValueError(
                    f"expected a pad up to {MOST_PAD}, a height from {LEAST_ROWS} to "
                    f"{MOST_ROWS}, found {words}"
                )
        return crops

    def parts(self) -> dict[str, tuple[int, CropQuery]]:
        """The box and the options of each crop, by its words in the query."""
        parts: dict[str, tuple[int, CropQuery]] = {}
        for words in self.crops.split(","):
            box_id, pad, height = words.split("-")
            query = CropQuery(pad=float(pad), height=int(height))
            parts[words] = int(box_id), query
        return parts


_VERDICT: Final = f"({'|'.join(get_args(Verdict))})"


class OverlayQuery(RequestModel):
    """What to draw over a frame."""

    layer: LayerName = "image"
    boxes: str = Field(
        default=",".join(get_args(Verdict)),
        pattern=rf"^({_VERDICT}(,{_VERDICT})*)?$",
        description="Effective verdicts whose boxes are drawn; empty for none.",
    )
    edges: EdgeKind = "2d"

    def verdicts(self) -> frozenset[str]:
        """The verdicts whose boxes are drawn."""
        return frozenset(self.boxes.split(",")) - {""}
