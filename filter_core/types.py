"""The values that flow through the library: arrays, boxes, evidence, decisions.

`FrameBoxes` is what is known of a frame's boxes before any pixel is read, `Evidence`
the numbers that were measured for them (`ChannelNumbers` those of the channels beside
the segmentation), `Decisions` the verdicts. All of them are columns: row i is box i.
There are no rules here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from enum import Enum, IntEnum
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

TagImage: TypeAlias = NDArray[np.uint8]
"""(H, W): CARLA's semantic tag of each pixel; 255 is Unknown."""

Mask: TypeAlias = NDArray[np.bool_]
"""(H, W): always boolean, never a tag image."""

BoxesXYXY: TypeAlias = NDArray[np.float64]
"""(N, 4) px, ``x_min y_min x_max y_max``, half-open: ``[0, 0, 1, 1]`` is one pixel."""

FloatArray: TypeAlias = NDArray[np.float64]

IntArray: TypeAlias = NDArray[np.int64]

BoolArray: TypeAlias = NDArray[np.bool_]

UNKNOWN_TAG: Final = 255
"""Of a pixel whose colour or number is no tag of its family."""

N_TAGS: Final = 31
"""Columns of a tag histogram: tags 0..29, then Unknown."""

UNKNOWN_COLUMN: Final = N_TAGS - 1


@dataclass(frozen=True)
class FrameBoxes:
    """The boxes of one frame, as given.

    Attributes
    ----------
    xyxy : (N, 4) float64, px
        Not yet corrected; may lie outside the image.
    class_names : tuple of str
        What `class_index` points into.
    class_index : (N,) int32
    accept_mask : (N,) int64
        Bit t is set if the box's class accepts tag t; 0: the class is not mapped.
    distance : (N,) float64, metres, NaN where unknown
    image_wh : (width, height) of the image, px
    """

    xyxy: BoxesXYXY
    class_names: tuple[str, ...]
    class_index: NDArray[np.int32]
    accept_mask: IntArray
    distance: FloatArray
    image_wh: tuple[int, int]

    def __len__(self) -> int:
        return len(self.class_index)

    @classmethod
    def of(
        cls,
        xyxy: BoxesXYXY | Sequence[Sequence[float]],
        classes: Sequence[str],
        accept_masks: Mapping[str, int],
        image_wh: tuple[int, int],
        distance: Sequence[float] | FloatArray | None = None,
    ) -> FrameBoxes:
        """Boxes from a class name per box and one accept mask per class.

        A class that `accept_masks` does not have is not mapped.
        """
        names = tuple(dict.fromkeys(classes))
        index = {name: number for number, name in enumerate(names)}
        unknown = np.full(len(classes), np.nan)
        return cls(
            xyxy=np.asarray(xyxy, dtype=np.float64).reshape(-1, 4),
            class_names=names,
            class_index=np.array([index[name] for name in classes], dtype=np.int32),
            accept_mask=np.array(
                [accept_masks.get(name, 0) for name in classes], dtype=np.int64
            ),
            distance=unknown if distance is None else np.asarray(distance, np.float64),
            image_wh=image_wh,
        )


class BoxState(IntEnum):
    """What correcting the coordinates (step 1) found."""

    MEASURABLE = 0
    OUTSIDE_IMAGE = 1
    COVERS_IMAGE = 2
    DEGENERATE = 3


@dataclass(frozen=True)
class Evidence:
    """Numbers measured for N boxes: no threshold, no verdict.

    Attributes
    ----------
    class_names : tuple of str
        What `class_index` points into.
    class_index : (N,) int32
    state : (N,) uint8, `BoxState`
    accept_mask : (N,) int64
        Bit t is set if the box's class accepts tag t; 0: the class is not mapped.
    measured : (N,) bool
        False where there was no segmentation to measure with.
    box_pixels, matched_pixels, image_pixels : (N,) int64, px
    match_percent : (N,) float64, 0..100 (profile ``carlasimu``: may pass 100)
        NaN where not measured.
    area_percent : (N,) float64, percent of the image
    crowding : (N,) float64, percent of this box that one other box covers
    distance : (N,) float64, metres, NaN where unknown
    xyxy : (N, 4) float64, px, or None
        Corrected; NaN rows for boxes outside the image or degenerate. None where only
        the numbers that a decision needs were loaded.
    tag_counts : (N, N_TAGS) int32, px, or None
    channels : ChannelNumbers of N boxes, or None
        What was measured beside the segmentation.
    """

    class_names: tuple[str, ...]
    class_index: NDArray[np.int32]
    state: NDArray[np.uint8]
    accept_mask: IntArray
    measured: BoolArray
    box_pixels: IntArray
    matched_pixels: IntArray
    image_pixels: IntArray
    match_percent: FloatArray
    area_percent: FloatArray
    crowding: FloatArray
    distance: FloatArray
    xyxy: BoxesXYXY | None = None
    tag_counts: NDArray[np.int32] | None = None
    channels: ChannelNumbers | None = None

    def __len__(self) -> int:
        return len(self.class_index)

    def take(self, rows: IntArray) -> Evidence:
        """Some of the boxes, in the order asked for."""
        columns: dict[str, Any] = {
            spec.name: getattr(self, spec.name) for spec in fields(self)
        }
        names = columns.pop("class_names")
        chosen: dict[str, Any] = {
            name: None if column is None else column[rows]
            for name, column in columns.items()
        }
        return Evidence(class_names=names, **chosen)


NOT_MEASURED: Final = -1
"""Stands for a count that a channel could not give."""


