"""Reads exports with the programs that people use, and what these write with ours.

Every box is compared by number.

    python -m tools.check_readers

runs where they are installed (`make readers` sees to it): Ultralytics, supervision,
Datumaro, torchvision, Label Studio's converter and FiftyOne are too large, and bring
another OpenCV, to be part of the tests.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote

import numpy as np

PARTS: Final = ("train", "val")
VOC_EDGES: Final = ("xmin", "ymin", "xmax", "ymax")
FORMS: Final = ("yolo", "coco", "kitti", "voc", "cvat", "label-studio")
TOLERANCES: Final = {"voc": 1.0, "kitti": 0.01}
"""Pixels by which edges may differ: VOC's are whole, KITTI's have few decimals."""
TOLERANCE: Final = 1e-3
OF_READERS: Final = {
    "datumaro": 0.02,
    "datumaro voc": 1.0,
    "fiftyone voc": 1.0,
    "written by datumaro": 0.02,
    "written by supervision yolo": 0.02,
}
"""More, of programs: Datumaro has two decimals, and of VOC's last pixel its number;
FiftyOne takes VOC's first pixel for the second one, too; supervision has five decimals
of shares."""
WIDTH, HEIGHT = 1280, 720
"""Of the street's images, px."""
Row = tuple[str, float, float, float, float]
"""A class and a rectangle: left, top, right, bottom in px."""
Boxes = dict[str, list[Row]]
"""The boxes of each frame, by its key."""
Reader = Callable[[Path], Iterator[tuple[str, str, Boxes]]]
"""Gives its name, the format that it read, and what it found."""


def main() -> None:
    """Render, convert, read; exit code 1 if any reader found something else."""
    python = sys.argv[1] if len(sys.argv) > 1 else sys.executable
    with tempfile.TemporaryDirectory(prefix="readers-") as name:
        root = Path(name)
        _make(python, root)
        os.environ["YOLO_CONFIG_DIR"] = str(root / "settings")
        os.environ["YOLO_OFFLINE"] = "true"
        wrong = []
        expected = _boxes_of(root / "coco")
        for reader in READERS:
            for who, form, boxes in reader(root):
                if _differs(who, form, boxes, expected):
                    wrong.append(f"{who} {form}")
        for writer in WRITERS:
            for who, form in writer(root):
                boxes = _read_again(python, root, root / who / form)
                written = {key: expected.get(key, []) for key in boxes}
                if _differs(f"written by {who}", form, boxes, written):
                    wrong.append(f"what {who} wrote as {form}")
    if wrong:
        sys.exit(f"found something else: {', '.join(wrong)}")


def _make(python: str, root: Path) -> None:
    """Write a small filtered street in every format that other programs read."""
    render = (
        "import sys; from pathlib import Path; "
        "from unghost.street.street import write_street; "
        "write_street(Path(sys.argv[1]), 9)"
    )
    street = str(root / "street")
    subprocess.run([python, "-c", render, street], check=True)
    convert = [python, "-m", "unghost.cli", "convert", street, "--filter"]
    for form in FORMS:
        subprocess.run([*convert, "--to", form, "-o", str(root / form)], check=True)


def _differs(who: str, form: str, boxes: Boxes, expected: Boxes) -> bool:
    """Whether boxes are not what was expected; prints how many, and differences."""
    faults = list(_faults(who, form, boxes, expected))
    count = sum(map(len, boxes.values()))
    print(who, form, len(boxes), count, *faults[:3], sep="\t")
    return bool(faults)


def _read_again(python: str, root: Path, folder: Path) -> Boxes:
    """The boxes that Unghost reads in a folder which another program wrote."""
    again = root / "again" / folder.parent.name / folder.name
    convert = [python, "-m", "unghost.cli", "convert", str(folder), "--to", "coco"]
    subprocess.run([*convert, "-o", str(again), "-O", "images=none"], check=True)
    boxes = _boxes_of(again)
    return {_key(f"{key}.png"): rows for key, rows in boxes.items()}


