"""Exported labels that are read again are equal, within the format's precision.

The truncation in KITTI labels is the share of a box outside of the image.
"""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from filter_core.annotation.frame import frame_boxes_2d
from filter_core.annotation.parsing import parse_annotation
from filter_core.formats.registry import EXPORT_FORMATS, FORMATS, read_source
from filter_core.geometry.boxes import correct_xyxy, pixel_bounds, to_xyxy
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
PRECISION = {
    "yolo": 2e-7,
    "carlasimu": 2e-7,
    "coco": 1e-8,
    "kitti": 1e-4,
    "voc": 1.0,
    "manifest": 0.0,
    "cvat": 1e-8,
    "label-studio": 1e-9,
    "decisions-jsonl": 0.0,
}

UNCHANGED = ("manifest", "decisions-jsonl")
"""Formats that hold boxes as they were given."""

WITH_VERDICTS = ("cvat", "label-studio", "decisions-jsonl")
"""Formats that hold verdicts, which depend on pictures."""

READ_AND_WRITTEN = [name for name in EXPORT_FORMATS if FORMATS[name].read]

KEYS = st.text(
    st.characters(codec="utf-8", exclude_categories=("Cc", "Cs")),
    min_size=1,
    max_size=20,
)


def rectangle(x, y, beyond):
    """Corners from (start, extent) on each axis; two sides move out by `beyond`.

    Edges that are nearly whole are whole: those that were rounded come back so.
    """
    (x_min, width), (y_min, height) = x, y
    edges = x_min - beyond, y_min, x_min + width, y_min + height + beyond
    return tuple(
        float(round(edge)) if abs(edge - round(edge)) < 0.02 else edge for edge in edges
    )


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
    labels = {}
    for source in read_source(folder):
        assert source.problem is None, source.problem
        parsed = parse_annotation(source.annotation or {})
        names = [each.class_name for each in parsed.boxes]
        labels[source.key] = names, frame_boxes_2d(parsed, WH).xyxy
    return labels


def as_lists(labels):
    """Labels whose numbers can be compared."""
    return {key: (names, xyxy.tolist()) for key, (names, xyxy) in labels.items()}


@pytest.mark.parametrize("name", READ_AND_WRITTEN)
@given(drawn=FRAMES)
def test_labels_that_are_read_again_are_those_and_are_exported_alike(name, drawn):
    """Alike within the precision of the format, and byte by byte the second time."""
    first = export(name, frames_of(drawn), **bands_option(name))
    with tempfile.TemporaryDirectory() as folder:
        source = write_exported_files(Path(folder) / "first", first)
        labels = read_labels(source)
        again = convert(name, source, name, **bands_option(name))
        copy = write_exported_files(Path(folder) / "again", again)
        if name in WITH_VERDICTS:
            assert as_lists(read_labels(copy)) == as_lists(labels)

    assert again.keys() - first.keys() == set()
    for file in labels_of(first) if name not in WITH_VERDICTS else ():
        if name == "kitti" or not file.startswith("labelmap"):
            assert again[file] == first[file], file
    assert set(labels) == set(drawn)
    for key, boxes in drawn.items():
        names, rectangles = labels[key]
        word = {"kitti": "traffic_light", "carlasimu": "street_light"}.get(name)
        words = {"traffic light": word} if word else {}
        assert names == [words.get(word, word) for word, _ in boxes]
        given_xyxy = np.array([xyxy for _, xyxy in boxes], float).reshape(-1, 4)
        if name not in UNCHANGED:
            given_xyxy = np.clip(given_xyxy, 0, [*WH, *WH])
        atol = PRECISION[name]
        np.testing.assert_allclose(rectangles, given_xyxy, rtol=0, atol=atol)


WHOLE = st.lists(
    st.tuples(
        st.tuples(st.integers(0, WH[0] - 1), st.integers(1, WH[0])),
        st.tuples(st.integers(0, WH[1] - 1), st.integers(1, WH[1])),
    ).map(lambda spans: rectangle(*spans, 0)),
    min_size=1,
    max_size=8,
)


