"""3D boxes as the camera sees them: rectangles, edges to draw, distances.

`project_boxes` takes corners in metres and a camera, and returns rectangles and edges
in pixels. A box that reaches behind the camera is clipped by the near plane before
dividing by depth. All clipping is exact: rectangles are as small as possible.
`BoxGeometry` holds the results for all boxes of a frame, 2D boxes included.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from itertools import combinations
from typing import Final, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from filter_core.arrays import BoolArray, BoxesXYXY, FloatArray
from filter_core.errors import FilterError
from filter_core.frame_boxes import ProjectionMode
from filter_core.geometry.box3d import EDGES, as_vertices, in_carla_order
from filter_core.geometry.camera import Camera

NEAR_PLANE: Final = 0.1
"""Metres; Unreal's near plane is at 10 cm."""

_NAIVE_START: Final = 10_000.0
"""px; where the paper's code starts its minimum; its maximum starts at minus this."""

_NAIVE_LIMIT: Final = 1e9
"""px; keeps the rectangle finite when a corner lies exactly in the camera's plane."""


class DepthStatus(IntEnum):
    """Where a box lies relative to the near plane."""

    IN_FRONT = 0
    STRADDLES_NEAR_PLANE = 1
    BEHIND = 2


@dataclass(frozen=True, eq=False)
class Projections:
    """N boxes as the camera sees them.

    Attributes
    ----------
    visible_xyxy : (N, 4) float64, px
        Around the part inside the image; NaN rows where there is none.
    amodal_xyxy : (N, 4) float64, px
        Before clipping to the image; NaN rows for boxes behind the near plane.
    edges : list of N (E, 4) float64 arrays, px
        ``x1 y1 x2 y2`` of the up to twelve edges, clipped to the image.
    distance : (N,) float64, metres
        From the camera to the box's centre.
    status : (N,) uint8, `DepthStatus`
    """

    visible_xyxy: BoxesXYXY
    amodal_xyxy: BoxesXYXY
    edges: list[FloatArray]
    distance: FloatArray
    status: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.distance)


@dataclass(frozen=True, eq=False)
class Projection:
    """One box as the camera sees it; see `Projections`.

    Rectangles are (4,) float64, px, or None where there is nothing; `edges` are (E, 4)
    float64, px; `distance` is in metres.
    """

    visible_xyxy: FloatArray | None
    amodal_xyxy: FloatArray | None
    edges: FloatArray
    distance: float
    status: DepthStatus


@dataclass(frozen=True, eq=False)
class BoxGeometry:
    """N boxes, usually all of a frame, in their image; NaN where unknown.

    Attributes
    ----------
    xyxy : (N, 4) float64, px
        What the filter corrects and measures: the rectangle as given, or as projected
        from a 3D box; a rectangle outside of the image if the camera sees nothing of
        it. NaN rows if made by `loaded`.
    amodal_xyxy, visible_xyxy : (N, 4) float64, px
        Of 3D boxes, before and after clipping to the image; NaN rows for 2D boxes and
        where there is nothing.
    edges : list of N (E, 4) float64 arrays, px, or None
        Clipped edges to draw; None for 2D boxes.
    distance : (N,) float64, metres
        As given, else from the camera to the 3D box's centre, else NaN.
    vertices : (N, 8, 3) float64, metres
        World corners of 3D boxes; NaN rows for 2D boxes, or if made by `loaded`.
    """

    xyxy: BoxesXYXY
    amodal_xyxy: BoxesXYXY
    visible_xyxy: BoxesXYXY
    edges: list[FloatArray | None]
    distance: FloatArray
    vertices: FloatArray

    def __len__(self) -> int:
        return len(self.xyxy)

    @classmethod
    def loaded(
        cls,
        amodal_xyxy: BoxesXYXY,
        visible_xyxy: BoxesXYXY,
        edges: list[FloatArray | None],
    ) -> BoxGeometry:
        """N boxes of which only these numbers were stored; NaN for everything else.

        The parameters are the attributes of these names. The NaN arrays are read-only
        broadcast arrays, which take no memory.
        """
        count = len(edges)
        return cls(
            xyxy=np.broadcast_to(np.nan, (count, 4)),
            amodal_xyxy=amodal_xyxy,
            visible_xyxy=visible_xyxy,
            edges=edges,
            distance=np.broadcast_to(np.nan, count),
            vertices=np.broadcast_to(np.nan, (count, 8, 3)),
        )


