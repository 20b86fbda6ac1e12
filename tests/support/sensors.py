"""Makes small depth and instance images, and a scene with a hidden car."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from filter_core.formats.reading import FrameSource
from filter_core.geometry.box3d import CORNER_SIGNS
from tests.support.folders import write_files
from tests.support.pictures import painted, png


def depth_png(metres: np.ndarray) -> bytes:
    """A PNG of CARLA's raw depth: 24 bits, of which red holds the lowest."""
    steps = np.rint(np.asarray(metres) / 1000.0 * (2**24 - 1)).astype(np.int64)
    planes = [steps >> 16, steps >> 8 & 255, steps & 255]
    return png(np.stack(planes, axis=-1).astype(np.uint8), order="bgr")


def street_metres(height: int = 120, width: int = 160) -> np.ndarray:
    """Planar depth of a flat street and the walls beside it, under a sky."""
    rows = np.arange(height)[:, None] - height / 2 + 0.5
    columns = np.abs(np.arange(width)[None, :] - width / 2 + 0.5)
    ground = 1.6 * width / 2 / np.maximum(rows, 0.01)
    walls = 12.0 * width / 2 / np.maximum(columns, 0.01)
    street = np.where(rows > 0, np.minimum(ground, walls), walls)
    return np.where((rows < 0) & (walls > 60), 1000.0, np.minimum(street, 900.0))


def instance_png(tags: np.ndarray, ids: np.ndarray, *, swapped: bool = False) -> bytes:
    """A PNG of instances as CARLA writes it: red: tag; green + 256 blue: id."""
    wide = np.asarray(ids, np.int64)
    rgb = np.stack([np.asarray(tags), wide & 255, wide >> 8], axis=-1).astype(np.uint8)
    return png(rgb, order="bgr" if swapped else "rgb")


def box_ahead(distance: float, half: float, right: float = 0.0) -> np.ndarray:
    """(8, 3) corners of a cube in front of a camera at the origin."""
    return np.asarray(CORNER_SIGNS * half + np.array([distance, right, 0.0]))


CAR, ROAD = 14, 1
WIDTH, HEIGHT = 160, 120
CAMERA = {
    "width": WIDTH,
    "height": HEIGHT,
    "fov": 90,
    "transform": {"x": 0, "y": 0, "z": 0},
}
NEAR, FAR = 10.0, 40.0


def cube(box_id: str, distance: float) -> dict:
    return {
        "id": box_id,
        "class": "car",
        "box3d": {
            "transform": {"x": distance, "y": 0, "z": 0},
            "location": [0, 0, 0],
            "extent": [2, 2, 2],
            "rotation": [0, 0, 0],
        },
    }


ANNOTATION: dict[str, Any] = {
    "carla_version": "0.9.15",
    "camera": CAMERA,
    "sensors": {"lidar": {"transform": {"x": 0, "y": 0, "z": 1}}},
    "boxes": [cube("217", NEAR), cube("218", FAR)],
}


def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tags, metres and instance ids: the near car is seen, the one behind it is not."""
    tags = np.full((HEIGHT, WIDTH), ROAD, np.uint8)
    metres, ids = np.full(tags.shape, 60.0), np.zeros(tags.shape, int)
    seen = np.s_[41:79, 61:99]
    tags[seen], metres[seen], ids[seen] = CAR, NEAR - 2, 999
    return tags, metres, ids


def depth_file() -> bytes:
    return depth_png(scene()[1])


def instance_file() -> bytes:
    return instance_png(scene()[0], scene()[2])


def files(**others: bytes) -> dict[str, bytes]:
    return {"segmentation": png(painted(scene()[0])), **others}


def sensors() -> dict[str, bytes]:
    tags, metres, ids = scene()
    return files(depth=depth_png(metres), instances=instance_png(tags, ids))


def scene_source(folder: Path, **changed: Any) -> FrameSource:
    """The frame of the scene as files in a folder, annotated as `changed`."""
    images = sensors()
    write_files(folder, images)
    paths = {kind: folder / kind for kind in images}
    segmentation = paths.pop("segmentation")
    annotation = {**ANNOTATION, **changed}
    return FrameSource("a", annotation, segmentation=segmentation, others=paths)


def coarse_depth_file() -> bytes:
    """A PNG of depth in 256 steps, which is no evidence."""
    return png(np.dstack([(scene()[1] / 1000 * 255).astype(np.uint8)] * 3))


def write_coarse_depth(folder: Path) -> tuple[Path, Path]:
    """A folder of two frames with coarse depth, and a configuration that uses it."""
    contents = {"seg.png": files()["segmentation"]}
    lines = []
    for key in "ab":
        depth = f"depth/{key}.png"
        contents[depth] = coarse_depth_file()
        line = {**ANNOTATION, "key": key, "segmentation": "seg.png", "depth": depth}
        lines.append(json.dumps(line))
    contents["manifest.jsonl"] = "\n".join(lines).encode()
    write_files(folder / "frames", contents)
    config = folder / "auto.yaml"
    config.write_text("evidence: auto")
    return folder / "frames", config


def lesson() -> dict[str, bytes]:
    """A frame with five boxes whose truth is clear: two cars are seen, three are not.

    `full` is seen as a whole, `walled` and `gone` are not at all, `partly` is a tenth,
    and in `behind` only the car of `full` is seen.
    """
    tags = np.full((360, 640), ROAD, np.uint8)
    ids = np.zeros(tags.shape, int)
    for number, seen in ((1, np.s_[100:180, 20:120]), (3, np.s_[100:180, 300:310])):
        tags[seen], ids[seen] = CAR, number
    places = {
        "full": ([20, 100, 120, 180], 10),
        "walled": ([150, 100, 250, 180], 20),
        "partly": ([300, 100, 400, 180], 20),
        "gone": ([430, 100, 530, 180], 30),
        "behind": ([30, 110, 110, 170], 40),
    }
    boxes = [
        {
            "id": name,
            "class": "car",
            "instance_id": number,
            "xyxy": xyxy,
            "distance": distance,
        }
        for number, (name, (xyxy, distance)) in enumerate(places.items(), start=1)
    ]
    annotation = {"carla_version": "0.9.15", "boxes": boxes}
    return {
        "annotation": json.dumps(annotation).encode(),
        "image": png(np.full((360, 640, 3), 118, np.uint8)),
        "segmentation": png(painted(tags)),
        "instances": instance_png(tags, ids),
    }


def experiment_report() -> dict[str, object]:
    """A report of `unghost worth-it`: one arm is better, one is not."""
    map50 = {"value": 0.06, "low": 0.05, "high": 0.07}
    counts = {"labels": 35_540, "ghosts": 21_327, "doubtful": 2_236, "lost": 0}
    differences = {
        "raw": None,
        "depth": {**map50, "shown": True},
        "random": {"value": -0.01, "low": -0.02, "high": 0.01, "shown": False},
    }
    return {
        "verdict": "Better: depth.",
        "truth": "By instances.",
        "baseline": "raw",
        "trainer": "torchvision",
        "frames": 1224,
        "objects": 12_000,
        "arms": {
            name: {
                "labels": counts,
                "trials": 3,
                "map50": map50,
                "difference": difference,
            }
            for name, difference in differences.items()
        },
    }
