"""Recordings of public recorders are read without a description and without options."""

from __future__ import annotations

import io
import json
from collections import Counter

import numpy as np
import pytest

from filter_core.annotation.frame import frame_boxes_2d
from filter_core.annotation.parsing import parse_annotation
from filter_core.config.file import load_config
from filter_core.formats.reading import MANIFEST_NAME, RECORDING_NAME
from filter_core.formats.recorders import recorders
from filter_core.formats.recording import description_text
from filter_core.formats.registry import describe_source, read_source
from filter_core.local import filter_one, filter_source
from tests.support.folders import annotation_of, write_files
from tests.support.pictures import pixels_of
from tests.support.shared_data import shared


def npz(**arrays):
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


CORNERS = [[x, y, z] for z in (5.0, 6.0) for y in (10, 20) for x in (30, 50)]
BOX = {"location": {"x": 20, "y": 0, "z": 1.5}, "extent": {"x": 1, "y": 1, "z": 1}}
ORIGIN = {"Location": {"x": 0, "y": 0, "z": 0}, "Rotation": {"yaw": 0}}
MOUNT = {"sensor_name": "CAM_FRONT", "translation": [0, 0, 1.5]}
CARLA = {"xmin": 1, "ymin": 2, "xmax": 30, "ymax": 40}
RECORDED: dict[str, dict[str, str | bytes | None]] = {
    "carla-dataset-runner": {
        **dict.fromkeys(("rgb20191104-1.jpeg", "sem20191104-1.png")),
        "bb20191104-1.npz": npz(arr_0=[CORNERS], arr_1=np.zeros((0, 8, 3))),
    },
    "SELMA": {
        **dict.fromkeys(("CAM_FRONT/T_1.jpg", "SEGCAM_FRONT/T_1.png")),
        "DEPTHCAM_FRONT/T_1.png": None,
        "BBOX_LABELS/T_1.json": json.dumps(
            [{**BOX, "label": 100, "bp_id": "vehicle.a.b", "instance_id": "7"}]
        ),
        "calibrated_sensor.json": json.dumps([{**MOUNT, "rotation": {"pitch": -5}}]),
        "waypoints.json": json.dumps({"1": ORIGIN}),
    },
    "CARLA's bounding_boxes.py": {
        "00000123.png": None,
        "123.json": json.dumps(
            {
                "frame_id": 123,
                "timestamp": 1.5,
                "objects": [
                    {"id": 5, "class": "car", "blueprint_id": "a", "bbox_2d": CARLA},
                    {"id": 6, "class": "car", "blueprint_id": "a", "bbox_2d": None},
                ],
            }
        ),
    },
    "CARLA-2DBBox": {
        **dict.fromkeys(("out_rgb/000007.png", "out_rgb_bbox/000007.png")),
        "out_bbox/000007.txt": json.dumps(
            {
                "bboxes": [[[1.5, 2], [3, 4]]],
                "vehicle_class": [1],
                "removed_bboxes": [[[5, 6], [7, 8]], [[5, 6], [7, 8]]],
                "removed_vehicle_class": [0, 0],
            }
        ),
    },
}
READ: dict[str, tuple[str, str, dict[str, object]]] = {
    "carla-dataset-runner": ("20191104-1", "vehicle", {"xyxy": [30, 10, 50, 20]}),
    "SELMA": ("T/FRONT/1", "car", {"instance_id": 7, "type_id": "vehicle.a.b"}),
    "CARLA's bounding_boxes.py": ("00000123", "car", {"xyxy": [1, 2, 30, 40]}),
    "CARLA-2DBBox": ("000007", "truck", {"xyxy": [1.5, 2, 3, 4]}),
}


@pytest.mark.parametrize("folder", ["", "a run/"])
@pytest.mark.parametrize("name", RECORDED)
def test_recording_is_recognised_and_its_recorder_is_said(tmp_path, name, folder):
    files = {f"{folder}{path}": file for path, file in RECORDED[name].items()}

    frames = read_source(write_files(tmp_path, files))
    (frame,) = frames

    key, class_name, values = READ[name]
    assert frames.notes()[0].startswith(f"recognised as a recording of {name}")
    assert frame.key.endswith(key)
    assert [one.path for one in frames.unmatched] == []
    (box,) = annotation_of(frame)["boxes"]
    assert box["class"] == class_name
    assert values.items() <= box.items()


