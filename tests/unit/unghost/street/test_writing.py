"""Writing the demo's street as a dataset: manifest, files, truth and progress."""

from __future__ import annotations

import json

import pytest

from filter_core.formats.manifest import read_manifest
from filter_core.formats.reading import ReadOptions
from unghost.street.street import write_street


@pytest.fixture(scope="module")
def written_dataset(tmp_path_factory):
    """The manifest of a dataset of one frame, and the progress that was reported."""
    folder, said = tmp_path_factory.mktemp("demo") / "street", []
    manifest = write_street(folder, 1, progress=lambda *step: said.append(step))
    return manifest, said


def read_json_lines(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


@pytest.mark.long
def test_written_street_has_manifest_line_and_data_files(written_dataset, demo_frames):
    manifest, _ = written_dataset
    frame, (line,) = demo_frames[0].frame, read_json_lines(manifest)

    assert {name: line[name] for name in frame.annotation} == frame.annotation
    assert line["image"] == "rgb/town-a/000000.png"
    for name in ("image", "segmentation", "instances", "depth"):
        data = (manifest.parent / line[name]).read_bytes()
        assert data == getattr(frame, f"{name}_png")
    assert (manifest.parent / line["lidar"]).read_bytes() == frame.lidar_npy


@pytest.mark.long
def test_truth_is_a_separate_file_and_not_in_the_manifest(written_dataset, demo_frames):
    manifest, _ = written_dataset
    frame = demo_frames[0].frame

    truth = read_json_lines(manifest.parent / "truth.jsonl")

    assert truth == [{"key": frame.key, **row} for row in frame.truth]
    assert not {"ghost", "visible"} & set(frame.annotation["boxes"][0])
    assert "ghost" not in manifest.read_text()


def test_writing_reports_progress_and_leaves_no_part_files(written_dataset):
    manifest, said = written_dataset

    assert said == [(1, 1)]
    assert not list(manifest.parent.rglob("*.part"))


def test_street_is_written_through_no_link_in_its_folder(tmp_path):
    private = tmp_path / "private.txt"
    private.write_text("mine")
    folder = tmp_path / "street"
    links = ["manifest.part", "truth.part", "rgb/town-a/000000.png"]
    for link in links:
        (folder / link).parent.mkdir(parents=True, exist_ok=True)
        (folder / link).symlink_to(private)

    manifest = write_street(folder, 1)

    assert private.read_text() == "mine"
    assert len(read_json_lines(manifest)) == 1


def test_written_manifest_can_be_read_without_problems(written_dataset):
    (source,) = read_manifest(written_dataset[0], ReadOptions()).frames()

    assert (source.key, source.problem) == ("town-a/000000", None)
