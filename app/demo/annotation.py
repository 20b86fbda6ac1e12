"""What CARLA hands out of a moment: the camera and the boxes, hidden ones too."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from app.demo.things import Thing
from app.demo.town import TownStyle
from filter_core.camera import Camera
from filter_core.pose import Transform
from filter_core.types import FloatArray

WIDTH: Final = 1280
HEIGHT: Final = 720
FOV: Final = 90.0
CARLA_VERSION: Final = "0.9.15"
MAX_DISTANCE: Final = 200.0
FIRST_ACTOR: Final = 100
_EXTREME_PX: Final = 1e6


@dataclass(frozen=True, eq=False)
class PlacedBox:
    """A thing's box in the world of one frame."""

    index: int
    thing: Thing
    pose: Transform
    vertices: FloatArray
    """(8, 3) world."""
    distance: float
    """Metres from the camera to the box's centre."""

    @property
    def id(self) -> str:
        """The box's id in annotations and truth."""
        return str(FIRST_ACTOR + self.index)


def placed_boxes(
    things: list[Thing], poses: list[Transform], camera: Camera
) -> list[PlacedBox]:
    """The boxes of all things within `MAX_DISTANCE`, seen or not."""
    boxes = []
    for index, (thing, pose) in enumerate(zip(things, poses, strict=True)):
        if not thing.has_box:
            continue
        centre, half = thing.box
        matrix = pose.matrix
        local = np.vstack([centre[None], centre + _CORNERS * half])
        world = local @ matrix[:3, :3].T + matrix[:3, 3]
        distance = float(np.linalg.norm(world[0] - camera.position))
        if distance <= MAX_DISTANCE:
            boxes.append(PlacedBox(index, thing, pose, world[1:], distance))
    return boxes


_CORNERS: Final = np.array(
    [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64
)


def annotate(
    style: TownStyle,
    camera_pose: Transform,
    camera: Camera,
    boxes: list[PlacedBox],
    *,
    flat: bool,
) -> dict[str, Any]:
    """The annotation of one frame; `flat` gives rectangles instead of 3D boxes."""
    return {
        "carla_version": CARLA_VERSION,
        "map": style.name,
        "weather": dict(style.weather),
        "camera": {
            "width": camera.width,
            "height": camera.height,
            "fov": FOV,
            "transform": camera_pose.as_dict(),
        },
        "sensors": {"lidar": {"transform": camera_pose.as_dict()}},
        "boxes": [_box(box, camera, flat=flat) for box in boxes],
    }


def _box(box: PlacedBox, camera: Camera, *, flat: bool) -> dict[str, Any]:
    thing = box.thing
    entry: dict[str, Any] = {
        "id": box.id,
        "class": thing.class_name,
        "type_id": thing.type_id,
    }
    if thing.base_type:
        entry["base_type"] = thing.base_type
    if flat:
        rectangle = naive_rectangle(box.vertices, camera)
        return {
            **entry,
            "xyxy": _rounded(rectangle, 2),
            "distance": round(box.distance, 3),
        }
    centre, half = thing.box
    entry["box3d"] = {
        "transform": {
            name: round(value, 5) for name, value in box.pose.as_dict().items()
        },
        "location": _xyz(centre),
        "extent": _xyz(half),
        "rotation": {"pitch": 0.0, "yaw": 0.0, "roll": 0.0},
    }
    return entry


def naive_rectangle(vertices: FloatArray, camera: Camera) -> FloatArray:
    """(4,) px: the tutorials' way, which knows nothing of what is behind the camera.

    Corners behind it come out mirrored, so that a box beside or behind the camera
    becomes a beam across the image or a rectangle somewhere in it.
    """
    image = camera.world_to_image
    points = vertices @ image[:, :3].T + image[:, 3]
    depth = points[:, 2]
    safe = np.where(np.abs(depth) < 1e-3, 1e-3, depth)
    pixels = np.clip(points[:, :2] / safe[:, None], -_EXTREME_PX, _EXTREME_PX)
    return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])


def _xyz(vector: FloatArray) -> dict[str, float]:
    return dict(zip("xyz", _rounded(vector, 5), strict=True))


def _rounded(values: FloatArray, digits: int) -> list[float]:
    return [round(float(value), digits) for value in values]
