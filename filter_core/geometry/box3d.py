"""Corners of 3D boxes in the world, in the order that CARLA gives them.

`boxes3d_vertices` computes them from poses and half sizes as
``carla.BoundingBox.get_world_vertices`` does; `in_carla_order` puts corners that are
in another order into CARLA's, so that the edges between them are known.
"""

from __future__ import annotations

from itertools import product
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from filter_core.arrays import BoolArray, FloatArray
from filter_core.errors import FilterError
from filter_core.geometry.pose import rotation_matrices

CORNER_SIGNS: Final[FloatArray] = np.array(
    list(product((-1.0, 1.0), repeat=3)), dtype=np.float64
)
"""(8, 3): index bits 4, 2 and 1 are +x, +y and +z of the half extent."""

EDGES: Final = np.array(
    [(a, a | bit) for bit in (1, 2, 4) for a in range(8) if not a & bit]
)
"""(12, 2): pairs of corners that differ in one sign."""

_SHAPE_TOLERANCE: Final = 1e-3
"""How far corners may deviate from a parallelepiped, as a share of the box's size."""


def boxes3d_vertices(rows: ArrayLike) -> FloatArray:
    """(N, 8, 3) float64, metres: world corners of many boxes at once.

    `rows` (N, 15), metres and degrees, have the actor's location and rotation (pitch,
    yaw, roll), zeros for a box that is given in the world; then the box's location,
    extent (half sizes) and rotation within the actor's frame. Extents of zero (CARLA's
    bikes) and mirrored boxes are accepted.
    """
    boxes = np.asarray(rows, dtype=np.float64).reshape(-1, 15)
    actor_location, actor_rotation, centre, extent, rotation = np.hsplit(
        boxes, [3, 6, 9, 12]
    )
    corners = CORNER_SIGNS * extent[:, None]
    in_actor = corners @ _transposed(rotation_matrices(rotation)) + centre[:, None]
    turned = in_actor @ _transposed(rotation_matrices(actor_rotation))
    vertices: FloatArray = turned + actor_location[:, None]
    return vertices


def in_carla_order(vertices: ArrayLike) -> FloatArray:
    """(N, 8, 3) float64, metres: corners in CARLA's order, from corners in any order.

    Always a new array. Which edge of the box becomes which axis is arbitrary, so only
    the *edges* can be relied on. Eight points that are no box in any order stay as they
    are.

    Notes
    -----
    Lines between opposite corners meet in the centre, which gives four pairs. The
    neighbours of the first corner are one corner of each other pair: those whose
    vectors from it add up to the diagonal. Exact for every parallelepiped.
    """
    boxes = np.array(as_vertices(vertices))
    for index in np.flatnonzero(~_is_in_order(boxes)):
        corners = boxes[index]
        # The opposite corner of each corner
        mirrored = 2 * corners.mean(axis=0) - corners
        gaps = np.linalg.norm(mirrored[:, None] - corners[None], axis=2)
        opposite = [-1] * 8
        for i in range(8):
            if opposite[i] < 0:
                # Each corner is taken once, since corners of a flat box coincide.
                free = [j for j in range(8) if j != i and opposite[j] < 0]
                opposite[i] = min(free, key=lambda j: float(gaps[i, j]))
                opposite[opposite[i]] = i
        first, last = 0, opposite[0]
        pairs = [(i, opposite[i]) for i in range(1, 8) if i < opposite[i]]
        choices = np.array(list(product(*pairs)))
        sums = (corners[choices] - corners[first]).sum(axis=1)
        diagonal = corners[last] - corners[first]
        x, y, z = choices[np.linalg.norm(sums - diagonal, axis=1).argmin()].tolist()
        order = [first, z, y, opposite[x], x, opposite[y], opposite[z], last]
        ordered: FloatArray = corners[order]
        boxes[index] = ordered if _is_in_order(ordered[None])[0] else corners
    return boxes


def as_vertices(vertices: ArrayLike) -> FloatArray:
    """(N, 8, 3) float64 from N boxes or one.

    Raises `FilterError` (``bad_shape``): no eight points of three numbers for each box.
    """
    boxes = np.asarray(vertices, dtype=np.float64)
    if boxes.size == 0:
        return boxes.reshape(0, 8, 3)
    if boxes.shape[-2:] != (8, 3) or boxes.ndim > 3:
        raise FilterError(
            f"vertices: expected an array of shape (N, 8, 3), found {boxes.shape}",
            code="bad_shape",
        )
    many: FloatArray = boxes.reshape(-1, 8, 3)
    return many


def _transposed(matrices: FloatArray) -> FloatArray:
    swapped: FloatArray = matrices.transpose(0, 2, 1)
    return swapped


def _is_in_order(boxes: FloatArray) -> BoolArray:
    """(N,) bool: each axis's four edges are the same vector."""
    size = np.abs(boxes - boxes[:, :1]).max(axis=(1, 2), initial=0.0)
    miss = np.zeros(len(boxes))
    for start in range(0, 12, 4):
        first, second = EDGES[start : start + 4].T
        edges = boxes[:, second] - boxes[:, first]
        miss = np.maximum(miss, np.abs(edges - edges[:, :1]).max(axis=(1, 2)))
    in_order: BoolArray = miss <= _SHAPE_TOLERANCE * size
    return in_order
