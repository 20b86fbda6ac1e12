"""Exported labels that are read again are equal, within the format's precision."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from filter_core.annotation.frame import frame_boxes_2d
from filter_core.annotation.parsing import parse_annotation
from filter_core.formats.registry import EXPORT_FORMATS, FORMATS, read_source
from tests.support.exporting import (
    CLASSES,
    WH,
    box,
    convert,
    export,
    frame,
    labels_of,
    write_exported_files,
)

# Pixels by which a rectangle may change: half a unit of the format's last digit. In VOC
# half a pixel, or a whole one where the rectangle would otherwise be empty.
PRECISION = {"yolo": 2e-6, "coco": 1e-4, "kitti": 1e-4, "manifest": 0.0, "voc": 1.0}

READ_AND_WRITTEN = [name for name in EXPORT_FORMATS if FORMATS[name].read]

KEYS = st.text(
    st.characters(codec="utf-8", exclude_categories=("Cc", "Cs")),
    min_size=1,
    max_size=20,
)


def rectangle(x, y, beyond):
    """Corners from (start, extent) on each axis; two sides move out by `beyond`."""
    (x_min, width), (y_min, height) = x, y
    return x_min - beyond, y_min, x_min + width, y_min + height + beyond


def span(side):
    """(start, extent) on an axis: it starts inside the image and may end outside."""
    return st.tuples(
        st.floats(0, side - 1, width=32), st.floats(0.0625, side, width=32)
    )


RECTANGLES = st.lists(
    st.tuples(
        st.sampled_from(CLASSES),
        st.builds(rectangle, span(WH[0]), span(WH[1]), st.sampled_from((0, 0.5, 30))),
    ),
    max_size=4,
)
FRAMES = st.dictionaries(KEYS, RECTANGLES, min_size=1, max_size=4)


def frames_of(drawn):
    """Frames with the drawn boxes, sorted by key, as a server sends them."""
    for key in sorted(drawn):
        boxes = [
            box(number, xyxy, class_name=name, given={"id": str(number)})
            for number, (name, xyxy) in enumerate(drawn[key])
        ]
        yield frame(key, *boxes, map="Town 1")


def bands_option(name):
    """The option for labels per distance band, for the formats that have it."""
    return {"bands": [50]} if "bands" in FORMATS[name].options else {}


def read_labels(folder):
    """The classes and rectangles that are read from a folder, by frame key."""
    found = {}
    for one in read_source(folder):
        assert one.problem is None, one.problem
        assert one.image is not None
        parsed = parse_annotation(one.annotation or {})
        names = [each.class_name for each in parsed.boxes]
        found[one.key] = names, frame_boxes_2d(parsed, WH).xyxy
    return found


SLOW = settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)


@pytest.mark.parametrize("name", READ_AND_WRITTEN)
@SLOW
@given(drawn=FRAMES)
def test_exported_labels_round_trip_within_the_format_precision(name, drawn):
    with tempfile.TemporaryDirectory() as folder:
        found = read_labels(
            write_exported_files(Path(folder), export(name, frames_of(drawn)))
        )

    assert set(found) == set(drawn)
    for key, boxes in drawn.items():
        names, rectangles = found[key]
        words = {"traffic light": "traffic_light"} if name == "kitti" else {}
        assert names == [words.get(one, one) for one, _ in boxes]
        given_xyxy = np.array([xyxy for _, xyxy in boxes], float).reshape(-1, 4)
        if name != "manifest":
            given_xyxy = np.clip(given_xyxy, 0, [*WH, *WH])
        atol = PRECISION[name]
        np.testing.assert_allclose(rectangles, given_xyxy, rtol=0, atol=atol)


@pytest.mark.parametrize("name", READ_AND_WRITTEN)
@SLOW
@given(drawn=FRAMES)
def test_reexport_of_a_read_export_is_identical(name, drawn):
    first = export(name, frames_of(drawn), **bands_option(name))
    with tempfile.TemporaryDirectory() as folder:
        source = write_exported_files(Path(folder), first)
        again = convert(name, source, name, **bands_option(name))

    assert again.keys() == first.keys()
    for file in labels_of(first):
        if name == "kitti" or not file.startswith("labelmap"):
            assert again[file] == first[file], file


@SLOW
@given(drawn=FRAMES)
def test_exported_file_names_are_unique_without_case_and_safe(drawn):
    for name in EXPORT_FORMATS:
        files = export(name, frames_of(drawn))

        folded = {file.casefold() for file in files}
        assert len(folded) == len(files)
        for file in files:
            assert ".." not in file.split("/")
            assert not file.startswith("/")
            assert "\\" not in file
