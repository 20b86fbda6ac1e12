"""Tiny frames with a known answer, for tests that send them to a server.

Each one shows a road under the sky with one car on it: the box on the car is kept, the
box on the empty sky is rejected.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from filter_core.segmentation.palettes import FAMILIES
from tests.support.pictures import jpeg, painted, plain_png, png
from unghost import Client, StoredFrame

WIDTH, HEIGHT = 64, 48
FAMILY = "carla-0.9.14"
ON_THE_CAR = [20, 24, 40, 40]
IN_THE_SKY = [2, 2, 12, 12]


def tags(shift: int = 0) -> np.ndarray:
    """The scene as tags; the car stands `shift` pixels further right."""
    palette = FAMILIES[FAMILY]
    scene = np.full((HEIGHT, WIDTH), palette.tag_of("Sky"), np.uint8)
    scene[20:] = palette.tag_of("Road")
    x0, y0, x1, y1 = ON_THE_CAR
    scene[y0:y1, x0 + shift : x1 + shift] = palette.tag_of("Car")
    return scene


def segmentation(shift: int = 0) -> bytes:
    return png(painted(tags(shift), FAMILY))


def image(number: int = 0) -> bytes:
    return png(np.full((HEIGHT, WIDTH, 3), number % 256, np.uint8))


def color_of(name: str) -> tuple[int, int, int]:
    """The RGB colour of a tag with this name."""
    palette = FAMILIES[FAMILY]
    tag = np.array([[palette.tag_of(name)]], np.uint8)
    red, green, blue = palette.paint(tag)[0, 0].tolist()
    return red, green, blue


def large(side: int) -> tuple[dict[str, object], bytes]:
    """The annotation of a frame without boxes, and its segmentation of side x side.

    That is a small file, whose pixels need 3 bytes each when it is decoded.
    """
    camera = {"width": side, "height": side, "fov": 90}
    annotation: dict[str, object] = {"carla_version": "0.9.15", "boxes": []}
    return {**annotation, "camera": camera}, plain_png(side, side, color_of("Road"))


def as_json(value: object) -> bytes:
    """An annotation as the JSON bytes that are sent."""
    return json.dumps(value).encode()


def annotation() -> dict[str, object]:
    return {
        "carla_version": "0.9.15",
        "map": "Town10HD",
        "camera": {"width": WIDTH, "height": HEIGHT, "fov": 90},
        "boxes": [
            {"id": "real", "class": "car", "xyxy": ON_THE_CAR},
            {"id": "ghost", "class": "car", "xyxy": IN_THE_SKY},
        ],
    }


def annotation_of(*boxes: object, **more: object) -> dict[str, object]:
    """The annotation with these boxes instead of its own, and with these keys."""
    return {**annotation(), "boxes": list(boxes), **more}


def write_manifest(
    folder: Path, count: int, *, bad: frozenset[int] = frozenset()
) -> Path:
    """Write a folder of `count` frames; those in `bad` have a faulty box."""
    (folder / "rgb").mkdir(parents=True)
    (folder / "seg").mkdir()
    lines = []
    for number in range(count):
        name = f"{number:06}.png"
        (folder / "rgb" / name).write_bytes(image(number))
        (folder / "seg" / name).write_bytes(segmentation())
        frame = {"key": f"run/{number:06}", **annotation()}
        if number in bad:
            frame["boxes"] = [{"id": "x", "class": "car", "xyxy": [0, 0, "wide", 9]}]
        files = {"image": f"rgb/{name}", "segmentation": f"seg/{name}"}
        lines.append(json.dumps({**frame, **files}))
    (folder / "manifest.jsonl").write_text("\n".join(lines) + "\n")
    return folder


def write_jpeg_segmentation(folder: Path) -> Path:
    """Write a folder of one frame, whose segmentation is a JPEG."""
    write_manifest(folder, 1)
    (folder / "seg/000000.png").write_bytes(jpeg(painted(tags())))
    return folder


def put(
    client: Client, dataset: str, key: str, number: int = 0, **changed: Any
) -> StoredFrame:
    """Send one frame with two boxes; `changed` are keys of its annotation."""
    return client.put_frame(
        dataset,
        key,
        {**annotation(), **changed},
        image=image(number),
        segmentation=segmentation(),
    )
