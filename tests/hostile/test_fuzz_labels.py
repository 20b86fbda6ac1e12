"""Configurations, annotations and label files that are damaged or bent.

Each gives a result or our own error, and takes little memory for it.
"""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from filter_core.annotation.parsing import parse_annotation, without_key
from filter_core.config.file import load_config
from filter_core.config.filter import FilterConfig
from filter_core.errors import FilterError
from filter_core.formats.registry import read_source
from filter_core.local import filter_one
from filter_core.segmentation.reading import SegmentationOptions
from tests.hostile.mutations import (
    bent,
    damaged,
    damaged_text,
    json_values,
    little_memory,
    many,
)
from tests.unit.filter_core.formats.exporting import box, export, frame
from tests.unit.filter_core.formats.folders import write_files

pytestmark = pytest.mark.long

YAML = """\
# every kind of value
profile: paper
threshold_small_box: 10
threshold_big_box: 2.5e1
palette: carla-0.9.14
min_distance: ~
evidence: {pedestrian: semantic}
classes:
  car: {accept: [Car, Truck], threshold_small_box: 40}
  walker: {accept: [12]}
"""
CARLASIMU = """\
sitting:
  boundingBox: {min_distance: 2, max_distance: 200, size_big_box: 15}
  cam_rgb: {3D: true, width: 1280}
"""
CONFIG = yaml.safe_load(YAML)
STILL = dict.fromkeys(("x", "y", "z", "pitch", "yaw", "roll"), 0)
CAMERA = {"width": 80, "height": 60, "fov": 90, "transform": STILL}
PLACE = {"x": 10, "y": 0, "z": 1}
LEVEL = {"pitch": 0, "yaw": 0, "roll": 0}
BOX3D = {
    "transform": {**PLACE, **LEVEL},
    "extent": PLACE,
    "location": PLACE,
    "rotation": LEVEL,
}
CORNERS = [[x, y, z] for x in (8, 12) for y in (-1, 1) for z in (0, 2)]
ANNOTATION = {
    "key": "a",
    "carla_version": "0.9.15",
    "captured_at": "2026-01-01T00:00:00Z",
    "camera": CAMERA,
    "sensors": {"lidar": {"transform": STILL}},
    "boxes": [
        {"id": "1", "class": "car", "xyxy": [1, 2, 30, 40], "distance": 12.5},
        {"id": 2, "type_id": "vehicle.ford.ambulance", "xywh": [10, 20, 30, 40]},
        {"class": "van", "cxcywhn": [0.5, 0.5, 0.1, 0.1], "instance_id": 4711},
        {"class": "car", "vertices": CORNERS},
        {"class": "car", "box3d": BOX3D, "extra": {"a": [None, True]}},
    ],
}


@many
@given(content=st.one_of(damaged_text([YAML, CARLASIMU]), st.binary(max_size=80)))
@example(b"a: " + b"[" * 5000)
@example(b"threshold_small_box: " + b"9" * 5000)
@example(b"a: &a [1]\nb: [*a, *a]")
@example(b"? {a: b}\n: 1")
@example(b"a: 2026-13-45")
@example(b"a: 1:60:99")
@example(b"a: !!binary x")
@example(b"a: !!int _")
@example(b"a: !!bool maybe")
@example(b"a: !!timestamp maybe")
@example(b"a: !!float _")
@example(b"!!set [a]")
@example(b"a: !!omap [1]")
@example(b"a: !!pairs {b: 1}")
@example(b"a: !!python/name:os.system x")
@example(b"%YAML 9.9\n---\na: 1")
def test_any_text_is_a_configuration_or_our_own_error(content):
    with little_memory(), suppress(FilterError):
        load_config(content)


@many
@given(document=st.one_of(bent(CONFIG), bent(yaml.safe_load(CARLASIMU)), json_values))
def test_any_mapping_is_a_configuration_or_our_own_error(document):
    with little_memory(), suppress(FilterError):
        load_config(document if isinstance(document, dict) else repr(document))


@many
@given(
    content=st.one_of(
        damaged([json.dumps(ANNOTATION).encode()]),
        bent(ANNOTATION).map(json.dumps).map(str.encode),
        st.binary(max_size=80),
    )
)
@example(b"[" * 100_000)
@example(b'{"boxes": [{"class": "car", "xyxy": [0, 0, 1, ' + b"9" * 5000 + b"]}]}")
def test_any_annotation_is_read_or_our_own_error(content):
    with little_memory(), suppress(FilterError):
        name, rest = without_key(content, "a")
        parse_annotation(rest, frame=name)


@many
@given(document=bent(ANNOTATION))
def test_any_object_is_an_annotation_or_our_own_error(document):
    with little_memory(), suppress(FilterError):
        parse_annotation(document if isinstance(document, dict) else {})


def _samples() -> dict[str, dict[str, bytes]]:
    """Small folders of every layout, whole."""
    frames = [
        frame("a", box(0), box(1, (50, 10, 70, 30), "rejected", distance=12.5)),
        frame("b", box(2, class_name="traffic light")),
    ]
    names = ("yolo", "coco", "kitti", "voc", "manifest")
    folders = {name: export(name, frames) for name in names}
    image = next(
        data for name, data in folders["yolo"].items() if name.endswith("a.png")
    )
    folders["carlasimu"] = {
        "labels/label50/a.txt": b"0 0.5 0.5 0.1 0.1\n",
        "labels/label100/a.txt": b"0 0.5 0.5 0.1 0.1\n1 0.1 0.1 0.2 0.2\n",
        "images/a.png": image,
        "classes.txt": b"car\nvan\n",
    }
    return folders


FOLDERS = _samples()


@pytest.mark.parametrize("layout", FOLDERS)
@many
@given(data=st.data())
def test_any_folder_is_read_or_our_own_error(layout, data):
    files = dict(FOLDERS[layout])
    texts = [name for name in sorted(files) if not name.endswith(".png")]
    for _ in range(data.draw(st.integers(1, 2))):
        name = data.draw(st.sampled_from(texts))
        files[name] = data.draw(damaged([files[name]]))
    # Not measured: that would make reading a folder ten times as slow.
    with TemporaryDirectory() as place, suppress(FilterError):
        for source in read_source(write_files(Path(place), files), layout):
            outcome = filter_one(source, FilterConfig(), SegmentationOptions())
            assert (outcome.error is None) != (outcome.decisions is None)