def pixels(rectangles, wh=WH):
    corrected, _ = correct_xyxy(rectangles, wh)
    return pixel_bounds(corrected, wh).tolist()


def check_pixels_after_reading_again(name, rectangles):
    boxes = [box(number, xyxy) for number, xyxy in enumerate(rectangles)]
    with tempfile.TemporaryDirectory() as folder:
        source = write_exported_files(Path(folder), export(name, [frame("a", *boxes)]))
        ((_, read),) = read_labels(source).values()

    assert pixels(read) == pixels(rectangles)


@pytest.mark.parametrize("name", READ_AND_WRITTEN)
@given(rectangles=WHOLE)
def test_whole_rectangles_have_the_same_pixels_when_they_are_read_again(
    name, rectangles
):
    check_pixels_after_reading_again(name, rectangles)


@pytest.mark.parametrize("name", ["yolo", "coco", "manifest"])
@given(drawn=st.lists(RECTANGLES.filter(bool), min_size=1, max_size=1))
def test_other_rectangles_have_the_same_pixels_where_nine_decimals_are_written(
    name, drawn
):
    # Multiples of a 64th of a pixel: nine decimals tell them from the tolerance.
    rectangles = [(np.rint(np.array(xyxy) * 64) / 64).tolist() for _, xyxy in drawn[0]]
    check_pixels_after_reading_again(name, rectangles)


@given(
    wh=st.tuples(st.integers(1, 4096), st.integers(1, 4096)),
    corners=st.tuples(*[st.integers(0, 4096)] * 4),
    decimals=st.sampled_from([6, 7, 8]),
)
def test_shares_with_six_decimals_have_the_pixels_of_the_whole_rectangle(
    wh, corners, decimals
):
    """YOLO's labels as most programs write them, from whole corners in the image."""
    (x0, x1), (y0, y1) = (
        sorted(min(corner, side) for corner in corners[axis::2])
        for axis, side in enumerate(wh)
    )
    corners_size = [(x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0]
    shares = np.array(corners_size) / [*wh, *wh]

    read = to_xyxy("cxcywhn", [np.round(shares, decimals)], wh)

    assert pixels(read, wh) == pixels([[x0, y0, x1, y1]], wh)


CORNERS = st.one_of(st.sampled_from([0.0, -0.0, 80.0, 100.0]), st.floats(-30, 130))


@st.composite
def any_rectangles(draw):
    """Rectangles, some of which lie partly or wholly outside the image, or touch it."""
    x, y = (
        sorted([draw(CORNERS), draw(CORNERS)]),
        sorted([draw(CORNERS), draw(CORNERS)]),
    )
    return [x[0], y[0], x[1], y[1]]


def share_outside_image(xyxy):
    """The share of a rectangle that lies outside the image, from 0 to 1."""
    whole = (xyxy[2] - xyxy[0]) * (xyxy[3] - xyxy[1])
    width = min(xyxy[2], WH[0]) - max(xyxy[0], 0)
    height = min(xyxy[3], WH[1]) - max(xyxy[1], 0)
    return 1 - max(width, 0) * max(height, 0) / whole


@given(rows=st.lists(any_rectangles(), max_size=6))
def test_kitti_truncation_is_the_share_of_the_given_box_outside_the_image(rows):
    corrected, _ = correct_xyxy(np.array(rows, float).reshape(-1, 4), WH)
    visible = [
        (index, xyxy)
        for index, xyxy in enumerate(corrected.tolist())
        if min(xyxy[2] - xyxy[0], xyxy[3] - xyxy[1]) >= 0.01
    ]
    boxes = [box(at, xyxy, given={"xyxy": rows[at]}) for at, xyxy in visible]

    files = export("kitti", [frame("a", *boxes)], split=1.0, images="none")

    lines = files["training/label_2/000000.txt"].decode().splitlines()
    told = [float(line.split()[1]) for line in lines]
    expected = [share_outside_image(rows[at]) for at, _ in visible]
    np.testing.assert_allclose(told, expected, atol=1e-4)