def _boxes_of(folder: Path) -> Boxes:
    found: Boxes = {}
    for part in PARTS:
        path = folder / "annotations" / f"instances_{part}.json"
        document = json.loads(path.read_text("utf-8"))
        names = {one["id"]: one["name"] for one in document["categories"]}
        for image in document["images"]:
            found[image["key"]] = _rows_of(document, image["id"], names)
    return found


def _rows_of(
    document: Mapping[str, list[dict[str, Any]]], image: int, names: Mapping[int, str]
) -> list[Row]:
    """The boxes of one image of a COCO file."""
    return [
        (names[one["category_id"]], x, y, x + width, y + height)
        for one in document["annotations"]
        if one["image_id"] == image
        for x, y, width, height in [one["bbox"]]
    ]


def _key(path: str) -> str:
    """The key of a frame by a path of its image in an export."""
    stem = path.rpartition(".")[0] if path.endswith((".png", ".xml")) else path
    folders = ("images/", "JPEGImages/", "Annotations/")
    of_parts = [each for part in PARTS for each in (f"obj_{part}_data/", f"{part}/")]
    for folder in (*folders, *of_parts):
        stem = stem.rpartition(folder)[2]
    return stem.replace("__", "/")


def _keys_of_kitti(root: Path) -> dict[str, str]:
    """The key of each numbered frame."""
    lines = (root / "kitti" / "frames.jsonl").read_text("utf-8").splitlines()
    listed = map(json.loads, lines)
    return {Path(line["file"]).stem: line["key"] for line in listed}


def _faults(who: str, form: str, found: Boxes, expected: Boxes) -> Iterator[str]:
    """How what was found differs, in words."""
    if found.keys() != expected.keys():
        yield f"frames {sorted(found)[:3]}, expected {sorted(expected)[:3]}"
        return
    tolerance = TOLERANCES.get(form, TOLERANCE) + max(
        OF_READERS.get(who, 0), OF_READERS.get(f"{who} {form}", 0)
    )
    for name, rows in expected.items():
        if len(found[name]) != len(rows):
            yield f"{name}: {len(found[name])} boxes, expected {len(rows)}"
            continue
        # Rectangles that differ by less than the tolerance may be in another order.
        left = list(found[name])
        for row in rows:
            alike = [
                other
                for other in left
                # Types of KITTI have underscores.
                if row[0].replace(" ", "_") == other[0].replace(" ", "_")
                and np.allclose(row[1:], other[1:], rtol=0, atol=tolerance)
            ]
            if not alike:
                yield f"{name}: no {row}"
                break
            left.remove(alike[0])


def _ultralytics(root: Path) -> Iterator[tuple[str, str, Boxes]]:
    from ultralytics.data.dataset import YOLODataset
    from ultralytics.data.utils import check_det_dataset

    data: Any = check_det_dataset(str(root / "yolo" / "data.yaml"), autodownload=False)
    found: Boxes = {}
    for part in PARTS:
        for label in YOLODataset(
            img_path=data[part], data=data, task="detect", augment=False
        ).labels:
            height, width = label["shape"]
            rows = zip(label["cls"].ravel(), label["bboxes"].tolist(), strict=True)
            found[_key(label["im_file"])] = [
                (
                    data["names"][int(number)],
                    *_edges([x - w / 2, y - h / 2, w, h], (width, height)),
                )
                for number, (x, y, w, h) in rows
            ]
    yield "ultralytics", "yolo", found


