"""Writing the demo's street as a dataset: manifest, files, truth and progress."""

import json
from pathlib import Path

import pytest

from filter_core.formats.manifest import read_manifest
from filter_core.formats.recording import RecordingDescription
from tests.support.demo_street import LAID_LINKS, LINKED_TEXT, demo_street

# Rendering one frame takes seven seconds.
pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def street():
    return demo_street()


def read_json_lines(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_written_street_has_manifest_line_and_data_files(street, demo_frames):
    frame, (line,) = demo_frames[0].frame, read_json_lines(street.manifest)

    assert {name: line[name] for name in frame.annotation} == frame.annotation
    assert line["image"] == "rgb/town-a/000000.png"
    for name in ("image", "segmentation", "instances", "depth"):
        data = (street.folder / line[name]).read_bytes()
        assert data == getattr(frame, f"{name}_png")
    assert (street.folder / line["lidar"]).read_bytes() == frame.lidar_npy


def test_truth_is_a_separate_file_and_not_in_the_manifest(street, demo_frames):
    frame = demo_frames[0].frame

    truth = read_json_lines(street.folder / "truth.jsonl")

    assert truth == [{"key": frame.key, **row} for row in frame.truth]
    assert not {"ghost", "visible"} & set(frame.annotation["boxes"][0])
    assert "ghost" not in street.manifest.read_text()


def test_writing_reports_progress_and_leaves_no_part_files(street):
    parts = {path.relative_to(street.folder) for path in street.folder.rglob("*.part")}

    assert street.progress == [(1, 1)]
    assert parts <= set(map(Path, LAID_LINKS))


def test_street_is_written_through_no_link_in_its_folder(street):
    (line,) = read_json_lines(street.manifest)

    assert street.linked.read_text() == LINKED_TEXT
    assert line["image"] in LAID_LINKS
    assert not (street.folder / line["image"]).is_symlink()


def test_written_manifest_can_be_read_without_problems(street):
    (source,) = read_manifest(street.manifest, RecordingDescription()).frames()

    assert (source.key, source.problem) == ("town-a/000000", None)
