"""Which boxes are ghosts, and why: known, because the street is made up."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from app.demo.annotation import PlacedBox
from app.demo.exposure import Planes
from app.demo.paint import Tag
from app.demo.view import to_homogeneous
from filter_core.geometry.camera import Camera
from filter_core.geometry.projection import DepthStatus, project_boxes
from filter_core.types import FloatArray

FAR_AWAY_M: Final = 150.0
GHOST_KINDS: Final = (
    "behind_camera",
    "partly_behind_camera",
    "outside_image",
    "far_away",
    "behind_building",
    "behind_wall",
    "behind_vegetation",
    "behind_same_class",
    "behind_other",
)
_HIDERS: Final = {
    Tag.BUILDING: "behind_building",
    Tag.WALL: "behind_wall",
    Tag.FENCE: "behind_wall",
    Tag.VEGETATION: "behind_vegetation",
}


def visible_pixels(planes: Planes, boxes: list[PlacedBox], things: int) -> list[int]:
    """Per box, the pixels of its own thing that carry a tag its class accepts.

    A traffic light whose upright alone is seen (tagged Pole) is therefore not visible.
    """
    own = planes.owner >= 0
    owner, tag = planes.owner[own], planes.tags[own]
    accepted = np.zeros(things, dtype=np.int64)
    for box in boxes:
        accepted[box.index] = box.thing.accept_mask
    counted = owner[(accepted[owner] >> tag) & 1 == 1]
    counts = np.bincount(counted, minlength=things)
    return [int(counts[box.index]) for box in boxes]


def truth_of(
    planes: Planes, boxes: list[PlacedBox], camera: Camera, things: int
) -> list[dict[str, Any]]:
    """One line per box: how much is seen, and what kind of ghost it is if nothing."""
    counts = visible_pixels(planes, boxes, things)
    vertices = np.array([box.vertices for box in boxes])
    seen = project_boxes(vertices, camera)
    image_points = to_homogeneous(vertices, camera)
    lines = []
    for row, (box, count) in enumerate(zip(boxes, counts, strict=True)):
        ghost = None
        if not count:
            nearest = float(image_points[row, :, 2].min())
            status = DepthStatus(int(seen.status[row]))
            ghost = _kind_by_place(status, seen.visible_xyxy[row], box.distance)
            ghost = ghost or _hidden_by(box, nearest, planes, seen.visible_xyxy[row])
        lines.append(_line(box, count, ghost))
    return lines


def _line(box: PlacedBox, count: int, ghost: str | None) -> dict[str, Any]:
    return {
        "id": box.id,
        "class": box.thing.class_name,
        "instance": box.thing.instance,
        "distance": round(box.distance, 3),
        "visible_pixels": count,
        "visible": count > 0,
        "ghost": ghost,
    }


def _kind_by_place(
    status: DepthStatus, visible_xyxy: FloatArray, distance: float
) -> str | None:
    """The kind of a ghost that lies where the camera does not look, or far off."""
    if status is DepthStatus.BEHIND:
        return "behind_camera"
    if status is DepthStatus.STRADDLES_NEAR_PLANE:
        return "partly_behind_camera"
    if np.isnan(visible_xyxy).any():
        return "outside_image"
    return "far_away" if distance > FAR_AWAY_M else None


def _hidden_by(
    box: PlacedBox, nearest: float, planes: Planes, visible_xyxy: FloatArray
) -> str:
    """What covers most of the box's rectangle and is nearer than the box."""
    x0, y0 = np.floor(visible_xyxy[:2]).astype(int)
    x1, y1 = np.ceil(visible_xyxy[2:]).astype(int)
    in_front = planes.depth[y0:y1, x0:x1] < nearest
    tags: NDArray[np.uint8] = planes.tags[y0:y1, x0:x1][in_front]
    counts = np.bincount(tags, minlength=32)
    accepted = (box.thing.accept_mask >> np.arange(32)) & 1
    best, most = "behind_other", 0
    for tag, kind in _HIDERS.items():
        if counts[tag] > most:
            best, most = kind, int(counts[tag])
    return "behind_same_class" if counts[:32] @ accepted > most else best
