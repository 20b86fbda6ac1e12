"""A drawn street with one car, in which every verdict occurs and all pixels are known.

The picture is plain grey, so that all other colours on the stage were drawn by the
page.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import httpx
import numpy as np

from filter_core.segmentation.palettes import FAMILIES
from tests.support.page import scenes
from tests.support.pictures import png
from tests.support.waiting import until

WIDTH, HEIGHT = 640, 360
GREY = 118
FAMILY = "carla-0.9.14"

CAR = (80, 200, 240, 300)
HALF_HIDDEN = (300, 180, 400, 280)
SKY = (420, 30, 520, 110)
WALKER = (560, 200, 590, 280)

BOXES: list[dict[str, Any]] = [
    {"id": "real", "class": "car", "xyxy": CAR, "distance": 12.5},
    {"id": "hidden", "class": "car", "xyxy": HALF_HIDDEN, "distance": 40},
    {"id": "ghost", "class": "truck", "xyxy": SKY},
    {"id": "walker", "class": "walker", "xyxy": WALKER},
    {"id": "away", "class": "car", "xyxy": [700, 10, 760, 60]},
]
SOLID = {
    "id": "solid",
    "class": "car",
    "vertices": [[x, y, z] for x in (10, 14) for y in (-1.0, 1.0) for z in (-1.5, 0.0)],
}


def tags() -> np.ndarray:
    palette = FAMILIES[FAMILY]
    scene = np.full((HEIGHT, WIDTH), palette.tag_of("Sky"), np.uint8)
    scene[150:] = palette.tag_of("Road")
    _fill(scene, CAR, palette.tag_of("Car"))
    _fill(scene, HALF_HIDDEN, palette.tag_of("Vegetation"))
    # 4 % of the box: 100 x 4 of its 100 x 100 pixels show a car
    _fill(scene, (300, 228, 400, 232), palette.tag_of("Car"))
    _fill(scene, WALKER, palette.tag_of("Pedestrian"))
    return scene


def _fill(scene: np.ndarray, xyxy: tuple[int, ...], tag: int) -> None:
    x0, y0, x1, y1 = xyxy
    scene[y0:y1, x0:x1] = tag


@cache
def segmentation(form: str) -> bytes:
    if form == "raw":
        none = np.zeros((HEIGHT, WIDTH), np.uint8)
        return png(np.dstack([tags(), none, none]))
    rgb = FAMILIES[FAMILY].paint(tags())
    return png(rgb[..., ::-1] if form == "bgr" else rgb)


@cache
def picture(colour: int | tuple[int, int, int] = GREY) -> bytes:
    """A grey picture, or one of an RGB colour."""
    return png(np.full((HEIGHT, WIDTH, 3), colour, np.uint8))


def push(
    http: httpx.Client,
    dataset: str,
    key: str,
    boxes: list[dict[str, Any]] | None = None,
    form: str = "palette",
    colour: int | tuple[int, int, int] = GREY,
) -> dict[str, Any]:
    """Send one frame; returns it with its decisions, as the server shows it."""
    place = {"x": 0, "y": 0, "z": 0}
    camera = {"width": WIDTH, "height": HEIGHT, "fov": 90, "transform": place}
    annotation = {
        "carla_version": "0.9.15",
        "map": "Town10HD",
        "camera": camera,
        "boxes": BOXES if boxes is None else boxes,
    }
    files = {} if form == "none" else {"segmentation": segmentation(form)}
    return put(http, dataset, key, annotation, image=picture(colour), **files)


def put(
    http: httpx.Client, dataset: str, key: str, annotation: Any, **files: bytes
) -> dict[str, Any]:
    """Send a frame of these files; returns it as `push` does."""
    parts = {"annotation": json.dumps(annotation).encode(), **files}
    response = http.put(f"/datasets/{dataset}/frames/{key}", files=parts)
    assert response.status_code == 201, response.text
    return get(http, f"/frames/{response.json()['frame']['id']}")


def decide(http: httpx.Client, dataset: str, config: Mapping[str, object]) -> None:
    """Start a run with this configuration, and wait until it is done."""
    body = {"config": config, "activate": True}
    response = http.post(f"/datasets/{dataset}/runs", json=body)
    assert response.status_code == 202, response.text
    path = f"/runs/{response.json()['id']}"
    until(lambda: get(http, path)["state"] == "done", lambda: get(http, path))


def get(http: httpx.Client, path: str) -> dict[str, Any]:
    response = http.get(path)
    assert response.status_code == 200, response.text
    body: dict[str, Any] = response.json()
    return body


@dataclass(frozen=True)
class Scene:
    """A dataset that only this test uses, and its first frame."""

    http: httpx.Client
    dataset: str
    frame: dict[str, Any]

    def box_id(self, name: str) -> int:
        """The server's id of a box, by the sender's id."""
        box_id: int = self._box(name)["box_id"]
        return box_id

    def review(self, name: str) -> Any:
        """The latest answer on a box that the server has stored; None without one."""
        return scenes.get(self.http, f"/boxes/{self.box_id(name)}")["review"]

    def revision(self, name: str) -> int:
        box = scenes.get(self.http, f"/boxes/{self.box_id(name)}")
        revision: int = box["revision"]
        return revision

    def link(self, name: str = "", **query: str) -> str:
        """The address of the frame, with the box `name` selected if it is given."""
        parameters = {**({"box": str(self.box_id(name))} if name else {}), **query}
        search = "&".join(f"{key}={value}" for key, value in parameters.items())
        return f"#/frames/{self.frame['id']}{'?' if search else ''}{search}"

    def decide(self, **config: object) -> None:
        """Activate a configuration, and wait until its run is done."""
        scenes.decide(self.http, self.dataset, config)

    def push(self, key: str, **kwargs: Any) -> dict[str, Any]:
        """Send one more frame to this dataset."""
        return scenes.push(self.http, self.dataset, key, **kwargs)

    def _box(self, name: str) -> dict[str, Any]:
        return next(box for box in self.frame["boxes"] if box["id"] == name)


MakeScene = Callable[..., Scene]