def _supervision(root: Path) -> Iterator[tuple[str, str, Boxes]]:
    from supervision import DetectionDataset

    sets = {
        "yolo": [
            DetectionDataset.from_yolo(
                str(root / "yolo" / "images" / part),
                str(root / "yolo" / "labels" / part),
                str(root / "yolo" / "data.yaml"),
            )
            for part in PARTS
        ],
        "coco": [
            DetectionDataset.from_coco(
                str(root / "coco" / "images" / part),
                str(root / "coco" / "annotations" / f"instances_{part}.json"),
            )
            for part in PARTS
        ],
        "voc": [
            DetectionDataset.from_pascal_voc(
                str(root / "voc" / "JPEGImages"), str(root / "voc" / "Annotations")
            )
        ],
    }
    for form, parts in sets.items():
        # It takes VOC's corners as they are but for one pixel of the first.
        rows = {
            _key(image): [
                (part.classes[number], *xyxy)
                for number, xyxy in zip(
                    boxes.class_id.tolist(), boxes.xyxy.tolist(), strict=True
                )
            ]
            for part in parts
            for image, boxes in part.annotations.items()
        }
        yield "supervision", form, rows


def _datumaro(root: Path) -> Iterator[tuple[str, str, Boxes]]:
    import datumaro

    kind, numbers = datumaro.AnnotationType.bbox, _keys_of_kitti(root)
    for form in FORMS:
        if form == "label-studio":
            continue
        # It calls all others as we do.
        dataset = datumaro.Dataset.import_from(str(root / form), form)
        names = dataset.categories()[datumaro.AnnotationType.label]
        rows = {
            (numbers[item.id] if form == "kitti" else _key(item.id)): [
                (names[one.label].name, *map(float, one.points))
                for one in item.annotations
                if one.type == kind
            ]
            for item in dataset
        }
        yield "datumaro", form, rows


def _torchvision(root: Path) -> Iterator[tuple[str, str, Boxes]]:
    from torchvision.datasets import CocoDetection, VOCDetection
    from torchvision.datasets.voc import ET_parse

    found: Boxes = {}
    for part in PARTS:
        file = root / "coco" / "annotations" / f"instances_{part}.json"
        dataset = CocoDetection(str(root / "coco" / "images" / part), str(file))
        for number, (_, target) in zip(dataset.ids, dataset, strict=True):
            names = {key: one["name"] for key, one in dataset.coco.cats.items()}
            key = _key(dataset.coco.imgs[number]["file_name"])
            found[key] = _rows_of({"annotations": target}, number, names)
    yield "torchvision", "coco", found
    # It looks for a year's folder, and for .jpg, so that only its labels are read.
    years = root / "torchvision" / "VOCdevkit"
    years.mkdir(parents=True)
    (years / "VOC2012").symlink_to(root / "voc")
    found = {}
    for part in PARTS:
        listed = VOCDetection(str(years.parent), "2012", part)
        for path in listed.annotations:
            tree = ET_parse(path).getroot()
            objects = listed.parse_voc_xml(tree)["annotation"].get("object", [])
            # The first pixel of VOC is number 1, and both ends are included.
            found[_key(path)] = [
                (one["name"], left - 1, top - 1, right, bottom)
                for one in objects
                for left, top, right, bottom in [
                    map(float, map(one["bndbox"].get, VOC_EDGES))
                ]
            ]
    yield "torchvision", "voc", found


def _label_studio(root: Path) -> Iterator[tuple[str, str, Boxes]]:
    """What Label Studio itself would export as COCO and as YOLO."""
    from label_studio_sdk.converter import Converter

    folder, out = root / "label-studio", root / "label-studio-out"
    config = (folder / "label_config.xml").read_text("utf-8")
    converter = Converter(config, str(folder), download_resources=False)
    converter.convert_to_coco(
        str(folder / "tasks.json"), str(out), output_image_dir=None, is_dir=False
    )
    document = json.loads((out / "result.json").read_text("utf-8"))
    names = {one["id"]: one["name"] for one in document["categories"]}
    rows = {
        _key(unquote(image["file_name"])): _rows_of(document, image["id"], names)
        for image in document["images"]
    }
    yield "label-studio-sdk", "label-studio", rows


