"""Filtering many frames locally: order, threads, reading ahead, and faults."""

import json
import os
from dataclasses import replace

import pytest

from filter_core.arrays import NOT_MEASURED
from filter_core.config.filter import FilterConfig
from filter_core.formats.export import ExportFrame
from filter_core.formats.reading import FrameSource
from filter_core.formats.registry import FORMATS, read_source
from filter_core.local import export_sources, filter_one, filter_source
from tests.support.folders import street_tags, write_files
from tests.support.pictures import painted, png
from tests.support.sensors import scene_source


@pytest.fixture
def folder(tmp_path):
    """Twelve YOLO frames; the segmentation of the fourth is cut off."""
    files: dict[str, object] = {"classes.txt": "car\nwalker\n"}
    for number in range(12):
        files[f"images/{number:03}.png"] = None
        files[f"labels/{number:03}.txt"] = (
            "0 0.375 0.41666667 0.5 0.5\n1 0.8125 0.79166667 0.125 0.25\n"
        )
        tags = png(painted(street_tags((10, 10, 50 - number, 40))))
        files[f"seg/{number:03}.png"] = tags[:100] if number == 3 else tags
    return write_files(tmp_path, files)


@pytest.mark.parametrize("workers", [None, 1, 7])
def test_frames_are_filtered_in_order_despite_an_invalid_frame(folder, workers):
    frames, config = read_source(folder), FilterConfig()
    outcomes = list(filter_source(frames, config, workers=workers))

    assert [each.key for each in outcomes] == [f"{number:03}" for number in range(12)]
    bad = {outcome.key: outcome.error["code"] for outcome in outcomes if outcome.error}
    assert bad == {"003": "bad_image"}
    verdicts = [[box["verdict"] for box in each.decisions or ()] for each in outcomes]
    assert verdicts[0] == ["kept", "rejected"]
    assert outcomes[0].palette == "carla-0.9.14"
    alone = filter_source(frames, config, workers=2)
    lines = [json.dumps(outcome.as_dict(), allow_nan=False) for outcome in outcomes]
    assert lines == [json.dumps(outcome.as_dict()) for outcome in alone]


def test_only_a_few_frames_are_read_ahead():
    taken = 0

    def endless():
        nonlocal taken
        while True:
            taken += 1
            yield FrameSource(f"{taken}", {"boxes": [], "camera": SIZE})

    outcomes = filter_source(endless(), FilterConfig(), workers=2)

    assert [next(outcomes).key for _ in range(5)] == ["1", "2", "3", "4", "5"]
    assert taken <= 20
    outcomes.close()


SIZE = {"width": 80, "height": 60}


def test_outcome_error_has_100_annotation_faults_and_counts_the_rest():
    boxes = [{"class": "car"}, {"class": "car", "xyxy": [1, 2, 3]}] * 500
    source = FrameSource("k", {"boxes": boxes, "camera": SIZE})

    (outcome,) = filter_source([source], FilterConfig())

    assert outcome.error is not None
    assert outcome.error["code"] == "bad_annotation"
    pointers = [error["pointer"] for error in outcome.error["errors"]]
    assert pointers[:2] == ["/boxes/0", "/boxes/1/xyxy"]
    assert (len(pointers), outcome.error["more_errors"]) == (100, 900)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("gone.png", "gone.png cannot be read: "),
        ("pipe.png", "pipe.png cannot be read: not a regular file"),
    ],
)
@pytest.mark.parametrize("kind", ["segmentation", "image"])
def test_missing_file_or_pipe_is_named_without_its_folder(tmp_path, kind, name, words):
    os.mkfifo(tmp_path / "pipe.png")
    annotation = {"boxes": []} if kind == "image" else {"boxes": [], "camera": SIZE}
    source = FrameSource("k", annotation, **{kind: tmp_path / name})

    (outcome,) = filter_source([source], FilterConfig())

    assert outcome.error is not None
    assert f"{kind}: {words}" in outcome.error["detail"]
    assert str(tmp_path) not in outcome.error["detail"]


def test_ignore_mask_file_of_a_frame_is_applied(folder):
    mask = (street_tags() == 14).astype("uint8") * 255
    write_files(folder, {"mask.png": png(mask)})
    frame = next(iter(read_source(folder)))
    masked = replace(frame, others={"ignore_mask": folder / "mask.png"})

    (outcome,) = filter_source([masked], FilterConfig())

    assert [box["matched_pixels"] for box in outcome.decisions or ()] == [0, 0]


def test_a_channel_reads_the_files_that_it_needs(tmp_path):
    source = scene_source(tmp_path)
    lidar = tmp_path / "lidar"
    lidar.write_bytes(b"not read")
    source = replace(source, others={**source.others, "lidar": lidar})

    def outcome(channel):
        return filter_one(source, FilterConfig(evidence=channel)).as_dict()

    assert outcome("depth")["decisions"][1]["reason"] == "hidden_by_depth"
    assert outcome("auto")["decisions"][1]["reason"] == "hidden_by_instance"
    assert "PLY or NPY" in outcome("lidar")["error"]["detail"]


@pytest.mark.parametrize("form", ["decisions-csv", "decisions-parquet"])
def test_table_exports_get_columns_instead_of_decision_objects(form):
    boxes = [
        {"class": "car", "xyxy": [10, 10, 60, 40], "distance": 7.5},
        {"class": "car", "xyxy": [300, 10, 360, 40]},
    ]
    camera = {"width": 200, "height": 100, "fov": 90}
    source = FrameSource("a", annotation={"boxes": boxes, "camera": camera})

    table, lines = (
        next(export_sources([source], FilterConfig(), needs=FORMATS[name].needs))
        for name in (form, "decisions-jsonl")
    )

    assert isinstance(table, ExportFrame)
    assert isinstance(lines, ExportFrame)
    assert lines.columns is None
    assert table.decisions == ()
    assert table.columns is not None
    assert list(table.boxes.ids) == [box["id"] for box in lines.decisions]
    assert table.columns.config == lines.decisions[0]["config"]
    assert table.columns.matched_pixels.tolist() == [NOT_MEASURED, NOT_MEASURED]
