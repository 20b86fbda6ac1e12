"""The plan of the roads: tag and colour of the ground at each place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from unghost.street.paint import (
    Float32,
    Tag,
    cloudy_tile,
    column,
    coverage,
    grain_tile,
    mixed,
    sample,
    wrapped,
)

LANE, PARKING = 3.5, 2.4
"""Widths of a lane and of a parking strip, metres."""
SIDEWALK_HEIGHT: Final = 0.14
"""Above the road, metres."""
_LINE: Final = 0.06
"""Half the width of a painted line, metres."""

_ASPHALT: Final = column([0.092, 0.092, 0.096])
_WHITE: Final = column([0.56, 0.56, 0.54])
_YELLOW: Final = column([0.50, 0.34, 0.08])


@dataclass(frozen=True)
class RoadPlan:
    """One street along x, crossed by side streets along y; metres.

    It has so many lanes in each direction. `crossings` are the x of the side streets'
    middles.
    """

    lanes: int
    crossings: tuple[float, ...]
    side_half_width: float
    sidewalk: float

    @property
    def lanes_edge(self) -> float:
        """Where the lanes end and the parking begins."""
        return self.lanes * LANE

    @property
    def half_width(self) -> float:
        """From the middle of the street to the kerb."""
        return self.lanes_edge + PARKING

    @property
    def frontage(self) -> float:
        """From the middle of the street to the houses."""
        return self.half_width + self.sidewalk

    def lane_middle(self, lane: int) -> float:
        """Distance of a lane's middle from the street's, from 0 at the inside."""
        return (lane + 0.5) * LANE

    def look(
        self, x: Float32, y: Float32, footprint: tuple[Float32, Float32]
    ) -> tuple[NDArray[np.uint8], Float32]:
        """Tags (N,) and linear colours (3, N) of the ground.

        Parameters
        ----------
        x, y : (N,) metres
        footprint : metres per pixel along x and along y
        """
        road = (np.abs(y) < self.half_width) | self._on_side_street(x)
        lines, yellow = self._lines(x, y, footprint)
        lines = np.where(road, lines, 0)
        tags = np.where(road, np.uint8(Tag.ROAD), np.uint8(Tag.TERRAIN))
        tags = np.where(lines >= 0.5, np.uint8(Tag.ROAD_LINE), tags)
        asphalt = self._asphalt(x, y, footprint)
        worn = 0.86 + 0.10 * sample(cloudy_tile(3), x, y, 23.0)
        paint = np.where(yellow, _YELLOW, _WHITE)
        albedo = mixed(asphalt, paint, np.clip(lines * worn, 0, 1))
        off = np.flatnonzero(~road)
        albedo[:, off] = grass(x[off], y[off], footprint[0][off])
        return tags.astype(np.uint8), albedo

    def _on_side_street(self, x: Float32) -> NDArray[np.bool_]:
        return self._from_crossing(x) < self.side_half_width

    def _from_crossing(self, x: Float32) -> Float32:
        distances = [np.abs(x - np.float32(middle)) for middle in self.crossings]
        far = np.full(x.shape, 1e6, dtype=np.float32)
        return np.asarray(np.minimum.reduce([far, *distances]))

    def _lines(
        self, x: Float32, y: Float32, footprint: tuple[Float32, Float32]
    ) -> tuple[Float32, NDArray[np.bool_]]:
        along, across = footprint
        side, gap = np.abs(y), self._from_crossing(x) - self.side_half_width
        open_road = coverage(gap - 5.4, along)
        centre = coverage(_LINE - np.abs(side - 0.15), across) * open_road
        edge = coverage(_LINE - np.abs(side - self.lanes_edge), across) * open_road
        dash = coverage(1.5 - np.abs(wrapped(x, 7.5) - 3.75), along)
        between = np.zeros_like(x)
        for lane in range(1, self.lanes):
            strip = coverage(_LINE - np.abs(side - lane * LANE), across)
            between = np.maximum(between, strip * dash)
        between *= open_road
        zebra = coverage(0.25 - np.abs(wrapped(side, 1.0) - 0.5), across)
        zebra *= coverage(1.5 - np.abs(gap - 2.2), along)
        zebra *= side < self.half_width - 0.4
        stop = coverage(0.2 - np.abs(gap - 5.0), along)
        stop *= coverage(
            self.lanes_edge / 2 - 0.15 - np.abs(side - self.lanes_edge / 2), across
        )
        # Traffic keeps to the right: towards +x that is y > 0, before the crossing.
        stop *= (y > 0) == (self._offset(x) < 0)
        total = np.maximum.reduce(
            [centre, edge, between, zebra, stop, self._side_lines(x, y, footprint)]
        )
        return total, centre > 0.02

    def _side_lines(
        self, x: Float32, y: Float32, footprint: tuple[Float32, Float32]
    ) -> Float32:
        along, across = footprint
        off = self._from_crossing(x)
        gap = np.abs(y) - self.half_width
        dash = coverage(1.5 - np.abs(wrapped(y, 6.0) - 3.0), across)
        middle = coverage(_LINE - off, along) * dash * coverage(gap - 5.4, across)
        zebra = coverage(0.25 - np.abs(wrapped(off, 1.0) - 0.5), along)
        zebra *= coverage(1.5 - np.abs(gap - 2.0), across) * (
            off < self.side_half_width - 0.4
        )
        return np.maximum(middle, zebra)

    def _offset(self, x: Float32) -> Float32:
        """Signed distance of x from the middle of the nearest crossing, metres."""
        best = np.full(x.shape, 1e6, dtype=np.float32)
        for middle in self.crossings:
            offset = x - np.float32(middle)
            best = np.where(np.abs(offset) < np.abs(best), offset, best)
        return best

    def _asphalt(
        self, x: Float32, y: Float32, footprint: tuple[Float32, Float32]
    ) -> Float32:
        near = 1 / (1 + (footprint[1] * 70) ** 2)
        tone = 1 + 0.085 * sample(cloudy_tile(21), x, y, 9.0)
        tone += 0.06 * sample(cloudy_tile(22), x * 0.25, y * 2.0, 22.0)
        tone += 0.17 * near * sample(grain_tile(4), x, y, 55.0)
        in_lane = wrapped(np.abs(y), LANE) - LANE / 2
        driven = np.abs(y) < self.lanes_edge
        track = np.exp(-(((np.abs(in_lane) - 0.78) / 0.30) ** 2))
        oil = np.exp(-((in_lane / 0.35) ** 2))
        tone += driven * (0.055 * track - 0.10 * oil)
        gutter = np.clip((np.abs(y) - self.half_width + 0.5) / 0.5, 0, 1)
        tone -= 0.22 * gutter * (np.abs(y) < self.half_width)
        cracks = np.abs(sample(cloudy_tile(8, octaves=5), x, y, 30.0))
        tone -= 0.24 * near * np.clip(1 - cracks / 0.035, 0, 1)
        return np.asarray(_ASPHALT * np.maximum(tone, 0.2))


def grass(x: Float32, y: Float32, footprint: Float32) -> Float32:
    """(3, N) linear colours of a lawn."""
    near = 1 / (1 + (footprint * 14) ** 2)
    tone = 1 + 0.20 * sample(cloudy_tile(13), x, y, 12.0)
    tone += 0.24 * near * sample(grain_tile(14), x, y, 26.0)
    dry = np.clip(0.35 + 0.3 * sample(cloudy_tile(15), x, y, 5.0), 0, 1)
    green = mixed(column([0.060, 0.110, 0.026]), column([0.150, 0.150, 0.055]), dry)
    return np.asarray(green * np.maximum(tone, 0.25))


def paving(
    x: Float32, y: Float32, base: Float32, footprint: tuple[Float32, Float32]
) -> Float32:
    """(3, N) linear colours of a sidewalk of slabs."""
    along, across = footprint
    row, column = np.floor(x / 0.8).astype(np.int32), np.floor(y / 0.6).astype(np.int32)
    u, v = wrapped(x, 0.8), wrapped(y, 0.6)
    joint = np.maximum(
        coverage(0.012 - np.minimum(u, 0.8 - u), along),
        coverage(0.012 - np.minimum(v, 0.6 - v), across),
    )
    near = 1 / (1 + (along * 6) ** 2)
    tone = 1 + 0.07 * sample(cloudy_tile(31), x, y, 15.0)
    tone += 0.06 * near * sample(grain_tile(32), x, y, 45.0)
    slab = sample(
        grain_tile(33), row.astype(np.float32), column.astype(np.float32), 1.0
    )
    tone += 0.055 * np.clip(slab, -2, 2) * near - 0.42 * joint * near
    return np.asarray(base * np.maximum(tone, 0.2))


def ground_footprint(
    ray: Float32, metres_per_pixel: Float32
) -> tuple[Float32, Float32]:
    """Metres of level ground per pixel along x and y, for rays (3, N).

    Rays that graze the ground see far along their own direction.
    """
    steep = np.maximum(np.abs(ray[2]), np.float32(1e-3))
    stretch = 1 / steep - 1
    return (
        metres_per_pixel * (1 + np.abs(ray[0]) * stretch),
        metres_per_pixel * (1 + np.abs(ray[1]) * stretch),
    )
