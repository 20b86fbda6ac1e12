"""Checks of every format: registration, counts, stable bytes, memory, file names."""

import json
import math
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from pkgutil import iter_modules

import pytest

from filter_core import formats
from filter_core.errors import NotAvailable
from filter_core.formats.export import ExportError, ExportOptions
from filter_core.formats.files import FileNames, file_stem, folder_sink
from filter_core.formats.format import Format
from filter_core.formats.registry import (
    EXPORT_FORMATS,
    FORMATS,
    format_of,
    read_source,
    write_export,
)
from tests.support.exporting import HEAD, box, export, frame, sample_frames
from tests.support.folders import write_files


def test_every_declared_format_is_registered():
    """A `Format` that is declared but not listed could never be used."""
    modules = [
        import_module(module.name)
        for module in iter_modules(formats.__path__, "filter_core.formats.")
    ]
    declared = {
        value.name
        for module in modules
        for value in vars(module).values()
        if isinstance(value, Format)
    }

    assert declared == set(FORMATS)
    for form in FORMATS.values():
        assert (form.read is None) == (form.recognise is None)
        assert form.read or form.write
        assert form.write or not form.options


@pytest.mark.parametrize("name", EXPORT_FORMATS)
def test_export_is_deterministic_and_its_counts_add_up(name):
    files = export(name, sample_frames(7))

    assert files == export(name, sample_frames(7))
    counts = json.loads(files["manifest.json"])["counts"]["boxes"]
    assert counts["in"] == 70
    assert counts["in"] == counts["out"] + counts["dropped"] + counts["dontcare"]
    with pytest.raises(ExportError, match="expected 71 boxes, found 70"):
        export(name, sample_frames(7), replace(HEAD, expected_boxes=71))
    part = {"split": 1.0} if "split" in FORMATS[name].options else {}
    empty = export(name, [frame("only/one")], **part)

    assert json.loads(empty["manifest.json"])["counts"]["frames"]["in"] == 1
    exported = b"".join(
        content for file, content in empty.items() if file != "manifest.json"
    )
    # Tables have a row for each box, so they only count a frame without boxes.
    assert b"one" in exported or "decision_columns" in FORMATS[name].needs


MOST_BYTES_PER_FRAME = 300


@pytest.fixture(scope="module")
def memory_growth_per_frame(tmp_path_factory):
    """The bytes by which each format's peak memory grows with each frame.

    The least of up to three measurements: what Parquet's library allocates varies, and
    memory that is really needed is needed each time.
    """
    least: dict[str, float] = dict.fromkeys(EXPORT_FORMATS, math.inf)
    command = [sys.executable, "-m", "tests.support.memory_of_exports"]
    for _ in range(3):
        folder = str(tmp_path_factory.mktemp("exports"))
        measured = subprocess.run(
            [*command, folder], check=True, capture_output=True, text=True
        )
        for name, growth in json.loads(measured.stdout).items():
            least[name] = min(least[name], growth)
        if max(least.values()) < MOST_BYTES_PER_FRAME:
            break
    return least


@pytest.mark.long
@pytest.mark.parametrize("name", EXPORT_FORMATS)
def test_memory_does_not_grow_with_the_dataset(name, memory_growth_per_frame):
    """Of a frame only a trace of its name stays in memory, nothing of its boxes."""
    assert memory_growth_per_frame[name] < MOST_BYTES_PER_FRAME


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("ylo", {}, "unknown format 'ylo'; the nearest is 'yolo'"),
        ("cvat", {"bands": [50]}, "format 'cvat' has no option 'bands'"),
        ("yolo", {"rejected": "dontcare"}, "format 'yolo' has no option 'rejected'"),
        ("manifest", {"split": 0.5}, "format 'manifest' has no option 'split'"),
        ("decisions-csv", {"include": "all"}, "no option 'include'; it has none"),
    ],
)
def test_unknown_format_or_unsupported_option_is_refused(name, options, words):
    with pytest.raises(ExportError) as caught:
        format_of(name, ExportOptions.from_mapping(options))

    assert words in caught.value.detail


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"colour": 1}, "options: expected only include, "),
        ({"include": "some"}, "include: expected one of effective, kept, all"),
        ({"boxes": 3}, "boxes: expected one of"),
        ({"split": 1.1}, "split: expected a share from 0 to 1"),
        ({"split": -0.1}, "split: expected a share from 0 to 1"),
        ({"split": "80%"}, "split: expected a number, found '80%'"),
        ({"split": True}, "split: expected a number, found True"),
        ({"include_unmeasured": "no"}, "expected true or false, found 'no'"),
        ({"bands": "50m"}, "bands: expected a number, found '50m'"),
        ({"bands": [50, "a"]}, "bands: expected a number, found 'a'"),
        ({"bands": [0]}, "bands: expected whole metres from 1"),
        ({"bands": [50.5]}, "bands: expected whole metres"),
        ({"bands": list(range(1, 40))}, "bands: expected at most 16 distances"),
    ],
)
def test_invalid_export_option_is_refused_with_its_pointer(options, words):
    with pytest.raises(ExportError, match="expected") as caught:
        ExportOptions.from_mapping(options)

    assert words in caught.value.detail
    assert caught.value.pointer.startswith("/options")
    # Valid bands are sorted, each once.
    assert ExportOptions.from_mapping({"bands": [100, 50, 100]}).bands == (50, 100)


