"""`Evidence`: the numbers that are measured for boxes, as columns.

`ChannelNumbers` is the part of it that is measured besides the segmentation. How these
are measured is in `evidence/`, what follows from them in `decisions/`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from enum import IntEnum
from typing import Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import (
    NOT_MEASURED,
    BoolArray,
    BoxesXYXY,
    FloatArray,
    IntArray,
    rows_of,
)

DepthEncoding: TypeAlias = Literal[
    "auto", "carla", "carla-bgr", "millimetres16", "metres16", "log8", "linear8"
]
"""How a depth image holds metres; ``auto`` leaves it to recognition."""


N_TAGS: Final = 31
"""Columns of a tag histogram: tags 0..29, then Unknown."""


UNKNOWN_COLUMN: Final = N_TAGS - 1


class BoxState(IntEnum):
    """The result of correcting a box's coordinates (Algorithm 1 of the paper)."""

    MEASURABLE = 0
    OUTSIDE_IMAGE = 1
    COVERS_IMAGE = 2
    DEGENERATE = 3
    NOT_AHEAD = 4
    """Its rectangle was not looked at: its centre is nearer than `min_forward`."""


@dataclass(frozen=True)
class NumberColumn:
    """Describes one stored column, a field of `Evidence` or `ChannelNumbers`.

    Attributes
    ----------
    meaning : str
        What was measured, in one line.
    unit : str
        Empty for numbers that have none.
    dtype : str
        numpy's name of the type in memory.
    missing : float
        The number that stands for "nothing measured".
    width : int
        Numbers per box: 1 for a column (N,), 4 for rectangles (N, 4).
    stored : str
        numpy's name of the type in stored records, if it is another than in memory.
    since : int
        The first layout of stored records that has the column. A column that is added
        gets the next number, so that older records can still be read.
    """

    meaning: str
    unit: str
    dtype: str
    missing: float
    width: int = 1
    stored: str = ""
    since: int = 1

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one box's entry: () for a number, (4,) for a rectangle."""
        return () if self.width == 1 else (self.width,)


def number_columns(table: type[Evidence | ChannelNumbers]) -> dict[str, NumberColumn]:
    """The columns of numbers that are measured and stored, by their fields' names."""
    declared = {spec.name: spec.metadata.get("column") for spec in fields(table)}
    return {name: column for name, column in declared.items() if column is not None}


def _count_column(
    meaning: str, *, unit: str = "px", since: int = 1
) -> dict[str, NumberColumn]:
    return {"column": NumberColumn(meaning, unit, "i8", 0, since=since)}


def _channel_count_column(
    meaning: str, *, unit: str = "px", stored: str = ""
) -> dict[str, NumberColumn]:
    """A column of counts that has `NOT_MEASURED` where its channel has none."""
    return {"column": NumberColumn(meaning, unit, "i8", NOT_MEASURED, stored=stored)}


def _float_column(
    meaning: str, *, unit: str, width: int = 1, since: int = 1
) -> dict[str, NumberColumn]:
    return {"column": NumberColumn(meaning, unit, "f8", np.nan, width, since=since)}


_ALL: Final = slice(None)