@pytest.mark.parametrize("name", RECORDED)
def test_description_of_a_recorder_is_written_and_read_back(tmp_path, name):
    write_files(tmp_path, RECORDED[name])
    description = describe_source(tmp_path)
    (frame,) = read_source(tmp_path)

    text = description_text(description, tmp_path)
    write_files(tmp_path, {RECORDING_NAME: text})
    (again,) = read_source(tmp_path)

    assert annotation_of(again) == annotation_of(frame)
    assert describe_source(tmp_path).config_keys() == description.config_keys()
    assert len(text.splitlines()) < 60


def test_every_recorder_that_ships_is_tested():
    assert {one.name.split(" (")[0] for one in recorders()} == {*RECORDED}


@pytest.mark.parametrize(
    ("files", "layout"),
    [
        ({RECORDING_NAME: "layout: pairs"}, "pairs"),
        ({MANIFEST_NAME: '{"key": "1", "boxes": []}'}, "manifest"),
        ({"bb20191104-1.npz": b"something else"}, "pairs"),
    ],
)
def test_description_manifest_or_other_content_is_no_recorders(tmp_path, files, layout):
    frames = read_source(
        write_files(tmp_path, {**RECORDED["carla-dataset-runner"], **files})
    )

    assert frames.layout == layout
    assert not any("recognised as a recording" in note for note in frames.notes())


def test_options_win_over_the_recorders_description(tmp_path):
    write_files(tmp_path, RECORDED["carla-dataset-runner"])

    assert describe_source(tmp_path).palette == "carla-0.9.0"
    option = describe_source(tmp_path, options={"palette": "carla-0.9.10"})
    assert (option.palette, option.own_layout) == ("carla-0.9.10", "table")
    assert describe_source(tmp_path, options={"layout": "pairs"}).recorder == ""


def test_recorded_npz_boxes_have_the_verdicts_that_were_counted():
    folder = shared("cases/recordings/alannaoto")
    description = describe_source(folder)
    config = load_config("", below=description.config_keys()).config

    outcomes = filter_source(read_source(folder), config, workers=1)

    verdicts = {
        one.key: Counter(each["verdict"] for each in one.decisions or ())
        for one in outcomes
    }
    assert verdicts == {
        "20191104-142916": {"kept": 25, "rejected": 46},
        "20191104-142925": {"kept": 14, "rejected": 35},
        "20191104-171700": {"kept": 15, "rejected": 18},
    }


TAGS = {
    "person": (40,),
    "car": (100,),
    "truck": (101,),
    "train": (103,),
    "motorcycle": (104, 41),
    "bicycle": (105, 41),
}
"""Of SELMA's changed CARLA, by class."""


@pytest.mark.parametrize("below", ["", "Town01_Opt_ClearNight"])
def test_recorded_3d_boxes_lie_where_their_cameras_show_them(below):
    frames = read_source(shared("cases/recordings/selma") / below)
    description = describe_source(shared("cases/recordings/selma") / below)
    config = load_config(b"", below=description.config_keys()).config
    visible, kept = {}, {}
    for frame in frames:
        annotation = parse_annotation(annotation_of(frame))
        assert frame.segmentation is not None
        tags = pixels_of(frame.segmentation.read_bytes())
        tags = tags if tags.ndim == 2 else tags[..., 0]
        xyxy = frame_boxes_2d(annotation, (1280, 640)).xyxy
        found = [pixels(one) for one in xyxy]
        shares = [
            np.isin(tags[rows, columns], TAGS[box.class_name or ""]).mean()
            for box, (rows, columns) in zip(annotation.boxes, found, strict=True)
            if tags[rows, columns].size
        ]
        camera = frame.key.split("/")[-2]
        visible[camera] = sum(share >= 0.1 for share in shares)
        decisions = filter_one(frame, config).decisions or ()
        kept[camera] = sum(each["verdict"] == "kept" for each in decisions)
        assert len(annotation.boxes) == 212
        assert set(frame.others) == {"depth"}

    assert visible == kept == {"FRONT": 16, "LEFT": 35}


def pixels(xyxy):
    """Rows and columns that a rectangle touches."""
    x_min, y_min = np.maximum(np.floor(xyxy[:2]), 0).astype(int)
    x_max, y_max = np.maximum(np.ceil(xyxy[2:]), 0).astype(int)
    return slice(y_min, y_max), slice(x_min, x_max)
