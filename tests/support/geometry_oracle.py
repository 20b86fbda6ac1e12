"""Turns cases of known projections into cameras and boxes, and measures the error."""

import json
from typing import Any

import numpy as np

from filter_core.arrays import FloatArray
from filter_core.geometry.box3d import boxes3d_vertices
from filter_core.geometry.camera import Camera
from filter_core.geometry.pose import as_transform, read_rotation, read_vector
from filter_core.values import Faults, Place
from tests.support.sources import CHECKOUT

Case = dict[str, Any]

SMALL: list[Case] = json.loads(
    (CHECKOUT / "tests" / "data" / "geometry_cases.json").read_text()
)


def camera_of(case: Case) -> Camera:
    """The case's camera."""
    image = case["image"]
    size = (image["width"], image["height"])
    return Camera.from_fov(*size, image["fov"], case["camera"])


def box3d_vertices(transform, location, extent, rotation) -> FloatArray:
    """The eight world corners of a box; each part may have any accepted form."""
    actor, faults = as_transform(transform), Faults()
    parts = [
        actor.location,
        actor.rotation,
        read_vector(location, Place(), faults),
        read_vector(extent, Place(), faults),
        read_rotation(rotation, Place(), faults),
    ]
    faults.raise_any()
    row = [number for part in parts for number in part or ()]
    corners: FloatArray = boxes3d_vertices([row])[0]
    return corners


def vertices_of(case: Case) -> FloatArray:
    """The case's eight corners, from the actor's transform and the local box."""
    box = case["bounding_box"]
    local = (box["location"], box["extent"], box["rotation"])
    return box3d_vertices(case["actor"], *local)


def miss(corners: FloatArray | None, expected: list[float] | None) -> float:
    """The largest difference in px; infinite if only one rectangle exists."""
    if corners is None or expected is None:
        return 0.0 if corners is None and expected is None else np.inf
    return float(np.abs(corners - expected).max())
