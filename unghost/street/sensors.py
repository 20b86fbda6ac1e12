"""The measurements of CARLA's sensors in a frame, and the truth about its boxes.

From a frame's planes: segmentation, instances and depth in CARLA's encodings, and a
semantic LiDAR at the camera's place. From the town: the annotation with the boxes of
all things, hidden ones too. The street is made up, so it is known which boxes are
ghosts and why.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from zlib_ng import zlib_ng

from filter_core.arrays import FloatArray, IntArray, TagImage
from filter_core.formats.manifest import SEMANTIC_LIDAR_POINT
from filter_core.geometry.box3d import boxes3d_vertices
from filter_core.geometry.camera import Camera
from filter_core.geometry.pose import Transform
from filter_core.geometry.projection import DepthStatus, project_boxes
from filter_core.images.png import END_CHUNK, SIGNATURE
from filter_core.segmentation.palettes import palette_of
from unghost.street.camera import Planes
from unghost.street.mesh import turned
from unghost.street.paint import FAMILY, Float32, Tag
from unghost.street.raster import to_homogeneous
from unghost.street.town import Thing, TownStyle

WIDTH, HEIGHT, FOV = 1280, 720, 90.0
"""Of the camera: pixels, and degrees from left to right."""
CARLA_VERSION: Final = "0.9.15"
MAX_DISTANCE: Final = 200.0
"""Metres; objects that are farther away get no box."""
FIRST_ACTOR: Final = 100
"""The actor id of a town's first thing."""
RANGE_M: Final = 120.0
"""How far the LiDAR reaches, metres."""
_CHANNELS, _TURNS = 40, 640
"""Beams of the LiDAR one above the other, and side by side within the image."""
_LOWEST, _HIGHEST = -24.0, 8.0
"""Degrees below and above the horizon, as seen by the sensor."""
_DEPTH_STEPS, _DEPTH_RANGE = (1 << 24) - 1, 1000.0
"""Into so many steps CARLA's depth image divides so many metres."""
FAR_AWAY_M: Final = 150.0
"""Metres from which on an unseen box is called far away."""
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


@dataclass(frozen=True, eq=False)
class PlacedBox:
    """The box of a thing at the moment of one frame, in world coordinates."""

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
) -> dict[str, object]:
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
        "boxes": [_annotated(box, camera if flat else None) for box in boxes],
    }


def _annotated(box: PlacedBox, camera: Camera | None) -> dict[str, object]:
    """A box in 3D; with a camera its rectangle, as CARLA's tutorials compute it.

    That is wrong behind the camera: corners there are mirrored, so a box next to or
    behind it becomes a stripe across the image or a rectangle somewhere in it.
    """
    thing = box.thing
    names: dict[str, object] = {
        "id": box.id,
        "class": thing.class_name,
        "type_id": thing.type_id,
        "instance_id": thing.instance,
        **({"base_type": thing.base_type} if thing.base_type else {}),
    }
    if camera is not None:
        naive = project_boxes(box.vertices, camera, mode="naive").amodal_xyxy[0]
        distance = round(box.distance, 3)
        return {**names, "xyxy": _rounded(naive, 2), "distance": distance}
    centre, half = thing.box
    pose = {name: round(value, 5) for name, value in box.pose.as_dict().items()}
    box3d = {
        "transform": pose,
        "location": _xyz(centre),
        "extent": _xyz(half),
        "rotation": {"pitch": 0.0, "yaw": 0.0, "roll": 0.0},
    }
    return {**names, "box3d": box3d}


def _xyz(vector: FloatArray) -> dict[str, float]:
    return dict(zip("xyz", _rounded(vector, 5), strict=True))


def _rounded(values: FloatArray, digits: int) -> list[float]:
    return [round(float(value), digits) for value in values]


def paint_tags(tags: TagImage) -> NDArray[np.uint8]:
    """(H, W, 3): tags in CARLA's palette colours."""
    return palette_of(FAMILY).paint(tags)


def encode_instances(tags: TagImage, instances: NDArray[np.int32]) -> NDArray[np.uint8]:
    """(H, W, 3): red is the tag, the number is green + 256 blue."""
    return np.stack([tags, instances & 255, instances >> 8], axis=-1).astype(np.uint8)


def encode_depth(depth: Float32) -> NDArray[np.uint8]:
    """(H, W, 3): metres = 1000 (R + 256 G + 65536 B) / (2^24 - 1)."""
    share = np.clip(depth.astype(np.float64) / _DEPTH_RANGE, 0, 1)
    steps = np.rint(share * _DEPTH_STEPS).astype(np.int32)
    return np.stack([steps & 255, (steps >> 8) & 255, steps >> 16], axis=-1).astype(
        np.uint8
    )


