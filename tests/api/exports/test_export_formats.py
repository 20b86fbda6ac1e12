"""An export that is pushed again gives the same labels; options are checked."""

import json
import zipfile
from pathlib import Path

import pytest
import yaml

from filter_core.annotation.parsing import parse_annotation
from filter_core.formats.registry import read_source
from tests.support import frames as scene
from tests.support.api import BY_TAGS
from tests.support.folders import write_carlasimu, write_files
from tests.support.sensors import ANNOTATION, sensors
from unghost import Client, Invalid
from unghost.wire.words import ExportFormat

KEYS = ["run/000001", "Run/000001", "straße 7", "v1.2.dots", "empty"]
CLASSES = ["walker", "traffic light", "car"]


def fill(client: Client, name: str) -> str:
    """Make a dataset: frames with a kept and a rejected box, and one without boxes."""
    client.create_dataset(name, classes=CLASSES)
    for number, key in enumerate(KEYS):
        boxes = [] if key == "empty" else scene.annotation()["boxes"]
        scene.put(client, name, key, number, mine={"number": number}, boxes=boxes)
    return name


@pytest.fixture(scope="module")
def filled_dataset(server):
    with Client(server.url, server.token) as client:
        return fill(client, "formats")


def export_and_unpack(
    client: Client, dataset: str, form: ExportFormat, folder: Path, **options
) -> Path:
    """Export a dataset and unpack the download into `folder`."""
    done = client.wait_for_export(client.start_export(dataset, form, **options))
    archive = client.download(done, folder.with_suffix(".zip"))
    with zipfile.ZipFile(archive) as packed:
        assert packed.testzip() is None
        packed.extractall(folder)
    return folder


