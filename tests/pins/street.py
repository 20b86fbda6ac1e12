"""Three tiny frames with every kind of sensor, drawn with whole numbers.

No library renders or compresses anything here, and nothing is rotated: the same bytes
come out on every machine and with every version of numpy, OpenCV and zlib. The camera
looks along x with a focal length of 48 px, 1.5 m above the road.
"""

import io
import struct
import zlib
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from filter_core.segmentation.palettes import FAMILIES
from tests.support.pictures import chunk, png_of_chunks

WIDTH, HEIGHT, FOCAL, EYE = 96, 64, 48, 1.5
FAMILY: Final = "carla-0.9.14"
FRAMES: Final = 3
TAGS: Final = {"car": 14, "truck": 15, "walker": 12, "building": 3}
_SKY, _ROAD = 11, 1
_STORED_BLOCK: Final = 0xFFFF
POINT: Final = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "CosAngle")]
    + [(name, "<u4") for name in ("ObjIdx", "ObjTag")]
)


@dataclass(frozen=True)
class Thing:
    """A cuboid: its kind, its centre in metres from the camera, and half its size."""

    id: str
    kind: str
    instance: int
    centre: tuple[float, float, float]
    half: tuple[float, float, float]
    is_drawn: bool = True

    @property
    def near(self) -> float:
        """The distance in metres of the side that faces the camera."""
        return self.centre[0] - self.half[0]

    @property
    def front(self) -> tuple[int, int, int, int]:
        """The rectangle of the same side in the image, in pixels."""
        (_, y, z), (_, half_y, half_z) = self.centre, self.half
        across = [
            WIDTH / 2 + FOCAL * side / self.near for side in (y - half_y, y + half_y)
        ]
        up = [
            HEIGHT / 2 - FOCAL * (top - EYE) / self.near
            for top in (z + half_z, z - half_z)
        ]
        x0, x1 = (min(max(round(each), 0), WIDTH) for each in across)
        y0, y1 = (min(max(round(each), 0), HEIGHT) for each in up)
        return x0, y0, x1, y1

    def as_box(self) -> dict[str, Any]:
        """The box of an annotation for this cuboid."""
        still = {"pitch": 0.0, "yaw": 0.0, "roll": 0.0}
        x, y, _ = self.centre
        height = {"x": 0.0, "y": 0.0, "z": self.centre[2]}
        extent = dict(zip("xyz", self.half, strict=True))
        transform = {"x": x, "y": y, "z": 0.0, **still}
        box3d = {"transform": transform, "location": height, "extent": extent}
        return {
            "id": self.id,
            "class": self.kind,
            "instance_id": self.instance,
            "box3d": {**box3d, "rotation": still},
        }


@dataclass(frozen=True)
class Frame:
    """What is uploaded for a frame: key, annotation, and files by kind."""

    key: str
    annotation: dict[str, Any]
    files: dict[str, bytes]


def frames() -> list[Frame]:
    """All three frames, in order."""
    return [_frame(number) for number in range(FRAMES)]


