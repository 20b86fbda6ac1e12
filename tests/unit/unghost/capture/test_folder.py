import json

import pytest

from unghost.capture.folder import CaptureFolder, FrameRecord
from unghost.capture.simulator import CaptureError

RECORDING = {"scenario_digest": "d", "carla_version": "0.9.16", "map": "Town01"}
FILES = {"rgb": (".png", b"picture"), "lidar": (".ply", b"points")}
FRAME: FrameRecord = {
    "carla_version": "0.9.16",
    "map": "Town01",
    "weather": {},
    "camera": {},
    "sensors": {},
    "boxes": [],
    "extra": {},
    "captured_at": "2026-01-01T00:00:00Z",
}


@pytest.fixture
def folder(tmp_path):
    made = CaptureFolder(tmp_path / "out")
    made.open(RECORDING)
    return made


def manifest_lines(folder):
    text = (folder.path / "manifest.jsonl").read_text("utf-8")
    return [json.loads(line) for line in text.splitlines()]


def test_adding_a_frame_writes_its_files_and_a_manifest_line(folder, tmp_path):
    private = tmp_path / "private.txt"
    private.write_text("mine")
    (folder.path / "rgb").mkdir()
    laid = folder.path / "rgb" / ".000000.png.part"
    laid.symlink_to(private)

    folder.add("Town01/000000", FILES, {"boxes": [], "extra": {}})

    assert manifest_lines(folder) == [
        {
            "key": "Town01/000000",
            "image": "rgb/000000.png",
            "boxes": [],
            "extra": {"files": {"lidar_intensity": "lidar/000000.ply"}},
        }
    ]
    assert (folder.path / "rgb/000000.png").read_bytes() == b"picture"
    assert (folder.path / "lidar/000000.ply").read_bytes() == b"points"
    assert private.read_text() == "mine"
    assert list(folder.path.rglob("*.part")) == [laid]


@pytest.mark.parametrize(
    ("name", "error"), [("rgb", CaptureError), ("manifest.jsonl", OSError)]
)
def test_capture_with_a_link_in_place_of_a_part_is_refused(
    folder, tmp_path, name, error
):
    private = tmp_path / "private"
    image = private
    if name == "rgb":
        private.mkdir()
        image = private / "000000.png"
    image.write_text("mine, without a line break")
    (folder.path / name).symlink_to(private)

    with pytest.raises(CaptureError, match=f"{name} is a link"):
        CaptureFolder(folder.path).open(RECORDING)
    with pytest.raises(error, match=name):
        folder.add("Town01/000000", FILES, {"extra": {}})

    assert image.read_text() == "mine, without a line break"


@pytest.mark.parametrize("name", RECORDING)
def test_resuming_with_another_scenario_version_or_map_raises(folder, name):
    word = "scenario" if name == "scenario_digest" else name
    folder.add("Town01/000000", FILES, {"extra": {}})

    with pytest.raises(CaptureError, match=f"another {word}"):
        CaptureFolder(folder.path).open({**RECORDING, name: "other"})


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("capture.json", "[]", "contains no capture"),
        ("capture.json", '{"lens": "50 mm"}', "contains no capture"),
        ("thesis.tex", "x", "is not empty and contains no capture"),
    ],
)
def test_foreign_folder_raises_and_is_unchanged(tmp_path, name, content, words):
    (tmp_path / name).write_text(content)

    with pytest.raises(CaptureError, match=words):
        CaptureFolder(tmp_path).open(RECORDING)

    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == content


def test_frame_with_nan_raises_and_is_not_written(folder):
    with pytest.raises(ValueError, match="JSON"):
        folder.add("k", {}, {"extra": {}, "x": float("nan")})

    assert not (folder.path / "manifest.jsonl").exists()
