"""`convert --to same`: a folder in its own format, without the rejected boxes."""

import json
import zipfile

import numpy as np
import pytest

from tests.support.folders import street_tags, write_files
from tests.support.pictures import painted, png

DONE, REFUSED, USAGE, PARTLY = 0, 1, 2, 3
PICTURE = png(np.full((60, 80, 3), (90, 120, 60), np.uint8))
STREET = png(painted(street_tags()))
"""A car from (10, 10) to (50, 40), and sky to the right of it."""

KITTI = """Car 0.00 0 1.570 12.00 12.00 40.00 38.00 1.50 1.60 4.00 1.00 2.00 20.00 0.10
DontCare -1 -1 -10 1 2 3 4 -1 -1 -1 -1000 -1000 -1000 -10
Car 0.25 2 -1.5 56 2 75 25 1.5 1.6 4 1 2 20 0.1
"""
CALIBRATION = "P0: 7.2e+02 0 40 0 0 7.2e+02 30 0 0 0 1 0\nP2: 72 0 40 -45.7 0 72 30 0 "
CALIBRATION += "0 0 1 2.7e-03\nR0_rect: 9.99e-01 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 7.5\n"
COCO = """{"info": {"year": 2024, "version": "1.0"}, "licenses": [{"id": 4}],
 "videos": [{"id": 1, "name": "drive"}],
 "images": [{"id": 900, "file_name": "000007.png", "width": 80, "height": 60,
   "license": 4, "video_id": 1}],
 "annotations": [
  {"id": 31, "image_id": 900, "category_id": 90, "bbox": [12.00, 12, 28.0, 26],
   "iscrowd": 0, "segmentation": [[12, 12, 40, 12, 40, 38.50]], "track": 7},
  {"id": 77, "image_id": 900, "category_id": 90, "bbox": [56, 2, 19, 23], "mine": 1.50}
 ],
 "categories": [{"id": 90, "name": "car", "supercategory": "vehicle"}]}
"""
VOC = """<annotation>
\t<folder>day1</folder>
\t<filename>000007.png</filename>
\t<path>C:\\data\\000007.png</path>
\t<source><database>mine</database></source>
\t<object><name>car</name><bndbox><ymin>13</ymin><xmin>13</xmin><xmax>40</xmax>
\t\t<ymax>38</ymax></bndbox><difficult>0</difficult><track>7</track></object>
\t<object><name>car</name><bndbox><xmin>57</xmin><ymin>3</ymin><xmax>75</xmax>
\t\t<ymax>25</ymax></bndbox></object>
\t<segmented>0</segmented>
</annotation>
"""
YOLO = "0 0.3250 0.416667 0.3500 0.4333333\n0 0.81875 0.225 0.2375 0.383333\n"
GHOST = ', {"xyxy": [56,2,75,25], "class": "car"}'
BOXES = '"weather": {"rain": 1.50}, "boxes": [{"xyxy": [12.0, 12, 40, 38],'
BOXES += f' "class": "car", "mine": 1.50}}{GHOST}]}}\n'
LINE = f'{{"key": "7", "image": "7.png", "segmentation": "seg/7.png", {BOXES}'
EXAMPLES = {
    "kitti": (
        {
            "training/image_2/000007.png": PICTURE,
            "training/segmentation/000007.png": STREET,
            "training/label_2/000007.txt": KITTI,
            "training/calib/000007.txt": CALIBRATION,
            "training/velodyne/000007.bin": b"\0\1\2\3",
            "ImageSets/train.txt": "000007",
        },
        {"training/label_2/000007.txt": "".join(KITTI.splitlines(keepends=True)[:2])},
    ),
    "coco": (
        {
            "annotations/instances_train.json": COCO,
            "train/000007.png": PICTURE,
            "seg/000007.png": STREET,
        },
        {
            "annotations/instances_train.json": COCO.replace(
                ',\n  {"id": 77, "image_id": 900, "category_id": 90, '
                '"bbox": [56, 2, 19, 23], "mine": 1.50}',
                "",
            )
        },
    ),
    "yolo": (
        {
            "data.yaml": "path: /datasets/mine\ntrain: train/images\n"
            "nc: 2\nnames: ['car', 'bus']\nroboflow: {version: 3}\n",
            "train/images/day 1/ü.png": PICTURE,
            "train/seg/day 1/ü.png": STREET,
            "train/labels/day 1/ü.txt": YOLO,
            "README.roboflow.txt": "Exported on May 3.",
        },
        {"train/labels/day 1/ü.txt": "0 0.3250 0.416667 0.3500 0.4333333\n"},
    ),
    "voc": (
        {
            "Annotations/000007.xml": VOC,
            "JPEGImages/000007.png": PICTURE,
            "seg/000007.png": STREET,
            "ImageSets/Main/train.txt": "000007\n",
        },
        {
            "Annotations/000007.xml": VOC.replace(
                "\n\t<object><name>car</name><bndbox><xmin>57</xmin><ymin>3</ymin>"
                "<xmax>75</xmax>\n\t\t<ymax>25</ymax></bndbox></object>",
                "",
            )
        },
    ),
    "carlasimu": (
        {
            "out/images/7.png": PICTURE,
            "out/labels/label200/7.txt": YOLO,
            "out/labels/label50/7.txt": YOLO.split("\n")[1],
            "out/seg/7.png": STREET,
        },
        {
            "out/labels/label200/7.txt": YOLO.split("\n")[0] + "\n",
            "out/labels/label50/7.txt": "",
        },
    ),
    "manifest": (
        {"manifest.jsonl": LINE, "7.png": PICTURE, "seg/7.png": STREET},
        {"manifest.jsonl": LINE.replace(GHOST, "")},
    ),
    "pairs": (
        {"7.json": f"{{{BOXES}", "7.png": PICTURE, "7_seg.png": STREET},
        {"7.json": f"{{{BOXES}".replace(GHOST, "")},
    ),
}
"""By layout: the files of a recording with a car and a ghost, and what is to be left
of its label files."""