def _frame(number: int) -> Frame:
    things = _things(number)
    tags = np.full((HEIGHT, WIDTH), _SKY, np.uint8)
    tags[HEIGHT // 2 :] = _ROAD
    ids = np.zeros((HEIGHT, WIDTH), np.int64)
    # In whole centimetres.
    depth = np.full((HEIGHT, WIDTH), 100_000, np.int64)
    rows = np.arange(HEIGHT // 2)
    depth[HEIGHT // 2 :] = (FOCAL * 300 // (2 * rows + 1))[:, None]
    for thing in sorted(things, key=lambda thing: -thing.near):
        if thing.is_drawn:
            x0, y0, x1, y1 = thing.front
            tags[y0:y1, x0:x1] = TAGS[thing.kind]
            ids[y0:y1, x0:x1] = thing.instance
            depth[y0:y1, x0:x1] = round(thing.near * 100)
    steps = depth * (2**24 - 1) // 100_000
    image = np.stack([tags * 8, tags * 4, np.full_like(tags, 40 * number)], axis=-1)
    files = {
        "image": png(image),
        "segmentation": png(FAMILIES[FAMILY].paint(tags)),
        "instances": png(np.stack([tags, ids & 255, ids >> 8], axis=-1)),
        "depth": png(np.stack([steps & 255, steps >> 8 & 255, steps >> 16], axis=-1)),
        "lidar": _points(things),
    }
    return Frame(f"town/{number:06}", _annotation(number, things), files)


def _things(number: int) -> list[Thing]:
    return [
        Thing("near", "car", 300, (10, -3 + number, 0.75), (2, 1, 0.75)),
        Thing("behind", "truck", 301, (20, -5.5, 1.5), (3, 1.25, 1.5)),
        Thing("walker", "walker", 302, (12, 3.5 - number / 2, 1), (0.25, 0.25, 1)),
        Thing("wall", "building", 303, (30, 12, 4), (1, 9, 4)),
        Thing("hidden", "car", 304, (40, 10, 0.75), (2, 1, 0.75), is_drawn=False),
        Thing("passing", "car", 305, (1.5, 2.5, 0.75), (2, 1, 0.75), is_drawn=False),
        Thing("past", "car", 306, (-20, 0, 0.75), (2, 1, 0.75), is_drawn=False),
    ]


def _annotation(number: int, things: list[Thing]) -> dict[str, Any]:
    level = {"x": 0, "y": 0, "z": EYE, "pitch": 0, "yaw": 0, "roll": 0}
    # Given as a matrix of whole numbers: a focal length computed from a field of view
    # of 90 degrees would be 48.00000000000001 px.
    intrinsic = [[FOCAL, 0, WIDTH // 2], [0, FOCAL, HEIGHT // 2], [0, 0, 1]]
    size = {"width": WIDTH, "height": HEIGHT}
    camera = {**size, "intrinsic": intrinsic, "transform": level}
    flat = [
        {"id": "in the sky", "class": "car", "xyxy": [4, 2, 12.5, 10.25]},
        {"id": "on the road", "class": "walker", "xywh": [70, 50, 8, 12]},
        {"id": "everything", "class": "car", "xyxy": [0, 0, WIDTH, HEIGHT]},
        {"id": "nowhere", "class": "car", "xyxy": [200, 10, 220, 30]},
        {"id": "a line", "class": "car", "xyxy": [10, 10, 10, 30]},
        {"id": "dragon", "class": "dragon", "xyxy": [20, 20, 60, 60], "wings": 2},
    ]
    boxes = [
        thing.as_box() for thing in things if thing.kind in ("car", "truck", "walker")
    ]
    return {
        "carla_version": "0.9.15",
        "map": "Town10HD",
        # In another century, since times of this one are replaced in the pins.
        "captured_at": f"1999-12-31T23:59:{50 + number}Z",
        "weather": {"fog_density": 2.5},
        "camera": camera,
        "sensors": {"lidar": {"transform": level}},
        "boxes": [*boxes, *flat],
        "driver": {"name": "Zoë", "number": number},
    }


def _points(things: list[Thing]) -> bytes:
    """A LiDAR file with nine points on the front of each cuboid that is drawn."""
    rows = [
        (thing.near + 0.125, y + side / 2, z - EYE + top / 2, 1, thing.instance, tag)
        for thing in things
        if thing.is_drawn
        for (_, y, z), tag in [(thing.centre, TAGS[thing.kind])]
        for side in np.array([-1, 0, 1]) * thing.half[1]
        for top in np.array([-1, 0, 1]) * thing.half[2]
    ]
    buffer = io.BytesIO()
    np.save(buffer, np.array(rows, POINT))
    return buffer.getvalue()


def png(rgb: NDArray[Any]) -> bytes:
    """A PNG whose pixels are not compressed."""
    height, width, _ = rgb.shape
    raw = b"".join(b"\x00" + row.astype(np.uint8).tobytes() for row in rgb)
    starts = range(0, len(raw), _STORED_BLOCK)
    blocks = [raw[start : start + _STORED_BLOCK] for start in starts]
    stored = b"".join(
        struct.pack("<BHH", at == len(blocks) - 1, len(raw), len(raw) ^ 0xFFFF) + raw
        for at, raw in enumerate(blocks)
    )
    data = b"\x78\x01" + stored + struct.pack(">I", zlib.adler32(raw))
    return png_of_chunks((width, height, 8, 2), chunk(b"IDAT", data))
