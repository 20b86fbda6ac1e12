"""Which boxes are ghosts, and why: known, because the street is made up."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from app.demo.annotation import PlacedBox
from app.demo.exposure import Planes
from app.demo.paint import Tag
from app.demo.view import NEAR
from filter_core.camera import Camera
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
    key: str, planes: Planes, boxes: list[PlacedBox], camera: Camera, things: int
) -> list[dict[str, Any]]:
    """One line per box: how much is seen, and what kind of ghost it is if nothing."""
    counts = visible_pixels(planes, boxes, things)
    return [
        {
            "key": key,
            "id": box.id,
            "class": box.thing.class_name,
            "instance": box.thing.instance,
            "distance": round(box.distance, 3),
            "visible_pixels": count,
            "visible": count > 0,
            "ghost": None if count else ghost_kind(box, planes, camera),
        }
        for box, count in zip(boxes, counts, strict=True)
    ]


def ghost_kind(box: PlacedBox, planes: Planes, camera: Camera) -> str:
    """Why a box without a visible pixel has none."""
    image = camera.world_to_image
    points = box.vertices @ image[:, :3].T + image[:, 3]
    if (points[:, 2] < NEAR).all():
        return "behind_camera"
    if (points[:, 2] < NEAR).any():
        return "partly_behind_camera"
    window = _window(points[:, :2] / points[:, 2:], camera)
    if window is None:
        return "outside_image"
    if box.distance > FAR_AWAY_M:
        return "far_away"
    return _hidden_by(box, float(points[:, 2].min()), planes, window)


def _window(pixels: FloatArray, camera: Camera) -> tuple[slice, slice] | None:
    low = np.clip(np.floor(pixels.min(axis=0)), 0, (camera.width, camera.height))
    high = np.clip(np.ceil(pixels.max(axis=0)), 0, (camera.width, camera.height))
    if (high <= low).any():
        return None
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def _hidden_by(
    box: PlacedBox, nearest: float, planes: Planes, window: tuple[slice, slice]
) -> str:
    """What covers most of the box's rectangle and is nearer than the box."""
    in_front = planes.depth[window] < nearest
    tags: NDArray[np.uint8] = planes.tags[window][in_front]
    counts = np.bincount(tags, minlength=256)
    accepted = (box.thing.accept_mask >> np.arange(32)) & 1
    same = int(counts[:32][accepted == 1].sum())
    best, most = "behind_other", 0
    for tag, kind in _HIDERS.items():
        if counts[tag] > most:
            best, most = kind, int(counts[tag])
    return "behind_same_class" if same > most else best