def png(rgb: NDArray[np.uint8]) -> bytes:
    """An RGB image (H, W, 3) as a PNG file.

    OpenCV would take three times as long, in zlib. Each pixel is written as what it
    differs by from the one to its left (filter type 1 of the PNG specification, 9.2).
    """
    height, width, _ = rgb.shape
    rows = np.empty((height, 1 + 3 * width), dtype=np.uint8)
    rows[:, 0] = 1
    rows[:, 1:4] = rgb[:, 0]
    differences = rows[:, 4:].reshape(height, -1, 3)
    np.subtract(rgb[:, 1:], rgb[:, :-1], out=differences)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = zlib_ng.compress(rows, 2)
    chunks = [
        struct.pack(">I", len(data))
        + kind
        + data
        + struct.pack(">I", zlib_ng.crc32(data, zlib_ng.crc32(kind)))
        for kind, data in ((b"IHDR", header), (b"IDAT", body))
    ]
    return b"".join((SIGNATURE, *chunks, END_CHUNK))


def scan(planes: Planes, camera: Camera, ids: IntArray) -> NDArray[np.void]:
    """(P,) points in the sensor's axes: x forward, y right, z up.

    `ids` are (things + 1,): the actor of each thing; the last one is that of sky and
    ground.
    """
    focal = float(camera.intrinsic[0, 0])
    row, column = _targets(camera, focal)
    depth = planes.depth[row, column].astype(np.float64)
    right = (column + 0.5 - camera.width / 2) / focal
    up = (camera.height / 2 - row - 0.5) / focal
    place = np.stack([np.ones_like(right), right, up], axis=1) * depth[:, None]
    length = np.linalg.norm(place, axis=1)
    hit = np.flatnonzero(length <= RANGE_M)
    points = np.zeros(len(hit), dtype=SEMANTIC_LIDAR_POINT)
    for axis, name in enumerate("xyz"):
        points[name] = place[hit, axis]
    towards = place[hit] / length[hit, None]
    normals = planes.normals[:, row[hit], column[hit]].T.astype(np.float64)
    local = turned(normals, camera.world_to_camera[:3, :3])
    points["CosAngle"] = np.abs(np.sum(towards * local, axis=1))
    points["ObjIdx"] = ids[planes.owner[row[hit], column[hit]]]
    points["ObjTag"] = planes.tags[row[hit], column[hit]]
    return points


def _targets(camera: Camera, focal: float) -> tuple[IntArray, IntArray]:
    """The pixels that the beams hit, of those that lie within the image."""
    half = np.degrees(np.arctan(camera.width / 2 / focal))
    turn = np.radians(np.linspace(-half, half, _TURNS))
    tilt = np.radians(np.linspace(_LOWEST, _HIGHEST, _CHANNELS))
    right = np.broadcast_to(np.tan(turn), (_CHANNELS, _TURNS))
    up = np.tan(tilt)[:, None] / np.cos(turn)
    column = np.floor(right * focal + camera.width / 2).astype(np.int64)
    row = np.floor(camera.height / 2 - up * focal).astype(np.int64)
    inside = (
        (row >= 0) & (row < camera.height) & (column >= 0) & (column < camera.width)
    )
    return row[inside], column[inside]


def npy(points: NDArray[np.void]) -> bytes:
    """The points as a .npy file."""
    buffer = io.BytesIO()
    np.save(buffer, points)
    return buffer.getvalue()


def truth_of(
    planes: Planes, boxes: list[PlacedBox], camera: Camera, things: int
) -> list[dict[str, object]]:
    """One line per box: how much is seen, and what kind of ghost it is if nothing."""
    counts = visible_pixels(planes, boxes, things)
    vertices = np.array([box.vertices for box in boxes])
    seen = project_boxes(vertices, camera)
    image_points = to_homogeneous(vertices, camera)
    lines = []
    for row, (box, count) in enumerate(zip(boxes, counts, strict=True)):
        ghost, rectangle = None, seen.visible_xyxy[row]
        if not count:
            nearest = float(image_points[row, :, 2].min())
            status = DepthStatus(int(seen.status[row]))
            ghost = _kind_by_place(status, rectangle, box.distance)
            ghost = ghost or _hidden_by(box, nearest, planes, rectangle)
        lines.append(
            {
                "id": box.id,
                "class": box.thing.class_name,
                "instance": box.thing.instance,
                "distance": round(box.distance, 3),
                "visible_pixels": count,
                "visible": count > 0,
                "ghost": ghost,
            }
        )
    return lines


def visible_pixels(planes: Planes, boxes: list[PlacedBox], things: int) -> list[int]:
    """For each box, how many pixels show its thing with a tag that its class accepts.

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
    """The thing that covers most of the box's rectangle and is nearer than the box."""
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


_HIDERS: Final = {
    Tag.BUILDING: "behind_building",
    Tag.WALL: "behind_wall",
    Tag.FENCE: "behind_wall",
    Tag.VEGETATION: "behind_vegetation",
}