def test_parquet_without_pyarrow_error_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)

    with pytest.raises(NotAvailable, match=r"pip install 'unghost\[parquet\]'"):
        format_of("decisions-parquet", ExportOptions())


LIGATURES = ["\ufb01", "fi", "STRASSE", "stra\u00dfe"]
CASE_VARIANTS = ["A/7", "a/7", "\u00c9", "\u00e9", "E\u0301", *LIGATURES]


@pytest.mark.parametrize("name", EXPORT_FORMATS)
def test_exported_file_names_are_unique_ignoring_case(name, tmp_path):
    keys = sorted(CASE_VARIANTS)
    files = export(name, [frame(key, box(0)) for key in keys])

    assert len({file.casefold() for file in files}) == len(files)
    if FORMATS[name].read:
        again = read_source(write_files(tmp_path, files))
        assert sorted(frame.key for frame in again) == keys


@pytest.mark.parametrize("name", ["coco", "yolo"], ids=["sub-folders", "flat names"])
def test_first_of_case_colliding_names_is_not_renamed(name):
    frames = [frame(key, box(0)) for key in sorted(CASE_VARIANTS)]
    files = export(name, frames, split=1)

    renamed = json.loads(files["manifest.json"])["renamed"]
    digests = [row["frame"] for row in renamed if "%~" in row["file"]]
    assert "a/7" in digests
    assert "A/7" not in digests
    assert len(digests) == 4


def test_flat_name_collision_adds_a_suffix_and_a_dot_of_a_folder_is_escaped():
    names = FileNames(flat=True)

    first, second = names.stem("a/b"), names.stem("a__b")

    assert first == "a__b"
    assert second.startswith("a__b%~")
    assert file_stem("a.png/b.png") == "a%2Epng/b.png"


def test_export_folder_is_written_completely_or_not_at_all(tmp_path):
    target = tmp_path / "made" / "here"

    with pytest.raises(ExportError, match="found 1"):
        write_into(target, replace(HEAD, expected_boxes=2))
    assert list(target.parent.iterdir()) == []
    write_into(target, HEAD)
    assert (target / "labels" / "train" / "a.txt").is_file()
    with pytest.raises(ExportError, match="a new or an empty folder"):
        write_into(target, HEAD)


def write_into(folder, head):
    """Export one frame as YOLO into a folder."""
    with folder_sink(folder) as sink:
        options = ExportOptions(split=(1.0,))
        write_export("yolo", [frame("a", box(0))], sink, head, options)


@pytest.mark.parametrize("name", ["/etc/x", "../x", "a/../../x", "a\\b", ""])
def test_path_traversal_in_an_export_file_name_is_refused(tmp_path, name):
    with (
        pytest.raises(ExportError, match="not a valid file name"),
        folder_sink(tmp_path / "out") as sink,
    ):
        sink(name, [b""])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("{", "frames.jsonl, line 1: expected JSON"),
        ("[]", "frames.jsonl, line 1: expected an object"),
        ('{"file": 1, "key": "a"}', "expected file and key"),
        ('{"file": "a.png", "key": ""}', "expected a key and a map"),
        (
            '{"file": "a.png", "key": "a"}\n' * 2,
            "line 2: expected each file and key once",
        ),
    ],
)
def test_invalid_frames_jsonl_is_refused(tmp_path, lines, words):
    folder = write_files(tmp_path, {"labels/a.txt": "", "classes.txt": "car"})
    write_files(folder, {"frames.jsonl": lines})

    with pytest.raises(ValueError, match="frames") as caught:
        read_source(folder)

    assert words in str(caught.value)
