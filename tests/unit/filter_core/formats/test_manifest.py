"""Reading manifests: each line is a frame, and a bad line does not stop the others."""

import json

import pytest

from filter_core.errors import LayoutError
from filter_core.formats.manifest import FRAME_FILES
from filter_core.formats.reading import MAX_LABEL_BYTES
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.registry import read_source
from filter_core.formats.streams.outside import OUTSIDE_FILES_HINT
from filter_core.values import shown
from tests.support.folders import write_files

FRAME = {"key": "a/0", "boxes": [{"class": "car", "xyxy": [1, 2, 3, 4]}]}


def write(tmp_path, *lines):
    path = tmp_path / "frames.jsonl"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def test_paths_are_absolute_or_relative_to_the_manifest_or_a_named_folder(tmp_path):
    inside = str(tmp_path / "seg/0.png")
    files = {"image": "rgb/../rgb/0.png", "segmentation": inside, "depth": "d/0.png"}
    path = write(tmp_path, json.dumps({**FRAME, **files, "map": "Town01"}))

    (frame,) = read_source(path)

    assert frame.key == "a/0"
    assert frame.image == tmp_path / "rgb/../rgb/0.png"
    assert str(frame.segmentation) == inside
    assert frame.others == {"depth": tmp_path / "d/0.png"}
    assert frame.annotation == {"boxes": FRAME["boxes"], "map": "Town01"}
    path = write(tmp_path, json.dumps({**FRAME, "segmentation": "0.png"}))
    options = RecordingDescription(segmentation=tmp_path / "seg")

    (frame,) = read_source(path, options=options)

    assert frame.segmentation == tmp_path / "seg/0.png"


@pytest.fixture
def town(tmp_path):
    """A folder for a manifest, with links, and a picture beside it."""
    write_files(tmp_path, {"private.png": None, "town/rgb/0.png": None})
    town = tmp_path / "town"
    (town / "link.png").symlink_to(tmp_path / "private.png")
    (town / "out").symlink_to(tmp_path)
    (town / "in").symlink_to("rgb")
    return town


@pytest.mark.parametrize("kind", FRAME_FILES)
@pytest.mark.parametrize(
    "name",
    ["ABSOLUTE", "../private.png", "..\\private.png", "link.png", "out/private.png"],
)
def test_file_outside_the_folder_is_the_problem_of_its_frame(town, kind, name):
    name = name.replace("ABSOLUTE", str(town.parent / "private.png"))
    lines = [{**FRAME, "key": "bad", kind: name}, {**FRAME, "image": "in/0.png"}]
    path = write(town, *map(json.dumps, lines))

    bad, good = read_source(path)
    allowed, _ = read_source(path, options=RecordingDescription(outside_files=True))

    assert str(bad.problem) == (
        f"frames.jsonl, line 1, {kind}: expected a file in the manifest's folder, "
        f"found {shown(name)}, which is or leads outside; {OUTSIDE_FILES_HINT}"
    )
    assert (bad.annotation, bad.image, bad.segmentation) == (None, None, None)
    assert bad.others == {}
    assert (good.problem, good.image) == (None, town / "in/0.png")
    named = {"image": allowed.image, "segmentation": allowed.segmentation}
    image = {**named, **allowed.others}[kind]
    assert image is not None
    assert image.samefile(town.parent / "private.png")


def test_path_that_no_file_can_have_is_the_problem_of_its_frame(tmp_path):
    path = write(tmp_path, json.dumps({**FRAME, "image": "a\0b"}), json.dumps(FRAME))

    bad, good = read_source(path)

    assert "found the text 'a\\x00b'" in str(bad.problem)
    assert good.problem is None


def test_manifest_that_is_a_link_to_a_file_outside_is_refused(tmp_path):
    write_files(tmp_path, {"secret.jsonl": json.dumps(FRAME), "town/1.png": None})
    link = tmp_path / "town/manifest.jsonl"
    link.symlink_to(tmp_path / "secret.jsonl")

    with pytest.raises(LayoutError, match=r"manifest\.jsonl, which is or leads out"):
        read_source(tmp_path / "town")
    allowed = RecordingDescription(outside_files=True)
    assert [frame.key for frame in read_source(link)] == ["a/0"]
    assert [frame.key for frame in read_source(link.parent, options=allowed)] == ["a/0"]


def test_single_manifest_is_found_by_any_name_and_may_have_paths_of_windows(tmp_path):
    lines = json.dumps({**FRAME, "image": "0.png"})
    write_files(tmp_path, {"run/town.jsonl": lines, "frames.jsonl": "{}"})

    (frame,) = read_source(tmp_path, "manifest")

    assert frame.image == tmp_path / "run/0.png"
    write_files(tmp_path, {"d/rgb/0.png": None, "d/manifest.jsonl": ""})
    files = {"image": "rgb\\0.png", "depth": "no\\0.png"}
    (tmp_path / "d/manifest.jsonl").write_text(json.dumps({**FRAME, **files}))

    (frame,) = read_source(tmp_path / "d")

    assert frame.image == tmp_path / "d/rgb/0.png"
    assert frame.others == {"depth": tmp_path / "d/no/0.png"}


def test_byte_order_mark_and_empty_lines_are_ignored(tmp_path):
    path = write(tmp_path, "\ufeff" + json.dumps(FRAME), "", "  ", json.dumps(FRAME))

    assert [frame.problem for frame in read_source(path)] == [None, None]


LONG = '{"key": "' + "x" * (2 * MAX_LABEL_BYTES)


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
        pytest.param(LONG, f"expected at most {MAX_LABEL_BYTES} bytes", id="too long"),
    ],
)
def test_invalid_line_is_reported_and_the_next_is_read(tmp_path, line, words):
    path = write(tmp_path, json.dumps(FRAME), line, json.dumps(FRAME))

    first, bad, last = read_source(path)

    assert words in str(bad.problem)
    assert bad.annotation is None
    assert first.problem is last.problem is None
    assert last.key == "a/0"
