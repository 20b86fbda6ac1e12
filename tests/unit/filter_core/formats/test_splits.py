"""The parts of a recording: read from lists, COCO's files and folders, and made."""

import json
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from filter_core.formats.export import ExportError
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.registry import EXPORT_FORMATS, FORMATS, read_source
from filter_core.formats.splits import part_by_shares, sequence_of, shares_of
from tests.support.exporting import (
    black,
    box,
    convert,
    export,
    frame,
    write_exported_files,
)
from tests.support.folders import write_files

IMAGE = black((100, 80))
YEARS = ("train2017", "val2017")
LABEL = "0 0.5 0.5 0.1 0.2"
NAMES = "names: [car]\n"
KITTI = "Car 0.00 0 -10 10 20 30 60 -1 -1 -1 -1000 -1000 -1000 -10"
VOC_LABEL = (
    "<annotation><size><width>100</width><height>80</height></size><object>"
    "<name>car</name><bndbox><xmin>1</xmin><ymin>1</ymin><xmax>9</xmax><ymax>9</ymax>"
    "</bndbox></object></annotation>"
)


def coco(name):
    image = {"id": 1, "file_name": name, "width": 100, "height": 80}
    row = {"id": 1, "image_id": 1, "category_id": 1, "bbox": [1, 1, 9, 9]}
    categories = [{"id": 1, "name": "car"}]
    document = {"images": [image], "annotations": [row], "categories": categories}
    return json.dumps(document)


def yolo(*stems, labels="labels"):
    """Images and labels in `images/` and `labels/` below the folders of the stems."""
    files = {}
    for stem in stems:
        folder, _, name = stem.rpartition("/")
        above = f"{folder}/" if folder else ""
        files[f"{above}images/{name}.png"] = IMAGE
        files[f"{above}{labels}/{name}.txt"] = LABEL
    return files


def parts_of(folder, **options):
    """The part of each frame by its key."""
    frames = read_source(folder, options=RecordingDescription(**options))
    return {frame.key: (frame.annotation or {}).get("split") for frame in frames}


@pytest.mark.parametrize(
    ("files", "parts"),
    [
        (
            yolo("train/1", "valid/2", "test/3") | {"data.yaml": NAMES},
            {"train/1": "train", "valid/2": "valid", "test/3": "test"},
        ),
        # Roboflow's paths, and those of another machine.
        (
            yolo("day/1", "valid/2", "night/3")
            | {
                "data.yaml": f"{NAMES}train: ../day/images\nval: ../valid/images\n"
                "test: /content/data/night/images\n"
            },
            {"day/1": "train", "valid/2": "valid", "night/3": "test"},
        ),
        (
            yolo("1", "2", "3")
            | {
                "data.yaml": f"{NAMES}train: /data/a/train.txt\nval: val.txt\n",
                "train.txt": "..\n/content/a/images/1.png\n",
                "val.txt": "./images/2.png\n",
            },
            {"1": "train", "2": "val", "3": None},
        ),
        # A list wins over a folder; a list of two parts tells nothing.
        (
            {f"training/label_2/{n}.txt": KITTI for n in "123"}
            | {f"training/image_2/{n}.png": IMAGE for n in "123"}
            | {"ImageSets/train.txt": "1\n", "ImageSets/val.txt": "2\n"}
            | {"ImageSets/trainval.txt": "1\n2\n"},
            {"training/1": "train", "training/2": "val", "training/3": None},
        ),
        (
            {f"Annotations/{n}.xml": VOC_LABEL for n in "12"}
            | {f"JPEGImages/{n}.png": IMAGE for n in "12"}
            | {"ImageSets/Main/train.txt": "1\n", "ImageSets/Main/val.txt": "2\n"}
            | {"ImageSets/Main/car_val.txt": "1 -1\n2  1\n"}
            | {"ImageSets/Layout/val.txt": "1\n"},
            {"1": "train", "2": "val"},
        ),
        (
            {
                f"annotations/instances_{part}.json": coco(f"{part}/a.png")
                for part in YEARS
            }
            | {f"images/{part}/a.png": IMAGE for part in YEARS},
            {"train2017/a": "train2017", "val2017/a": "val2017"},
        ),
        # Names that begin like those of parts are none, unless one is for training.
        (
            yolo("test_drive_1/1", "test_drive_2/2") | {"data.yaml": NAMES},
            {"test_drive_1/1": None, "test_drive_2/2": None},
        ),
        (
            yolo("test_drive/train/1", "test_drive/val/2") | {"data.yaml": NAMES},
            {"test_drive/train/1": "train", "test_drive/val/2": "val"},
        ),
        # Both parts were elsewhere: this folder tells neither.
        (
            yolo("1")
            | {
                "data.yaml": f"{NAMES}train: /a/train/images\n"
                f"val: /{'a' * 300}/val/images\n"
            },
            {"1": None},
        ),
        (
            yolo("day_train/1", "day_val/2") | {"data.yaml": NAMES},
            {"day_train/1": "day_train", "day_val/2": "day_val"},
        ),
    ],
)
def test_parts_are_read_from_lists_files_of_labels_and_folders(tmp_path, files, parts):
    write_files(tmp_path, files)

    frames = read_source(tmp_path)
    read = {frame.key: (frame.annotation or {}).get("split") for frame in frames}

    assert read == {key.removeprefix("training/"): part for key, part in parts.items()}
    said = Counter(filter(None, parts.values()))
    note = ", ".join(f"{name} {count}" for name, count in said.items())
    assert any(note in text for text in frames.notes()) == bool(said)


