"""What CARLA hands out of a moment: the camera and the boxes, hidden ones too."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from app.demo.things import Thing
from app.demo.town import TownStyle
from filter_core.geometry.box3d import boxes3d_vertices
from filter_core.geometry.camera import Camera
from filter_core.geometry.pose import Transform
from filter_core.geometry.projection import project_boxes
from filter_core.types import FloatArray

WIDTH: Final = 1280
HEIGHT: Final = 720
FOV: Final = 90.0
CARLA_VERSION: Final = "0.9.15"
MAX_DISTANCE: Final = 200.0
FIRST_ACTOR: Final = 100


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
    boxed = [index for index, thing in enumerate(things) if thing.has_box]
    rows = [
        (*poses[index].location, *poses[index].rotation, *centre, *half, 0, 0, 0)
        for index in boxed
        for centre, half in [things[index].box]
    ]
    vertices = boxes3d_vertices(np.array(rows))
    distance = np.linalg.norm(vertices.mean(axis=1) - camera.position, axis=1)
    return [
        PlacedBox(index, things[index], poses[index], corners, float(metres))
        for index, corners, metres in zip(boxed, vertices, distance, strict=True)
        if metres <= MAX_DISTANCE
    ]


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
        "boxes": [
            _with_rectangle(box, camera) if flat else _with_box3d(box) for box in boxes
        ],
    }


def _named(box: PlacedBox) -> dict[str, Any]:
    thing = box.thing
    names = {
        "id": box.id,
        "class": thing.class_name,
        "type_id": thing.type_id,
        "instance_id": thing.instance,
    }
    return {**names, "base_type": thing.base_type} if thing.base_type else names


def _with_box3d(box: PlacedBox) -> dict[str, Any]:
    centre, half = box.thing.box
    pose = {name: round(value, 5) for name, value in box.pose.as_dict().items()}
    box3d = {
        "transform": pose,
        "location": _xyz(centre),
        "extent": _xyz(half),
        "rotation": {"pitch": 0.0, "yaw": 0.0, "roll": 0.0},
    }
    return {**_named(box), "box3d": box3d}


def _with_rectangle(box: PlacedBox, camera: Camera) -> dict[str, Any]:
    """The tutorials' rectangle, which knows nothing of what is behind the camera.

    Corners behind it come out mirrored, so that a box beside or behind the camera
    becomes a beam across the image or a rectangle somewhere in it.
    """
    naive = project_boxes(box.vertices, camera, mode="naive").amodal_xyxy[0]
    distance = round(box.distance, 3)
    return {**_named(box), "xyxy": _rounded(naive, 2), "distance": distance}


def _xyz(vector: FloatArray) -> dict[str, float]:
    return dict(zip("xyz", _rounded(vector, 5), strict=True))


def _rounded(values: FloatArray, digits: int) -> list[float]:
    return [round(float(value), digits) for value in values]