@dataclass(frozen=True)
class Evidence:
    """Numbers measured for N boxes: no threshold, no verdict.

    Attributes
    ----------
    class_names : tuple of str
        What `class_index` points into.
    class_index : (N,) int32
    xyxy : (N, 4) float64, px, or None
        None where only the numbers that a decision needs were loaded.
    tag_counts : (N, N_TAGS) int32, px, or None
        Pixels of each tag in the box; the last column is Unknown.
    channels : ChannelNumbers of N boxes, or None
        What was measured besides the segmentation.

    Notes
    -----
    The other columns are described where they are declared below: a `_count_column` is
    (N,) int64, a `_float_column` (N,) float64.
    """

    class_names: tuple[str, ...]
    class_index: NDArray[np.int32]
    state: NDArray[np.uint8] = field(
        metadata={
            "column": NumberColumn(
                "what correcting the box found", "`BoxState`", "u1", 0
            )
        }
    )
    measured: BoolArray = field(
        metadata={
            "column": NumberColumn("whether there was a segmentation", "", "?", False)
        }
    )
    accept_mask: IntArray = field(
        metadata=_count_column(
            "bit t is set if the box's class accepts tag t; 0: its class is not mapped",
            unit="tags",
        )
    )
    box_pixels: IntArray = field(
        metadata=_count_column("pixels of the box, without ignored ones")
    )
    matched_pixels: IntArray = field(
        metadata=_count_column("those of box_pixels that have an accepted tag")
    )
    image_pixels: IntArray = field(metadata=_count_column("pixels of the image"))
    match_percent: FloatArray = field(
        metadata=_float_column(
            "matched_pixels as percent of box_pixels; under profile `carlasimu` "
            "of the box's area, and can exceed 100",
            unit="percent",
        )
    )
    area_percent: FloatArray = field(
        metadata=_float_column("area of the box", unit="percent of the image")
    )
    crowding: FloatArray = field(
        metadata=_float_column(
            "largest share of it that one other box covers, of those whose "
            "accepted tags include one of its own",
            unit="percent of the box",
        )
    )
    distance: FloatArray = field(
        metadata=_float_column(
            "distance from the camera; NaN if unknown", unit="metres"
        )
    )
    unknown_pixels: IntArray = field(
        metadata=_count_column(
            "those of box_pixels whose tag or colour the family does not have", since=2
        )
    )
    xyxy: BoxesXYXY | None = field(
        default=None,
        metadata=_float_column(
            "corrected rectangle; NaN if outside the image or without area",
            unit="px",
            width=4,
        ),
    )
    distance_range: FloatArray | None = field(
        default=None,
        metadata=_float_column(
            "between which distances it is, where its distance is not known; NaN if "
            "this is not known either",
            unit="metres",
            width=2,
            since=3,
        ),
    )
    tag_counts: NDArray[np.int32] | None = None
    channels: ChannelNumbers | None = None

    def __len__(self) -> int:
        return len(self.class_index)

    def distance_bounds(self, rows: slice = _ALL) -> tuple[FloatArray, FloatArray]:
        """(M,), (M,) metres: between which distances some of the boxes are.

        Twice the distance where it is known, and NaN where nothing is.
        """
        distance = self.distance[rows]
        if self.distance_range is None:
            return distance, distance
        low, high = self.distance_range[rows].T
        unknown = np.isnan(distance)
        return np.where(unknown, low, distance), np.where(unknown, high, distance)

    def shown_match(self, rows: slice | IntArray = _ALL) -> FloatArray:
        """(M,) percent: the match of some of the boxes (default: all) as it is output.

        It is at most 100, which `match_percent` can exceed under profile ``carlasimu``,
        and NaN for a box without counted pixels, where `match_percent` is 0.
        """
        match = np.minimum(self.match_percent[rows], 100.0)
        match[self.box_pixels[rows] == 0] = np.nan
        return match

    def take(self, rows: IntArray) -> Evidence:
        """Some of the boxes, by their `rows` (M,), in the order asked for."""
        return rows_of(self, rows, shared=("class_names",))


@dataclass(frozen=True, eq=False)
class ChannelNumbers:
    """The numbers that channels measured for N boxes.

    Columns are (N,) int64 with `NOT_MEASURED` where a channel has no number for a box,
    or (N,) and (N, 4) float64 with NaN there. Every column that is declared here is
    stored; the module of its channel fills it.
    """

    owned_pixels: IntArray = field(
        metadata=_channel_count_column(
            "accepted pixels in the box's silhouette that no nearer box takes"
        )
    )
    explained_by: IntArray = field(
        metadata=_channel_count_column(
            "of the nearer boxes, the one that takes most of the accepted pixels in "
            "the box's silhouette",
            unit="position in the frame",
            stored="i4",
        )
    )
    depth_pixels: IntArray = field(
        metadata=_channel_count_column(
            "accepted pixels in the silhouette at the depth of the box itself"
        )
    )
    nearer_percent: FloatArray = field(
        metadata=_float_column(
            "share of the silhouette hidden by something nearer",
            unit="percent of the silhouette",
        )
    )
    depth_gap: FloatArray = field(
        metadata=_float_column(
            "how far the median of the accepted pixels is in front of the box "
            "(negative: behind it); NaN if some are at its own depth",
            unit="metres",
        )
    )
    center_gap: FloatArray = field(
        metadata=_float_column(
            "how far the surface seen at the box's centre is in front of the box",
            unit="metres",
        )
    )
    instance_pixels: IntArray = field(
        metadata=_channel_count_column(
            "accepted pixels of the instance that was assigned to it"
        )
    )
    lidar_points: IntArray = field(
        metadata=_channel_count_column(
            "points of an accepted tag inside the 3D box", unit="points"
        )
    )
    tight_xyxy: BoxesXYXY = field(
        metadata=_float_column(
            "rectangle around the visible pixels, by instance or else by depth",
            unit="px",
            width=4,
        )
    )

    @classmethod
    def absent(cls, count: int) -> ChannelNumbers:
        """New columns for `count` boxes, filled with "not measured"."""
        columns = {
            name: np.full((count, *column.shape), column.missing, column.dtype)
            for name, column in number_columns(cls).items()
        }
        return cls(**columns)

    def __len__(self) -> int:
        return len(self.owned_pixels)

    def __getitem__(self, rows: slice | IntArray | BoolArray) -> ChannelNumbers:
        """Some of the boxes."""
        return rows_of(self, rows)
