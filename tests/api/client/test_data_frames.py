"""Boxes as data frames, and frames made of arrays and pictures."""

import os
import subprocess
import sys
from typing import get_args

import cv2
import numpy as np
import pyarrow
import pytest

from tests.support import frames
from tests.support.pictures import png
from unghost import wire
from unghost.client import keywords
from unghost.client.tables import kinds
from unghost.wire import words
from unghost.wire.boxes import USUAL_COLUMNS

TYPES = {str: pyarrow.string(), float: pyarrow.float64(), int: pyarrow.int64()}


def test_arrow_table_has_the_boxes_and_their_types(client, filled_dataset):
    arrived: list[int] = []
    table = client.boxes(filled_dataset).to_arrow(progress=arrived.append)

    assert arrived == [table.num_rows] == [6]
    assert tuple(table.column_names) == USUAL_COLUMNS
    for name, (kind, may_be_none) in kinds().items():
        if name in USUAL_COLUMNS:
            assert table.schema.field(name).type == TYPES.get(kind, pyarrow.bool_())
            assert may_be_none or table[name].null_count == 0
    listed = [(box.frame, box.id, box.verdict) for box in client.boxes(filled_dataset)]
    columns = (table[name].to_pylist() for name in ("frame", "box", "verdict"))
    assert list(zip(*columns, strict=True)) == listed


def test_table_has_the_filters_of_the_list_and_the_fields_that_were_asked_for(
    client, filled_dataset
):
    boxes = client.boxes(filled_dataset, verdict="rejected", frame="run/000001")

    assert boxes.columns(["box", "frame"]) == {
        "frame": ["run/000001"],
        "box": ["ghost"],
    }
    with pytest.raises(ValueError, match="found 'doubt'"):
        client.boxes(filled_dataset, sort="doubt").columns()


DATA_FRAMES = """
import sys
from unghost import Client
with Client() as client:
    boxes = client.boxes(sys.argv[1])
    one, other = boxes.to_pandas(), boxes.to_polars()
print(len(one), other.height, list(one.columns) == other.columns)
print(one.dtypes["match_percent"], one.dtypes["matched_pixels"], one.dtypes["toss_up"])
print(other.schema["map"], other.schema["threshold"])
print(one.groupby("verdict").size().to_dict(), other["box"].unique().sort().to_list())
from PIL import Image
import numpy
picture = Image.fromarray(numpy.full((48, 64, 3), 7, numpy.uint8))
with Client() as client:
    stored = client.put_frame(sys.argv[1], "picture", {"boxes": []}, image=picture)
    print(client.frame_file(stored.frame.id, "image")[:4], stored.frame.width)
"""


@pytest.mark.long
def test_pandas_polars_and_pil(server, filled_dataset, tmp_path):
    # Beside this environment: nothing else needs them.
    packages = ("pandas", "polars", "pillow")
    install = (sys.executable, "-m", "pip", "install", "-q", "--target", tmp_path)
    subprocess.run([*install, *packages], check=True)
    path = os.pathsep.join([str(tmp_path), *sys.path])
    settings = {"UNGHOST_SERVER": server.url, "UNGHOST_TOKEN": server.token}
    printed = subprocess.run(
        [sys.executable, "-c", DATA_FRAMES, filled_dataset],
        env={**os.environ, **settings, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()

    assert printed == [
        "6 6 True",
        "float64 Int64 bool",
        "String Float64",
        "{'kept': 3, 'rejected': 3} ['ghost', 'real']",
        "b'\\x89PNG' 64",
    ]


def test_frame_is_stored_from_arrays(client, dataset):
    numbers = np.arange(frames.HEIGHT * frames.WIDTH * 3, dtype=np.uint8)
    image = numbers.reshape(frames.HEIGHT, frames.WIDTH, 3)
    depth = np.full((frames.HEIGHT, frames.WIDTH), 12.5, np.float32)
    files = {"image": image, "segmentation": frames.tags(), "depth": depth}
    stored = client.put_frame(dataset, "arrays", frames.annotation(), **files)

    assert [box.verdict for box in stored.decisions] == ["kept", "rejected"]
    again = client.put_frame(dataset, "arrays", frames.annotation(), **files)
    assert not again.created
    sent = client.frame_file(stored.frame.id, "image")
    assert sent != png(image)  # compressed otherwise, with the same pixels
    sent_depth = np.frombuffer(client.frame_file(stored.frame.id, "depth"), np.uint8)
    assert carla_depth(sent_depth) == pytest.approx(depth, abs=1e-4)


def carla_depth(png_bytes: np.ndarray) -> np.ndarray:
    """Metres, as CARLA's documentation computes them."""
    bgr = np.asarray(cv2.imdecode(png_bytes, cv2.IMREAD_UNCHANGED), np.float64)
    weighted: np.ndarray = bgr @ np.array([65536.0, 256.0, 1.0])
    return 1000 * weighted / (2**24 - 1)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (
            np.zeros((4, 4, 2), np.uint8),
            r"\(H, W, 3\) or \(H, W, 4\), found \(4, 4, 2\)",
        ),
        (3.5, "expected bytes, a path, an array or an image of PIL, found float"),
    ],
)
def test_what_is_no_picture_is_refused_with_what_was_found(
    client, dataset, content, told
):
    with pytest.raises((ValueError, TypeError), match=told):
        client.put_frame(dataset, "no-picture", image=content)


@pytest.mark.parametrize(
    ("options", "model", "others"),
    [
        (
            keywords.BoxFilters,
            wire.BoxListQuery,
            {"dataset", "cursor", "count", "fields"},
        ),
        (keywords.FrameFilters, wire.FrameListQuery, {"cursor"}),
        (keywords.DatasetOptions, wire.DatasetIn, {"name"}),
        (keywords.DatasetChanges, wire.DatasetPatch, set()),
        (keywords.ExportChoices, wire.ExportOptions, set()),
        (keywords.OverlayOptions, wire.OverlayQuery, set()),
        (keywords.CropOptions, wire.CropQuery, {"v"}),
    ],
)
def test_keywords_are_the_fields_of_the_api(options, model, others):
    assert set(options.__annotations__) == set(model.model_fields) - others


def test_files_of_a_frame_are_those_of_the_api():
    assert tuple(keywords.FrameFiles.__annotations__) == get_args(words.FileKind)