def test_description_says_what_tells_the_parts(tmp_path):
    lists = {"train.txt": "valid/images/1.png", "data.yaml": NAMES}
    write_files(tmp_path, yolo("valid/1") | lists)

    said = {how: parts_of(tmp_path, split=how) for how in ("auto", "folders", "none")}

    assert said["auto"] == {"valid/1": "train"}
    assert said["folders"] == {"valid/1": "valid"}
    assert said["none"] == {"valid/1": None}


LABELS = [name for name in EXPORT_FORMATS if "split" in FORMATS[name].options]


@pytest.mark.parametrize("name", [*LABELS, "manifest"])
def test_every_format_keeps_the_parts_under_their_names(name, tmp_path):
    parts = {"a/1": "train", "b/1": "valid", "c/1": "test", "d/1": "held out"}
    frames = [
        frame(key, box(0), split=part, annotation={"split": part})
        for key, part in parts.items()
    ]
    files = export(name, frames)
    source = write_exported_files(tmp_path / "first", files)

    if FORMATS[name].read:
        assert parts_of(source) == parts
        # Also in another format, and from there.
        again = write_exported_files(tmp_path / "again", convert("voc", source))
        assert parts_of(again) == parts
    if name == "yolo":
        paths = b"train: images/train\nval: images/valid\ntest: images/test\n"
        assert paths in files["data.yaml"]
    if name == "cvat":
        assert files["annotations.xml"].count(b'subset="valid"') == 1


@pytest.mark.parametrize(
    ("key", "given_name", "sequence"),
    [
        ("town/run2/0007", None, "town/run2"),
        ("train/run2/front/0007", None, "run2"),
        ("valid/run2_0007_png.rf.4b0e99a7", None, "run2"),
        ("run2_0007", None, "run2"),
        ("CAM_LEFT/0007", None, None),
        ("0007", None, None),
        ("0007", "drive 1", "drive 1"),
    ],
)
def test_sequence_is_what_the_annotation_says_else_the_beginning_of_the_key(
    key, given_name, sequence
):
    assert sequence_of(key, given_name) == sequence


SHARES = st.sampled_from([(0.8, 0.1, 0.1), (0.5, 0.5), (0.7,), (0.2, 0.6, 0.2)])