def labels(folder: Path) -> dict[str, bytes]:
    """Every file but manifest.json, which says where the labels came from."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in files
        if path.name != "manifest.json"
    }


def boxes_of(folder: Path) -> dict[str, set[tuple[object, ...]]]:
    """The boxes that are read from an export, by frame."""
    return {
        frame.key: {
            (box.id, box.class_name, box.form, box.values)
            for box in parse_annotation(frame.annotation or {}).boxes
        }
        for frame in read_source(folder)
    }


def test_ids_of_64_bits_come_back_with_all_digits(client, tmp_path):
    name, ids = "long-ids", [2**64 - 1, 2**64 - 2, 2**53 + 1]
    boxes = [{"id": n, "class": "car", "xyxy": scene.ON_THE_CAR} for n in ids]
    client.create_dataset(name)
    scene.put(client, name, "a", boxes=boxes)

    assert {box.id for box in client.boxes(name)} == set(map(str, ids))
    for form in ("manifest", "decisions-jsonl", "decisions-csv", "coco"):
        folder = export_and_unpack(client, name, form, tmp_path / form)
        content = b"".join(labels(folder).values())
        assert all(str(number).encode() in content for number in ids), form


@pytest.mark.parametrize("form", ["coco", "voc", "decisions-jsonl"])
def test_export_pushed_again_gives_the_same_labels(
    unghost, client, filled_dataset, tmp_path, form
):
    first = export_and_unpack(client, filled_dataset, form, tmp_path / "first")
    again = client.create_dataset(f"again-{form}", classes=CLASSES).name

    push = unghost("push", first, "--dataset", again)
    second = export_and_unpack(client, again, form, tmp_path / "second")

    assert push.code == 0, push.err
    assert [frame.key for frame in client.frames(again)] == sorted(KEYS)
    if form == "decisions-jsonl":  # it has verdicts, which this push does not keep
        assert boxes_of(second) == boxes_of(first)
    else:
        assert labels(second) == labels(first)


def test_roboflow_folders_keep_parts_and_names_in_the_same_format(
    unghost, client, tmp_path
):
    box = {"id": 1, "image_id": 0, "category_id": 1, "bbox": [1, 2, 3, 4]}
    listed = {
        "images": [{"id": 0, "file_name": "a.rf.1.jpg", "width": 64, "height": 48}],
        "annotations": [box],
        "categories": [{"id": 1, "name": "car", "supercategory": "cars"}],
    }
    parts = ("test", "train", "valid")
    jpeg = {f"{part}/a.rf.1.jpg": scene.image() for part in parts}
    coco = {f"{part}/_annotations.coco.json": json.dumps(listed) for part in parts}
    yolo = {f"{part}/images/a.rf.1.jpg": scene.image() for part in parts}
    yolo |= {f"{part}/labels/a.rf.1.txt": b"0 0.5 0.5 0.1 0.2" for part in parts}
    folders: dict[ExportFormat, Path] = {
        "coco": write_files(tmp_path / "coco", {**jpeg, **coco}),
        "yolo": write_files(tmp_path / "yolo", {**yolo, "data.yaml": "names: [car]"}),
    }

    for form, folder in folders.items():
        name = f"roboflow-{form}"
        push = unghost("push", folder, "--dataset", name)
        exported = export_and_unpack(client, name, form, tmp_path / f"{form}-out")

        assert push.code == 0, push.err
        assert [frame.key for frame in client.frames(name)] == [
            f"{part}/a.rf.1" for part in parts
        ]
        images = exported.glob("images/**/*.*")
        assert sorted(image.relative_to(exported).as_posix() for image in images) == [
            f"images/{part}/a.rf.1.png" for part in parts
        ]
        assert json.loads((exported / "manifest.json").read_text())["renamed"] == []
        again = read_source(exported)
        assert {(frame.key, (frame.annotation or {})["split"]) for frame in again} == {
            (f"{part}/a.rf.1", part) for part in parts
        }
        if form == "coco":
            assert [path.name for path in sorted(exported.glob("annotations/*"))] == [
                f"instances_{part}.json" for part in parts
            ]


def test_a_tree_of_carlasimu_comes_back_from_a_server(unghost, client, tmp_path):
    boxes = [("0 0.2 0.5 0.1 0.2", 20), ("0 0.75 .5 0.1 0.2", 60)]
    source = write_carlasimu(tmp_path / "theirs", boxes)

    push = unghost("push", source, "--dataset", "theirs")
    chosen = {"include": "all", "drawn": True, "pictures": 1}
    made = export_and_unpack(client, "theirs", "carlasimu", tmp_path / "out", **chosen)

    assert push.code == 0, push.err
    for band in (50, 100, 150, 200):
        name = f"out/cam/labels/label{band}/00000993.txt"
        assert (made / name).read_bytes() == (source / name).read_bytes()
    readmes = [
        json.loads((folder / "out/cam/Readme.txt").read_text())
        for folder in (made, source)
    ]
    assert readmes[0] == readmes[1] | {"classes": readmes[0]["classes"]}
    for name in ("seg/00000993.png", "depth/00000993.png", "radar/00000993.ply"):
        assert (made / "out" / name).read_bytes() == (
            source / "out" / name
        ).read_bytes()
    for folder in ("images_bbox", "images_bbox_filter"):
        assert (made / f"out/cam/{folder}/00000993.png").stat().st_size > 0
    assert "00000993" in (made / "pictures/index.html").read_text()


def test_parts_are_told_before_an_export_as_they_come_out(unghost, client, tmp_path):
    name = client.create_dataset("planned").name
    keys = [f"{town}/drive{n}/{i}" for town in "ab" for n in range(5) for i in (1, 2)]
    for number, key in enumerate(keys):
        said = {"sequence": "one"} if number == 3 else {}
        said |= {"split": "test"} if number < 2 else {}
        client.put_frame(name, key, scene.annotation() | said, image=scene.image())
    command = ("export", name, "--format", "yolo", "--output", tmp_path / "out.zip")

    for split in ([], [0.5], [0.6, 0.2, 0.2]):
        planned = client.parts(name, split)
        done = client.wait_for_export(client.start_export(name, "coco", split=split))

        told = {key: dict(done.counts[key]) for key in ("frames", "split")}
        parts = {part: told["frames"].get(part) for part in planned.frames}
        assert (parts, told["split"]) == (dict(planned.frames), dict(planned.split))
        assert done.counts.get("sequences", {}) == dict(planned.sequences)
        assert sum(planned.frames.values()) == len(keys)
    exported = unghost(*command, "--split", "0.6,0.2,0.2")

    before, _, _ = exported.err.partition("parts: ")
    assert f"asked for train 60%: {planned.frames['train']}" in before
    with pytest.raises(Invalid, match="sum is 1"):
        client.parts(name, [0.8, 0.3])
    with pytest.raises(Invalid):
        client.parts(name, [2])


BESIDE_COCO = {
    "info": {"year": 2026, "contributor": "Straße"},
    "licenses": [{"id": 4, "name": "by"}, {"id": 5, "name": "nc"}],
    "videos": [{"id": 1, "name": "town"}],
    "type": "instances",
}
BESIDE_YOLO = {"nc": 1, "kpt_shape": [0, 2], "roboflow": {"version": 3}, "license": "x"}


@pytest.mark.parametrize("form", ["coco", "yolo"])
def test_what_a_file_says_beside_its_frames_comes_back(unghost, client, tmp_path, form):
    categories = [
        {"id": 7, "name": "car", "supercategory": "vehicle"},
        {"id": 9, "name": "unused", "supercategory": "none of them"},
    ]
    boxes = [{"id": n, "image_id": n, "category_id": 7} for n in (1, 2)]
    annotations = [box | {"bbox": [1, 2, 3, 4]} for box in boxes]
    named = [{"id": n, "file_name": f"{n}.png"} for n in (1, 2)]
    sized = [{**box, "width": 64, "height": 48} for box in named]
    lists = {"images": sized, "annotations": annotations, "categories": categories}
    labels_of: dict[str, dict[str, bytes | str]] = {
        "coco": {"boxes.json": json.dumps({**BESIDE_COCO, **lists})},
        "yolo": {
            **{f"labels/{n}.txt": b"0 0.5 0.5 0.1 0.2" for n in (1, 2)},
            "data.yaml": yaml.safe_dump(
                {"names": ["car"], "path": "/x", **BESIDE_YOLO}
            ),
        },
    }
    images = {f"images/{n}.png": scene.image() for n in (1, 2)}
    companions = {"velodyne/1.bin": b"points", "README.txt": b"by hand"}
    folder = write_files(
        tmp_path / "source", {**labels_of[form], **images, **companions}
    )

    push = unghost("push", folder, "--dataset", f"b-{form}")
    exported = export_and_unpack(client, f"b-{form}", form, tmp_path / "exported")

    assert push.code == 0, push.err
    absent = "2 files belong to no frame and were not sent, by folder: . 1, velodyne 1"
    assert absent in push.err
    manifest = json.loads((exported / "manifest.json").read_text("utf-8"))
    assert manifest["companions_absent"] == {".": 1, "velodyne": 1}
    if form == "yolo":
        document = yaml.safe_load((exported / "data.yaml").read_text())
        own = ("train", "val", "names")
        assert {k: v for k, v in document.items() if k not in own} == BESIDE_YOLO
        return
    for part in exported.glob("annotations/*.json"):
        document = json.loads(part.read_text("utf-8"))
        beside = {key: v for key, v in document.items() if key not in lists}
        assert (beside, document["categories"]) == (BESIDE_COCO, categories)


def test_parts_of_a_folder_come_through_the_service(unghost, client, tmp_path):
    parts = ("train", "valid", "test")
    line = b"0 0.5 0.5 0.1 0.2"
    files = {f"{part}/images/1.png": scene.image() for part in parts}
    files |= {f"{part}/labels/1.txt": line for part in parts}
    folder = write_files(tmp_path / "split", {**files, "data.yaml": "names: [car]"})

    push = unghost("push", folder, "--dataset", "split")
    kept = export_and_unpack(client, "split", "voc", tmp_path / "kept")
    other = unghost(
        *("export", "split", "--format", "coco", "--output", tmp_path / "other.zip"),
        *("--split", "0.5,0.5"),
    )

    assert push.code == 0, push.err
    assert "parts as they came: train 1, valid 1, test 1" in push.err
    assert client.frame_by_key("split", "valid/1").split == "valid"
    for part in parts:
        listed = (kept / f"ImageSets/Main/{part}.txt").read_text("utf-8")
        assert listed == f"{part}__1\n"
    assert "3 frames are split one by one" in other.err
    last = next(iter(client.exports("split"))).counts
    assert last["split"] == {"without_sequence": 3}
    assert sum(last["frames"].get(part, 0) for part in ("train", "val")) == 3


def test_kitti_export_applies_bands_and_dontcare_regions(
    client, filled_dataset, tmp_path
):
    folder = export_and_unpack(
        client,
        filled_dataset,
        "kitti",
        tmp_path / "out",
        bands=[50],
        rejected="dontcare",
    )

    for name in ("label_2", "label50"):
        lines = (folder / "training" / name / "000000.txt").read_text().splitlines()
        assert [line.split()[0] for line in lines] == ["car", "DontCare"]


@pytest.mark.parametrize(
    ("form", "options", "pointer"),
    [
        ("nothing", {}, "/format"),
        ("cvat", {"bands": [50]}, "/options/bands"),
        ("yolo", {"bands": [0]}, "/options/bands/0"),
        ("yolo", {"colour": 1}, "/options/colour"),
    ],
)
def test_unknown_format_or_invalid_option_raises_invalid(
    client, filled_dataset, form, options, pointer
):
    with pytest.raises(Invalid) as caught:
        client.start_export(filled_dataset, form, **options)

    assert caught.value.status == 422
    assert pointer in str(caught.value.errors)


def test_tight_rectangles_are_exported_as_labels(client, tmp_path):
    name = client.create_dataset("tight", classes=["car"], config=BY_TAGS).name
    client.put_frame(name, "a", ANNOTATION, **sensors())
    client.wait(client.evaluate(name))
    # Nothing of the box behind is visible, so its rectangle stays as it is.
    options = {"boxes": "tight", "allow_missing_images": True}
    coco = export_and_unpack(client, name, "coco", tmp_path / "coco", **options)
    yolo = export_and_unpack(client, name, "yolo", tmp_path / "yolo", **options)

    tight = [61.0, 41.0, 38.0, 38.0]
    rectangles = [
        box["bbox"]
        for path in coco.rglob("annotations/*.json")
        for box in json.loads(path.read_text("utf-8"))["annotations"]
    ]
    assert tight in rectangles
    x, y, width, height = tight
    label = [(x + width / 2) / 160, (y + height / 2) / 120, width / 160, height / 120]
    (text,) = [path.read_text() for path in yolo.rglob("labels/**/*.txt")]
    lines = [[float(word) for word in line.split()[1:]] for line in text.splitlines()]
    assert any(line == pytest.approx(label, abs=1e-6) for line in lines)
    manifest = json.loads((coco / "manifest.json").read_text("utf-8"))
    assert manifest["counts"]["rectangles"] == {"tight": 1, "visible": 1}