def _fiftyone(root: Path) -> Iterator[tuple[str, str, Boxes]]:
    """By its importers, which need no database, as FiftyOne itself does.

    It cannot read our files of CVAT: it takes their attribute ``id`` for its own.
    """
    from fiftyone.utils.coco import COCODetectionDatasetImporter
    from fiftyone.utils.kitti import KITTIDetectionDatasetImporter
    from fiftyone.utils.voc import VOCDetectionDatasetImporter
    from fiftyone.utils.yolo import YOLOv5DatasetImporter

    coco, yolo, voc = root / "coco", str(root / "yolo"), root / "voc"
    kitti, numbers = root / "kitti" / "training", _keys_of_kitti(root)
    importers = {
        "coco": [
            COCODetectionDatasetImporter(
                data_path=str(coco / "images" / part),
                labels_path=str(coco / "annotations" / f"instances_{part}.json"),
                label_types="detections",
                extra_attrs=False,  # `instance_id` is a name of its own
            )
            for part in PARTS
        ],
        "yolo": [
            YOLOv5DatasetImporter(dataset_dir=yolo, yaml_path="data.yaml", split=part)
            for part in PARTS
        ],
        "voc": [
            VOCDetectionDatasetImporter(
                data_path=str(voc / "JPEGImages"), labels_path=str(voc / "Annotations")
            )
        ],
        "kitti": [
            KITTIDetectionDatasetImporter(
                data_path=str(kitti / "image_2"), labels_path=str(kitti / "label_2")
            )
        ],
    }
    for form, parts in importers.items():
        found: Boxes = {}
        for part in parts:
            with part:
                for image, _, labels in part:
                    key = numbers[Path(image).stem] if form == "kitti" else _key(image)
                    found[key] = [
                        (one.label, *_edges(one.bounding_box, (WIDTH, HEIGHT)))
                        for one in (labels.detections if labels else ())
                    ]
        yield "fiftyone", form, found


def _edges(
    shares: list[float], wh: tuple[int, int]
) -> tuple[float, float, float, float]:
    """The corners of a rectangle whose corner and extent are shares of the image."""
    (x, y, w, h), (width, height) = shares, wh
    return x * width, y * height, (x + w) * width, (y + h) * height


def _datumaro_again(root: Path) -> Iterator[tuple[str, str]]:
    import datumaro

    dataset = datumaro.Dataset.import_from(str(root / "coco"), "coco")
    forms = {"yolo": "yolo_ultralytics", "coco": "coco_instances", "cvat": "cvat"}
    forms |= {"voc": "voc_detection", "darknet": "yolo", "kitti": "kitti_detection"}
    for form, name in forms.items():
        folder = root / "datumaro" / form
        dataset.export(str(folder), name, save_media=True)
        yield "datumaro", form


def _supervision_again(root: Path) -> Iterator[tuple[str, str]]:
    from supervision import DetectionDataset

    own, there = root / "yolo", root / "supervision"
    dataset = DetectionDataset.from_yolo(
        *(str(own / name / PARTS[0]) for name in ("images", "labels")),
        str(own / "data.yaml"),
    )
    yolo, coco, voc = (str(there / name) for name in ("yolo", "coco", "voc"))
    dataset.as_yolo(f"{yolo}/images", f"{yolo}/labels", f"{yolo}/data.yaml")
    dataset.as_coco(f"{coco}/images", f"{coco}/labels.json")
    dataset.as_pascal_voc(f"{voc}/images", f"{voc}/annotations")
    for form in ("yolo", "coco", "voc"):
        yield "supervision", form


READERS: Final[tuple[Reader, ...]] = (
    _ultralytics,
    _supervision,
    _datumaro,
    _torchvision,
    _label_studio,
    _fiftyone,
)
WRITERS: Final[tuple[Callable[[Path], Iterator[tuple[str, str]]], ...]] = (
    _datumaro_again,
    _supervision_again,
)
"""Each writes the street in formats, and gives its name and each format."""


if __name__ == "__main__":
    main()