def project_boxes(
    vertices: ArrayLike, camera: Camera, mode: ProjectionMode = "clipped"
) -> Projections:
    """Rectangles and edges of 3D boxes in the image.

    Parameters
    ----------
    vertices : (N, 8, 3), metres
        World corners, in any order: the shape is their convex hull.
    mode : ProjectionMode
        ``clipped``: the shape is clipped by the near plane and the image *before*
        minimum and maximum. ``naive``: the paper's minimum and maximum over the eight
        projected corners without a test of their depth; a corner behind the camera
        can stretch the rectangle across the image.

    Raises
    ------
    FilterError
        ``bad_shape``: no array of eight points per box; ``bad_projection``: unknown
        mode.

    Notes
    -----
    Float64 throughout; the rectangles are exact up to rounding (within 0.05 px of
    reference polygon clipping). Edges need CARLA's order; corners in another order are
    put into it first.
    """
    if mode not in get_args(ProjectionMode):
        expected = " or ".join(get_args(ProjectionMode))
        raise FilterError(
            f"projection: expected {expected}, found {mode!r}", code="bad_projection"
        )
    boxes = as_vertices(vertices)
    wh = (camera.width, camera.height)
    image_points = to_image_points(boxes, camera)
    status = _depth_status(image_points[..., 2])
    if mode == "naive":
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            pixels = image_points[..., :2] / image_points[..., 2:]
        # The paper's comparisons are false for NaN, as fmin and fmax ignore it.
        low = np.fmin.reduce(pixels, axis=1, initial=_NAIVE_START)
        high = np.fmax.reduce(pixels, axis=1, initial=-_NAIVE_START)
        bounds: BoxesXYXY = np.concatenate([low, high], axis=1)
        amodal = bounds.clip(-_NAIVE_LIMIT, _NAIVE_LIMIT)
        visible: BoxesXYXY = amodal.clip(0.0, [*wh, *wh])
        outside = (amodal[:, :2] > wh).any(axis=1) | (amodal[:, 2:] < 0).any(axis=1)
        visible[outside] = np.nan
    else:
        amodal, visible = _clipped_bounds(image_points, status, wh)
    drawn = to_image_points(in_carla_order(boxes), camera)
    # For each box, (E, 4) px: the parts of its twelve edges inside the image
    u, v, depth = np.moveaxis(drawn, -1, 0)
    planes = [depth - NEAR_PLANE, u, wh[0] * depth - u, v, wh[1] * depth - v]
    distance = np.stack(planes, axis=-1)
    first, second = EDGES.T
    enter, leave, inside = _clip_segments(distance[:, first], distance[:, second])
    start = drawn[:, first][inside]
    step = drawn[:, second][inside] - start
    ends = [start + share[inside, None] * step for share in (enter, leave)]
    lines = np.concatenate([end[:, :2] / end[:, 2:] for end in ends], axis=1)
    # Rounding can leave a clipped end slightly outside.
    lines = lines.clip(0.0, [*wh, *wh])
    return Projections(
        visible_xyxy=visible,
        amodal_xyxy=amodal,
        edges=(
            np.split(lines, np.cumsum(inside.sum(axis=1))[:-1]) if len(inside) else []
        ),
        distance=np.linalg.norm(boxes.mean(axis=1) - camera.position, axis=1),
        status=status,
    )


