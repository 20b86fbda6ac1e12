"""Writing the demo's street as a dataset: manifest, files, truth and progress."""

from __future__ import annotations

import json

import pytest

from filter_core.formats.manifest import read_manifest
from filter_core.formats.reading import ReadOptions
from unghost.street.street import write_street


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The manifest of a dataset of one frame, and the progress that was reported."""
    folder, said = tmp_path_factory.mktemp("demo") / "street", []
    manifest = write_street(folder, 1, progress=lambda *step: said.append(step))
    return manifest, said


def lines_of(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


@pytest.mark.long
def test_a_written_street_is_a_manifest_and_its_files(written, demo_frames):
    manifest, _ = written
    frame, (line,) = demo_frames[0].frame, lines_of(manifest)

    assert {name: line[name] for name in frame.annotation} == frame.annotation
    assert line["image"] == "rgb/town-a/000000.png"
    for name in ("image", "segmentation", "instances", "depth"):
        data = (manifest.parent / line[name]).read_bytes()
        assert data == getattr(frame, f"{name}_png")
    assert (manifest.parent / line["lidar"]).read_bytes() == frame.lidar_npy


@pytest.mark.long
def test_truth_lies_beside_the_manifest_and_in_no_input(written, demo_frames):
    manifest, _ = written
    frame = demo_frames[0].frame

    truth = lines_of(manifest.parent / "truth.jsonl")

    assert truth == [{"key": frame.key, **row} for row in frame.truth]
    assert not {"ghost", "visible"} & set(frame.annotation["boxes"][0])
    assert "ghost" not in manifest.read_text()


def test_progress_is_told_and_nothing_unfinished_is_left(written):
    manifest, said = written

    assert said == [(1, 1)]
    assert not list(manifest.parent.rglob("*.part"))


def test_the_manifest_reads_back_without_a_problem(written):
    (source,) = read_manifest(written[0], ReadOptions()).frames()

    assert (source.key, source.problem) == ("town-a/000000", None)