@dataclass(frozen=True, eq=False)
class ChannelNumbers:
    """What the channels beside the segmentation measured of N boxes.

    `NOT_MEASURED` or NaN where a channel cannot tell.

    Attributes
    ----------
    owned_pixels : (N,) int64, px
        Accepted pixels in the box's silhouette that no nearer box claims.
    explained_by : (N,) int64
        Position, in its frame, of the nearer box that claims most of the others.
    depth_pixels : (N,) int64, px
        Accepted pixels in the silhouette, at a depth that the box itself has.
    nearer_percent : (N,) float64, percent of the silhouette
        What of it is covered by something nearer than the box.
    depth_gap : (N,) float64, metres
        Where no accepted pixel is at the box's own depth: how far they (their median)
        are in front of it; negative: behind it. Else NaN.
    center_gap : (N,) float64, metres
        How far the surface seen at the box's centre is in front of the box.
    instance_pixels : (N,) int64, px
        Accepted pixels of the instance that belongs to the box.
    lidar_points : (N,) int64
        Points of an accepted tag inside the 3D box.
    tight_xyxy : (N, 4) float64, px
        Around the visible pixels, by instance or else by depth.
    """

    owned_pixels: NDArray[np.int64]
    explained_by: NDArray[np.int64]
    depth_pixels: NDArray[np.int64]
    nearer_percent: NDArray[np.float64]
    depth_gap: NDArray[np.float64]
    center_gap: NDArray[np.float64]
    instance_pixels: NDArray[np.int64]
    lidar_points: NDArray[np.int64]
    tight_xyxy: NDArray[np.float64]

    @classmethod
    def absent(cls, count: int) -> ChannelNumbers:
        """Nothing measured of `count` boxes; arrays of its own, to be filled."""
        return cls(
            owned_pixels=np.full(count, NOT_MEASURED, np.int64),
            explained_by=np.full(count, NOT_MEASURED, np.int64),
            depth_pixels=np.full(count, NOT_MEASURED, np.int64),
            nearer_percent=np.full(count, np.nan),
            depth_gap=np.full(count, np.nan),
            center_gap=np.full(count, np.nan),
            instance_pixels=np.full(count, NOT_MEASURED, np.int64),
            lidar_points=np.full(count, NOT_MEASURED, np.int64),
            tight_xyxy=np.full((count, 4), np.nan),
        )

    def __len__(self) -> int:
        return len(self.owned_pixels)

    def __getitem__(self, rows: Any) -> ChannelNumbers:  # noqa: ANN401  # as numpy takes
        columns = {spec.name: getattr(self, spec.name)[rows] for spec in fields(self)}
        return ChannelNumbers(**columns)


class Verdict(str, Enum):
    """What the filter says of a box."""

    KEPT = "kept"
    REJECTED = "rejected"
    UNMEASURED = "unmeasured"


class Reason(IntEnum):
    """The rule that decided; the numbers are stored and never change their meaning."""

    OUTSIDE_IMAGE = 1
    COVERS_IMAGE = 2
    DEGENERATE = 3
    OUT_OF_RANGE = 4
    UNMAPPED_CLASS = 5
    NO_SEGMENTATION = 6
    NO_VISIBLE_PIXELS = 7
    LARGE_BELOW_THRESHOLD = 8
    BELOW_THRESHOLD = 9
    EXPLAINED_BY_NEARER = 10
    HIDDEN_BY_DEPTH = 11
    HIDDEN_BY_INSTANCE = 12
    TOO_FEW_LIDAR_POINTS = 13
    VISIBLE = 14

    @property
    def label(self) -> str:
        """The reason's name on the wire, such as ``below_threshold``."""
        return _LABELS[self]

    @property
    def verdict(self) -> Verdict:
        """Each reason belongs to one verdict."""
        return _VERDICTS[self]

    @classmethod
    def from_label(cls, label: str) -> Reason:
        """Inverse of `label`; ``ValueError`` for an unknown name."""
        try:
            return cls[label.upper()]
        except KeyError:
            known = ", ".join(reason.label for reason in cls)
            raise ValueError(f"unknown reason {label!r}; known: {known}") from None


# By place, not by key: both are asked several times for every box that is shown, and to
# hash a reason takes longer than to do anything else with it. Reasons count from 1.
_LABELS: Final = ["", *(reason.name.lower() for reason in Reason)]

_VERDICTS: Final = [
    {
        Reason.VISIBLE: Verdict.KEPT,
        Reason.NO_SEGMENTATION: Verdict.UNMEASURED,
    }.get(reason, Verdict.REJECTED)
    for reason in (None, *Reason)
]


@dataclass(frozen=True)
class Decisions:
    """Verdicts for N boxes and what they rest on.

    Attributes
    ----------
    reason : (N,) uint8, `Reason`
    threshold : (N,) float64, percent; NaN where no threshold applied
    margin : (N,) float64, ``match_percent - threshold``; NaN where none applied
    toss_up : (N,) bool
        The 95 % Wilson interval of the match contains the threshold.
    large : (N,) bool
        The box was judged by the threshold for large boxes.
    """

    reason: NDArray[np.uint8]
    threshold: FloatArray
    margin: FloatArray
    toss_up: BoolArray
    large: BoolArray

    def __len__(self) -> int:
        return len(self.reason)

    def count(self, verdict: Verdict) -> int:
        """How many boxes have this verdict."""
        codes = [reason for reason in Reason if reason.verdict is verdict]
        return int(np.isin(self.reason, codes).sum())
