"""What the channels beyond the segmentation measure of each box. Numbers only."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

NOT_MEASURED: Final = -1
"""Stands for a count that a channel could not give."""


@dataclass(frozen=True, eq=False)
class ChannelNumbers:
    """Numbers of N boxes; `NOT_MEASURED` or NaN where a channel cannot tell.

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
