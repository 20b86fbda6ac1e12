"""Keywords of the client's methods, as editors and type checkers read them.

They are those of the API, whose models in `unghost.wire` say what each means. A value
that several models share a name with is checked by the server alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal, TypedDict

if TYPE_CHECKING:
    from unghost.client.outgoing import FileContent
    from unghost.wire import words


class BoxSelection(TypedDict, total=False):
    """Which boxes (`wire.BoxSelection`)."""

    verdict: words.Verdict | None
    effective: words.Verdict | None
    reason: str | Sequence[str] | None
    class_name: str | Sequence[str] | None
    review: words.ReviewState | Literal[""] | None
    toss_up: bool | None
    bin: words.Bin | None
    conflict: bool | None
    match_min: float | None
    match_max: float | None
    margin_max: float | None
    distance_min: float | None
    distance_max: float | None
    frame: str | None
    map: str | None
    camera: str | None
    sequence: str | None
    weather: str | None


class BoxFilters(BoxSelection, total=False):
    """Which boxes, and in which order (`wire.BoxListQuery`)."""

    sort: words.BoxSort
    limit: int


class FrameFilters(BoxSelection, total=False):
    """Which frames (`wire.FrameListQuery`): those that have such a box."""

    key: str
    sort: words.FrameSort
    limit: int


class DatasetChanges(TypedDict, total=False):
    """What can be changed of a dataset (`wire.DatasetPatch`)."""

    description: str
    rule: str
    coached: bool
    palette: words.Palette
    encoding: words.Encoding
    channel_order: words.ChannelOrder
    lossy_segmentation: words.LossyPolicy
    ignore_mask: Mapping[str, object] | None
    recording: Mapping[str, object] | None


class DatasetOptions(DatasetChanges, total=False):
    """How a dataset is made (`wire.DatasetIn`)."""

    classes: Sequence[str] | None
    config: Mapping[str, object] | None


class FrameFiles(TypedDict, total=False):
    """The files of a frame: bytes, paths, arrays of numpy, images of PIL."""

    image: FileContent | None
    segmentation: FileContent | None
    depth: FileContent | None
    instances: FileContent | None
    lidar: FileContent | None
    radar: FileContent | None
    ignore_mask: FileContent | None


class ExportChoices(TypedDict, total=False):
    """What an export has (`wire.ExportOptions`)."""

    include: words.Include
    include_unmeasured: bool
    rejected: words.RejectedBoxes
    boxes: words.Rectangle
    images: words.Images
    allow_missing_images: bool
    split: Sequence[float]
    split_by: Literal["sequence", "map"]
    val_maps: str
    bands: Sequence[int]
    pictures: int
    drawn: bool


class OverlayOptions(TypedDict, total=False):
    """What a picture of a frame shows (`wire.OverlayQuery`)."""

    boxes: str | Sequence[words.Verdict]
    layer: words.LayerName
    edges: words.EdgeKind


class CropOptions(TypedDict, total=False):
    """What a picture of a box shows (`wire.CropQuery`)."""

    pad: float
    least: int
    layer: words.LayerName
    height: int
