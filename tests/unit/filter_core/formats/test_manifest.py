"""Reading manifests: each line is a frame, and a bad line does not stop the others."""

from __future__ import annotations

import json

import pytest

from filter_core.formats.reading import MAX_LABEL_BYTES, ReadOptions
from filter_core.formats.registry import read_source
from tests.support.folders import write_files

FRAME = {"key": "a/0", "boxes": [{"class": "car", "xyxy": [1, 2, 3, 4]}]}


def write(tmp_path, *lines):
    path = tmp_path / "frames.jsonl"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def test_paths_are_relative_to_the_manifest_or_absolute(tmp_path):
    files = {"image": "rgb/0.png", "segmentation": "/else/0.png", "depth": "d/0.png"}
    path = write(tmp_path, json.dumps({**FRAME, **files, "map": "Town01"}))

    (frame,) = read_source(path)

    assert frame.key == "a/0"
    assert frame.image == tmp_path / "rgb/0.png"
    assert str(frame.segmentation) == "/else/0.png"
    assert frame.others == {"depth": tmp_path / "d/0.png"}
    assert frame.annotation == {"boxes": FRAME["boxes"], "map": "Town01"}


def test_segmentation_paths_are_relative_to_the_given_folder(tmp_path):
    path = write(tmp_path, json.dumps({**FRAME, "segmentation": "0.png"}))

    (frame,) = read_source(path, options=ReadOptions(segmentation=tmp_path / "seg"))

    assert frame.segmentation == tmp_path / "seg/0.png"


def test_windows_paths_are_resolved(tmp_path):
    write_files(tmp_path, {"rgb/0.png": None, "d/manifest.jsonl": ""})
    files = {"image": "..\\rgb\\0.png", "depth": "no\\0.png"}
    (tmp_path / "d/manifest.jsonl").write_text(json.dumps({**FRAME, **files}))

    (frame,) = read_source(tmp_path / "d")

    assert frame.image == tmp_path / "d/../rgb/0.png"
    assert frame.others == {"depth": tmp_path / "d/no/0.png"}


def test_single_manifest_is_found_by_any_name_in_any_subfolder(tmp_path):
    lines = json.dumps({**FRAME, "image": "0.png"})
    write_files(tmp_path, {"run/town.jsonl": lines, "frames.jsonl": "{}"})

    (frame,) = read_source(tmp_path, "manifest")

    assert frame.image == tmp_path / "run/0.png"


def test_byte_order_mark_and_empty_lines_are_ignored(tmp_path):
    path = write(tmp_path, "\ufeff" + json.dumps(FRAME), "", "  ", json.dumps(FRAME))

    assert [frame.problem for frame in read_source(path)] == [None, None]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("{", "frames.jsonl, line 2: expected one JSON object, found a fault at col"),
        ("{\xff", "expected one JSON object, found a fault at column 2: Expecting pr"),
        ("[]", "found a list of 0"),
        ("[" * 100_000, "expected one JSON object"),
        ('{"boxes": []}', '"key" of 1 to 512 characters, found null'),
        ('{"key": 7}', "found 7"),
        (json.dumps({"key": "k" * 513}), '"key" of 1 to 512'),
        ('{"key": "a", "image": 3}', "line 2, image: expected a path, found 3"),
    ],
)
def test_invalid_line_is_reported_and_the_next_is_read(tmp_path, line, words):
    path = write(tmp_path, json.dumps(FRAME), line, json.dumps(FRAME))

    first, bad, last = read_source(path)

    assert words in str(bad.problem)
    assert bad.annotation is None
    assert first.problem is last.problem is None


def test_overlong_line_is_reported_and_the_next_is_read(tmp_path):
    line = '{"key": "' + "x" * (2 * MAX_LABEL_BYTES)
    path = write(tmp_path, line, json.dumps(FRAME))

    long, good = read_source(path)

    assert f"expected at most {MAX_LABEL_BYTES} bytes" in str(long.problem)
    assert good.key == "a/0"