def project_box(
    vertices: ArrayLike, camera: Camera, mode: ProjectionMode = "clipped"
) -> Projection:
    """One box of (8, 3) corners, metres, as the camera sees it.

    It is `project_boxes` for one. Rectangles are (4,) float64 ``xyxy``, or None where
    there is nothing. Raises `FilterError`: ``bad_shape``, ``bad_projection``.
    """
    many = project_boxes(vertices, camera, mode)
    return Projection(
        visible_xyxy=_row_or_none(many.visible_xyxy[0]),
        amodal_xyxy=_row_or_none(many.amodal_xyxy[0]),
        edges=many.edges[0],
        distance=float(many.distance[0]),
        status=DepthStatus(int(many.status[0])),
    )


def _row_or_none(row: FloatArray) -> FloatArray | None:
    return None if np.isnan(row).any() else row


def hull_points(vertices: ArrayLike, camera: Camera) -> list[FloatArray]:
    """N of (P, 2) float64, px: points whose convex hull is each box in the image plane.

    `vertices` are (N, 8, 3), metres. Clipped by the near plane, not by the image; empty
    for boxes behind it.
    """
    boxes = as_vertices(vertices)
    image_points = to_image_points(boxes, camera)
    status = _depth_status(image_points[..., 2])
    points = []
    for corners, where in zip(image_points, status.tolist(), strict=True):
        if where == DepthStatus.BEHIND:
            points.append(np.empty((0, 2)))
            continue
        if where == DepthStatus.STRADDLES_NEAR_PLANE:
            corners = _cut_hull(corners[None], corners[None, :, 2] - NEAR_PLANE)[0]
        points.append(corners[:, :2] / corners[:, 2:])
    return points


def image_corners_xyxy(corners: ArrayLike) -> BoxesXYXY:
    """(N, 4) float64, px: rectangles around boxes whose corners were projected before.

    `corners` (N, 8, 3) are x and y in px, and the depth in metres, in any order. Not
    clipped by the image, but by the near plane, as `Projections.amodal_xyxy`; NaN rows
    for boxes behind it.
    """
    boxes = as_vertices(corners)
    depth = boxes[..., 2:]
    points = np.concatenate([boxes[..., :2] * depth, depth], axis=2)
    amodal, _ = _clipped_bounds(points, _depth_status(points[..., 2]), (1, 1))
    return amodal


def forward_distances(vertices: FloatArray, camera: Camera) -> FloatArray:
    """(N,) float64, metres: how far ahead the centres of 3D boxes are, along the axis.

    `vertices` is (N, 8, 3), in metres; a row of NaN gives NaN. Negative is behind it.
    """
    centres = vertices.mean(axis=1, keepdims=True)
    forward: FloatArray = to_image_points(centres, camera)[:, 0, 2]
    return forward


def to_image_points(boxes: FloatArray, camera: Camera) -> FloatArray:
    """(N, P, 3) float64: ``u depth, v depth, depth`` of (N, P, 3) world points.

    World points and depth are in metres, u and v in px.
    """
    matrix = camera.world_to_image
    points: FloatArray = boxes @ matrix[:, :3].T + matrix[:, 3]
    return points


def _depth_status(depth: FloatArray) -> NDArray[np.uint8]:
    in_front = (depth >= NEAR_PLANE).sum(axis=1)
    return np.select(
        [in_front == 8, in_front == 0],
        [DepthStatus.IN_FRONT, DepthStatus.BEHIND],
        default=DepthStatus.STRADDLES_NEAR_PLANE,
    ).astype(np.uint8)


def _clipped_bounds(
    image_points: FloatArray, status: NDArray[np.uint8], wh: tuple[int, int]
) -> tuple[BoxesXYXY, BoxesXYXY]:
    amodal = np.full((len(image_points), 4), np.nan)
    visible = amodal.copy()
    for group in (DepthStatus.IN_FRONT, DepthStatus.STRADDLES_NEAR_PLANE):
        rows = np.flatnonzero(status == group)
        if len(rows) == 0:
            continue
        corners = image_points[rows]
        if group is DepthStatus.STRADDLES_NEAR_PLANE:
            corners = _cut_hull(corners, corners[..., 2] - NEAR_PLANE)
        pixels = corners[..., :2] / corners[..., 2:]
        # (N, 4) ``xyxy``: the smallest rectangles around (N, P, 2) points
        amodal[rows] = np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1)
        # The smallest rectangles around the parts of convex shapes inside the image
        x_low, x_high = _range_in_strip(pixels, axis=0, limit=wh[1])
        y_low, y_high = _range_in_strip(pixels, axis=1, limit=wh[0])
        low = np.maximum(np.stack([x_low, y_low], axis=1), 0.0)
        high = np.minimum(np.stack([x_high, y_high], axis=1), wh)
        bounds = np.concatenate([low, high], axis=1)
        bounds[(low > high).any(axis=1)] = np.nan
        visible[rows] = bounds
    return amodal, visible


