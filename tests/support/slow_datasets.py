"""Makes datasets whose runs take seconds, so that tests can interrupt them."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from filter_core.segmentation.palettes import FAMILIES
from tests.support import frames as scene
from tests.support.api import Api
from tests.support.pictures import painted, png
from tests.support.servers import RunningServer, running_server

LARGER = 28
WIDE, HIGH = scene.WIDTH * LARGER, scene.HEIGHT * LARGER
FROM_PIXELS = {"profile": "carlasimu"}
"""A configuration for which the pixels of a new dataset have to be measured again."""
OTHER_PIXELS = [
    {"palette": palette, "channel_order": order, "lossy_segmentation": lossy}
    for palette in ("auto", scene.FAMILY)
    for order in ("auto", "rgb")
    for lossy in ("refuse", "nearest")
][1:]
"""Configurations that need a measurement each, and all give the same verdicts."""


def annotation(number: int) -> dict[str, object]:
    """An annotation with a car and a ghost that differs for each number."""
    boxes = [
        {"id": name, "class": "car", "xyxy": [LARGER * side for side in xyxy]}
        for name, xyxy in (("real", scene.ON_THE_CAR), ("ghost", scene.IN_THE_SKY))
    ]
    return {"carla_version": "0.9.15", "boxes": boxes, "number": number}


def create_slow_dataset(api: Api, frames: int) -> str:
    """Create a dataset of `frames` frames that take some 20 ms each; its name."""
    tags = np.kron(scene.tags(), np.ones((LARGER, LARGER), np.uint8))
    noise = np.random.default_rng(7).integers(0, 2, tags.shape, np.uint8)
    palette = FAMILIES[scene.FAMILY]
    road = palette.tag_of("Road")
    # Noise makes the picture as slow to decode as a real one.
    tags = np.where((tags == road) & (noise == 1), palette.tag_of("Sky"), tags)
    segmentation = png(painted(tags))
    picture = np.zeros((HIGH, WIDE, 3), np.uint8)
    files = {
        "image": cv2.imencode(".png", picture)[1].tobytes(),
        "segmentation": segmentation,
    }
    name = api.dataset()
    for number in range(frames):
        api.upload_frame(name, f"{number:04}", annotation(number), **files)
    return name


@contextmanager
def slow_server(folder: Path, frames: int) -> Iterator[tuple[RunningServer, Api, str]]:
    """Yield a server that measures one frame at a time, a client, and a filled dataset.

    Parameters
    ----------
    folder : pathlib.Path
        An empty folder.
    frames : int
        How many frames the dataset has.
    """
    with running_server(folder / "data", {"UNGHOST_WORKERS": "1"}) as server:
        api = Api.at(server.url, server.headers)
        with api.http:
            yield server, api, create_slow_dataset(api, frames)