def tree(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.mark.parametrize("layout", EXAMPLES)
def test_a_recording_in_its_own_format_lacks_only_the_ghost(
    layout, bare_unghost, tmp_path
):
    files, without_ghost = EXAMPLES[layout]
    source = write_files(tmp_path / "data", files)
    before = tree(source)

    result = bare_unghost(
        *("convert", source, "--filter", "--to", "same", "-o", "clean", "--json")
    )

    assert result.code == DONE, result.err
    expected = {name: text.encode() for name, text in without_ghost.items()}
    assert tree(tmp_path / "clean") == before | expected
    assert tree(source) == before
    assert "taken away: car 1 (no_visible_pixels 1)" in result.err.lower()
    (record,) = result.records
    assert record["boxes"] == {"in": 2, "out": 1, "dropped": 1}
    (reasons,) = record["taken_away"].values()
    assert reasons == {"no_visible_pixels": 1}


@pytest.mark.parametrize("layout", ["coco", "kitti"])
def test_a_format_to_itself_is_the_same_without_a_filter(
    layout, bare_unghost, tmp_path
):
    source = write_files(tmp_path / "data", EXAMPLES[layout][0])

    result = bare_unghost("convert", source, "--to", layout, "-o", "copy")
    anew = bare_unghost(
        *("convert", source, "--to", layout, "-o", "anew", "-O", "images=none")
    )

    assert (result.code, anew.code) == (DONE, DONE)
    assert result.out == "copy\t1 frames\t2 of 2 boxes\n"
    assert tree(tmp_path / "copy") == tree(source)
    assert (tmp_path / "anew/manifest.json").is_file()


def test_what_cannot_be_written_as_it_came_is_refused_with_the_reason(
    bare_unghost, tmp_path
):
    source = write_files(tmp_path / "data", EXAMPLES["kitti"][0])
    table = write_files(
        tmp_path / "table",
        {"1.png": PICTURE, "boxes.csv": "image,label,x1,y1,x2,y2\n1.png,car,1,2,3,4\n"},
    )
    same = ("--to", "same", "-o")

    inside = bare_unghost("convert", source, *same, source / "training/clean")
    around = bare_unghost("convert", source, *same, tmp_path)
    option = bare_unghost("convert", source, *same, "out", "-O", "split=0.5")
    files = EXAMPLES["coco"][0]
    band = {"annotations/label50/instances_train.json": COCO}
    write_files(tmp_path / "coco", files | band)
    bands = bare_unghost("convert", tmp_path / "coco", "--filter", *same, "out")
    rows = bare_unghost("convert", table, *same, "out")

    assert [result.code for result in (inside, around, rows, bands)] == [REFUSED] * 4
    assert option.code == USAGE
    for result in (inside, around):
        assert "expected a folder outside of the recording" in result.err
    assert "--option split is for labels that are written anew" in option.err
    assert "has boxes of instances_train.json again under other ids" in bands.err
    assert "layout table cannot be written as it came" in rows.err
    assert "yolo, coco, kitti, voc" in rows.err
    assert not (tmp_path / "out").exists()
    assert not list(source.rglob("clean"))


def test_frames_that_cannot_be_read_keep_their_labels(bare_unghost, tmp_path):
    files = EXAMPLES["yolo"][0] | {
        "train/images/bad.png": PICTURE,
        "train/labels/bad.txt": "0 one two three four\n",
    }
    source = write_files(tmp_path / "data", files)

    result = bare_unghost("convert", source, "--filter", "--to", "same", "-o", "clean")

    assert result.code == PARTLY
    assert "the labels of 1 refused frames were copied as they are" in result.err
    bad = (tmp_path / "clean/train/labels/bad.txt").read_text()
    assert bad == "0 one two three four\n"


def test_links_are_followed_out_of_the_folder_and_never_written_through(
    bare_unghost, tmp_path
):
    files, without_ghost = EXAMPLES["kitti"]
    whole = write_files(tmp_path / "whole", files)
    before = tree(whole)
    source = tmp_path / "data"
    (source / "training").mkdir(parents=True)
    for folder in ("image_2", "label_2", "segmentation"):
        (source / "training" / folder).symlink_to(whole / "training" / folder)
    (source / "labels").symlink_to("training/label_2")
    (source / "lost").symlink_to("nowhere")
    write_files(source, {"notes/a.txt": "a"})
    (source / "notes/b.txt").symlink_to("a.txt")

    result = bare_unghost("convert", source, "--filter", "--to", "same", "-o", "clean")

    assert result.code == DONE, result.err
    assert tree(whole) == before
    clean = tmp_path / "clean"
    name = "training/label_2/000007.txt"
    assert (clean / name).read_text() == without_ghost[name]
    assert (clean / "labels/000007.txt").read_text() == without_ghost[name]
    assert not (clean / "training/label_2").is_symlink()
    assert (clean / "notes/b.txt").readlink().as_posix() == "a.txt"
    assert (clean / "lost").is_symlink()
    picture = "training/image_2/000007.png"
    assert (clean / picture).samefile(whole / picture)


def test_of_a_coco_file_that_is_named_its_images_come_along(bare_unghost, tmp_path):
    files, without_ghost = EXAMPLES["coco"]
    more = {"annotations/7.png": PICTURE, "seg/000007.png": STREET, "other.bin": b"1"}
    (text,) = (content for content in files.values() if isinstance(content, str))
    (left,) = without_ghost.values()
    write_files(tmp_path / "data", {"a.json": text, "000007.png": PICTURE, **more})

    result = bare_unghost(
        *("convert", "data/a.json", "--filter", "--to", "same", "-o", "clean", "--json")
    )

    assert json.loads((tmp_path / "clean/a.json").read_text()) == json.loads(left)
    assert sorted(tree(tmp_path / "clean")) == [
        "000007.png",
        "a.json",
        "seg/000007.png",
    ]
    assert result.code == PARTLY  # one image is in no COCO file


def test_an_export_of_a_pushed_recording_has_the_bytes_of_its_label_files(
    unghost, tmp_path
):
    files, without_ghost = EXAMPLES["kitti"]
    source = write_files(tmp_path / "data", files)
    names = ("training/label_2/000007.txt", "training/calib/000007.txt")

    pushed = unghost("push", source, "--dataset", "same-kitti")
    result = unghost(
        *("export", "same-kitti", "--format", "kitti", "-o", "export.zip"),
        *("-O", "split=1"),
    )

    assert (pushed.code, result.code) == (DONE, DONE), pushed.err + result.err
    expected = {**files, **without_ghost}
    with zipfile.ZipFile(tmp_path / "export.zip") as archive:
        contents = {name: archive.read(name).decode() for name in names}
        manifest = json.loads(archive.read("manifest.json"))
    assert contents == {name: expected[name] for name in names}
    assert manifest["counts"]["boxes"]["dropped"] == 1
    assert manifest["frames_as_they_came"] == 1
