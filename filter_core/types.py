"""The values that flow through the filter. No rules here."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import Enum, IntEnum
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from filter_core.channel_types import ChannelNumbers

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

N_TAGS: Final = 31
"""Columns of a tag histogram: tags 0..29, then Unknown."""

UNKNOWN_COLUMN: Final = 30


class Verdict(str, Enum):
    """What the filter says of a box."""

    KEPT = "kept"
    REJECTED = "rejected"
    UNMEASURED = "unmeasured"


class BoxState(IntEnum):
    """What correcting the coordinates (step 1) found."""

    MEASURABLE = 0
    OUTSIDE_IMAGE = 1
    COVERS_IMAGE = 2
    DEGENERATE = 3


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

_VERDICTS: Final = [Verdict.REJECTED for _ in _LABELS]

_VERDICTS[Reason.VISIBLE] = Verdict.KEPT

_VERDICTS[Reason.NO_SEGMENTATION] = Verdict.UNMEASURED


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