@given(
    shares=SHARES,
    first=st.integers(0, 10**6),
    count=st.integers(1, 200),
    town=st.sampled_from([None, "Town01", "Town10HD"]),
    word=st.text("abc", max_size=3),
)
def test_numbered_sequences_of_a_map_get_their_shares_and_stay_whole(
    shares, first, count, town, word
):
    share_of = shares_of(shares)
    parts = {}
    for number in range(first, first + count):
        drive = f"{word}{number}"
        of_drive = {
            part_by_shares(f"{drive}/{camera}{frame:06}", town, None, share_of)
            for frame in (0, 1, 9999)
            for camera in ("", "front/")
        }
        (parts[drive],) = of_drive  # a sequence is never on two sides
    # What is put in alone, or with others, has the same part: names alone decide.
    counts = Counter(parts.values())
    for part, share in share_of.items():
        # Of 300,000 counts, the worst was off by 2.5; chance would be off by 10.
        assert abs(counts[part] - share * count) <= 3


@given(shares=SHARES, count=st.integers(30, 300), seed=st.integers(0, 100))
def test_sequences_without_numbers_get_about_their_shares(shares, count, seed):
    share_of = shares_of(shares)
    words = [
        f"{'xyz'[n % 3]}{n * 7919 + seed:b}".translate({48: "a", 49: "b"})
        for n in range(count)
    ]

    counts = Counter(part_by_shares(f"{word}/1", "T", None, share_of) for word in words)

    for part, share in share_of.items():
        assert abs(counts[part] / count - share) < 2.5 / count**0.5


def test_asked_shares_replace_parts_and_are_counted(tmp_path):
    frames = [
        frame(f"drive{drive}/{number}", box(0), split="test")
        for drive in range(10)
        for number in range(3)
    ]

    files = export("coco", frames, split=[0.5, 0.3, 0.2])

    counts = json.loads(files["manifest.json"])["counts"]
    assert counts["split"] == {"by_sequence": 30}
    assert sum(counts["sequences"].values()) == 10
    for name, drives in counts["sequences"].items():
        images = json.loads(files[f"annotations/instances_{name}.json"])["images"]
        assert len({image["key"].split("/")[0] for image in images}) == drives
        assert len(images) == 3 * drives == counts["frames"][name]


def of_towns(counts):
    return [
        frame(f"{town}/{number:03}", box(0), map=town)
        for town, count in counts.items()
        for number in range(count)
    ]


def parts_of_towns(files):
    lines = map(json.loads, files["frames.jsonl"].decode().splitlines())
    return Counter((line["map"], line["part"]) for line in lines)


@pytest.mark.parametrize(
    ("split", "expected"),
    [
        ([0.8], {"train": 32, "val": 8}),
        ([0.7, 0.2, 0.1], {"train": 28, "val": 8, "test": 4}),
        ([0.1, 0.3, 0.6], {"train": 4, "val": 12, "test": 24}),
    ],
)
def test_shares_of_each_map_are_exact(split, expected):
    towns = {"Town01": 40, "Town02": 40}

    files = export("yolo", of_towns(towns), split=split, split_by="map")

    assert parts_of_towns(files) == {
        (town, part): count for town in towns for part, count in expected.items()
    }


def test_whole_maps_are_the_part_for_validation():
    frames = of_towns({"Town01": 3, "Town02": 4, "Town03": 5})

    parts = parts_of_towns(export("yolo", frames, val_maps="Town02, Town03"))

    assert parts == {("Town01", "train"): 3, ("Town02", "val"): 4, ("Town03", "val"): 5}
    with pytest.raises(ExportError, match="no frame is of the map 'Town2'; there are"):
        export("yolo", frames, val_maps="Town01,Town2")
    contradictions: list[dict[str, object]] = [{"split_by": "map"}, {"val_maps": ["a"]}]
    contradictions.append({"val_maps": "a", "split": [0.8]})
    for options in contradictions:
        with pytest.raises(ExportError, match="expected"):
            export("yolo", of_towns({"a": 1}), **options)
