"""Patterns of paths: which files a recording's frames have, by its description."""

import json

import pytest

from filter_core.errors import LayoutError
from filter_core.formats.reading import RECORDING_NAME
from filter_core.formats.registry import read_source
from filter_core.formats.tables.patterns import FilePattern
from tests.support.folders import annotation_of, write_files

BOXES = {"boxes": [{"class": "car", "xyxy": [1, 2, 3, 4]}], "map": "Town01"}


@pytest.mark.parametrize(
    ("pattern", "path", "values"),
    [
        ("rgb{frame}.png", "rgb7.png", {"frame": "7"}),
        ("{camera}_{frame}.png", "front_left_7.png",
         {"camera": "front_left", "frame": "7"}),
        ("{run}/{run}_{frame}.png", "a/a_7.png", {"run": "a", "frame": "7"}),
        ("{run}/{run}_{frame}.png", "a/b_7.png", None),
        ("{frame}.*", "7.jpeg", {"frame": "7"}),
        ("**/{frame}.png", "a/b/7.png", {"frame": "7"}),
        ("**/{frame}.png", "7.png", {"frame": "7"}),
        ("{frame}.png", "a/7.png", None),
        ("a\\{frame}.png", "a/7.png", {"frame": "7"}),
        ("({frame}).png", "(7).png", {"frame": "7"}),
        ("é{frame}.png", "é7.png", {"frame": "7"}),
    ],
)  # fmt: skip
def test_pattern_gives_the_values_of_its_names(pattern, path, values):
    assert FilePattern(pattern).match(path) == values


def test_files_belong_together_by_the_names_that_their_patterns_share(tmp_path):
    description = """
    files:
      image: "CAM_{camera}/{frame}.png"
      segmentation: "SEG_{camera}/{frame}.png"
      lidar: "lidar/{frame}.ply"
      labels: "CAM_{camera}/{frame}.json"
      ignore: ["**/preview/**"]
    """
    files = {
        RECORDING_NAME: description,
        **dict.fromkeys(("CAM_left/0007.png", "CAM_right/0007.png", "SEG_left/7.png")),
        **dict.fromkeys(("CAM_left/preview/1.png", "SEG_left/8.png", "other.png")),
        "CAM_left/0007.json": json.dumps(BOXES),
        "lidar/0007.ply": "ply\n",
    }
    write_files(tmp_path, files)

    pairs = read_source(tmp_path, "pairs")
    left, right = pairs

    assert [left.key, right.key] == ["left/0007", "right/0007"]
    assert left.segmentation == tmp_path / "SEG_left/7.png"  # the same number
    assert left.others == right.others == {"lidar": tmp_path / "lidar/0007.ply"}
    assert (annotation_of(left), right.segmentation) == (BOXES, None)
    assert annotation_of(right) == {"boxes": []}
    assert {file.path: file.why for file in pairs.unmatched} == {
        "other.png": "no pattern of `files` fits it",
        "SEG_left/8.png": "no image for this segmentation",
    }
    # An annotation in a table's place is read as one, too; an image needs its labels.
    table = read_source(tmp_path)
    assert (table.layout, [frame.key for frame in table]) == ("table", ["left/0007"])
    assert annotation_of(next(iter(table))) == BOXES


def test_most_specific_pattern_wins_and_key_says_how_frames_are_called(tmp_path):
    description = """
    files: {image: "{run}/{frame}.png", segmentation: "{run}/{frame}_seg.png"}
    key: "{frame} of {run}"
    """
    write_files(tmp_path, {RECORDING_NAME: description, "a/1.png": None})
    write_files(tmp_path, dict.fromkeys(("a/1_seg.png", "b/1.png")))
    # No pattern of labels: an annotation has the name of its image.
    write_files(tmp_path, {"b/1.json": json.dumps(BOXES), "2.json": json.dumps(BOXES)})

    frames = read_source(tmp_path)
    first, second = frames

    assert (frames.layout, frames.count) == ("pairs", 2)
    assert (first.key, second.key) == ("1 of a", "1 of b")
    assert first.segmentation == tmp_path / "a/1_seg.png"
    assert (annotation_of(first), annotation_of(second)) == ({"boxes": []}, BOXES)
    assert [file.path for file in frames.unmatched] == ["2.json"]


@pytest.mark.parametrize(
    ("description", "words"),
    [
        ("files: {image: '{frame}.png'}\nkey: '{camera}/{frame}'",
         "key: expected only names that files.image has (frame), found 'camera'"),
        ("layout: yolo\nfiles: {labels: '{frame}.txt'}\nboxes: {classes: [car]}",
         "layout 'yolo' has no pattern of labels"),
        ("layout: manifest\nfiles: {image: '{frame}.png'}",
         "layout 'manifest' has no option 'files'"),
        ("layout: yolo\nfiles: {segmentation: '{frame}.png'}\nboxes: {classes: [car]}"
         "\nsegmentation: {folder: seg}", "expected either segmentation.folder or"),
        ("files: {image: '{frame}.png', labels: '{frame}.csv'}\n"
         "segmentation: {folder: seg}", "expected segmentation among `files`"),
    ],
)  # fmt: skip
def test_description_that_contradicts_itself_is_refused(tmp_path, description, words):
    write_files(tmp_path, {RECORDING_NAME: description, "1.png": None})
    write_files(tmp_path, {"seg/1.png": None, "1.txt": "0 .5 .5 .1 .1"})

    with pytest.raises(LayoutError) as caught:
        read_source(tmp_path)

    assert words in caught.value.detail


def test_link_out_of_the_folder_is_its_frames_problem(tmp_path):
    """A point cloud of patterns may be a link to any file of this machine."""
    description = "files: {image: '{frame}.png', lidar: '{frame}.ply'}"
    folder = write_files(tmp_path / "in", {RECORDING_NAME: description, "1.png": None})
    write_files(tmp_path, {"private": "secret", "in/2.png": None})
    (folder / "1.ply").symlink_to(tmp_path / "private")

    bad, good = read_source(folder)

    assert "expected a file in the folder" in str(bad.problem)
    assert good.problem is None