_MAX_CORNERS: Final = 20
"""A plane cuts 8 points into k and 8 - k: at most ``k + k (8 - k)`` corners, k = 4."""


_PAIRS: Final = {
    count: np.array(list(combinations(range(count), 2)), dtype=np.int64)
    for count in (8, _MAX_CORNERS)
}
"""(count (count - 1) / 2, 2): every segment between so many points."""


def _cut_hull(points: FloatArray, distance: FloatArray) -> FloatArray:
    """(N, `_MAX_CORNERS`, D): points whose hull is that of points after a cut.

    The points that are cut by one plane are (N, 8, D). `distance` (N, 8) is from the
    plane, 0 and more is kept; at least one point of each row must be. Padded by
    repeating a kept point.

    Notes
    -----
    Every edge of the hull is among the 28 segments between its points, and every such
    segment lies within the hull: the order of the points does not matter.
    """
    first, second = _PAIRS[8].T
    d_first, d_second = distance[:, first], distance[:, second]
    crosses = (d_first >= 0) != (d_second >= 0)
    share = d_first / np.where(crosses, d_first - d_second, 1.0)
    crossing = points[:, first] + share[..., None] * (
        points[:, second] - points[:, first]
    )
    candidates = np.concatenate([points, crossing], axis=1)
    kept = np.concatenate([distance >= 0, crosses], axis=1)
    order = np.argsort(~kept, axis=1, kind="stable")[:, :_MAX_CORNERS]
    order = np.where(np.take_along_axis(kept, order, axis=1), order, order[:, :1])
    return np.take_along_axis(candidates, order[..., None], axis=1)


def _range_in_strip(
    points: FloatArray, *, axis: int, limit: int
) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest `axis` where the other axis is within 0..limit."""
    first, second = _PAIRS[points.shape[1]].T
    along, across = points[..., axis], points[..., 1 - axis]
    distance = np.stack([across, limit - across], axis=-1)
    enter, leave, inside = _clip_segments(distance[:, first], distance[:, second])
    start, step = along[:, first], along[:, second] - along[:, first]
    ends = np.stack([start + enter * step, start + leave * step])
    # Rounding must not move an end beyond the corners themselves.
    np.clip(ends, along.min(axis=1)[:, None], along.max(axis=1)[:, None], out=ends)
    low = np.where(inside, ends, np.inf).min(axis=(0, 2))
    high = np.where(inside, ends, -np.inf).max(axis=(0, 2))
    return low, high


def _clip_segments(
    start: FloatArray, end: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """The part of segments that lies inside half-spaces.

    `start` and `end` (..., H) are signed distances of both ends from H planes, 0 and
    more inside. They must be linear along the segment; any positive scale per plane
    will do. Returned are (...), 0..1: the part inside runs from ``start + enter (end -
    start)`` to ``leave``; and (...), bool: whether anything is inside.

    References
    ----------
    .. [1] Y.-D. Liang, B. Barsky, "A New Concept and Method for Line Clipping",
       ACM Transactions on Graphics 3(1), 1984.
    """
    # Where both ends are on one side, a tiny step would overflow the division.
    crosses = (start < 0) != (end < 0)
    crossing = start / np.where(crosses, start - end, 1.0)
    enter = np.where(start < 0, crossing, 0.0).max(axis=-1)
    leave = np.where(end < 0, crossing, 1.0).min(axis=-1)
    wholly_out = ((start < 0) & (end < 0)).any(axis=-1)
    return enter, leave, ~wholly_out & (enter <= leave)
