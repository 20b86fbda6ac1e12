"""Reads an export with the programs that people use, and counts what they found.

    python -m tools.check_readers

runs where they are installed (`make readers` sees to it): Ultralytics, supervision
and Datumaro are too large, and bring another OpenCV, to be part of the tests.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

NOT_READ: Final = frozenset({"label-studio"})
"""Formats of labels that Datumaro does not read under our name."""
PARTS: Final = ("train", "val")
Found = tuple[str, int, int]


def main() -> None:
    """Render, convert, read; exit code 1 if any reader found something else."""
    python = sys.argv[1] if len(sys.argv) > 1 else sys.executable
    with tempfile.TemporaryDirectory(prefix="readers-") as name:
        root = Path(name)
        forms = _label_formats(python)
        _make(python, root, forms)
        manifest = json.loads((root / "yolo" / "manifest.json").read_text("utf-8"))
        frames, boxes = (manifest["counts"][what] for what in ("frames", "boxes"))
        expected = frames["in"], boxes["out"]
        wrong = [one for one in _read(root, forms) if not _is_right(one, expected)]
    if wrong:
        sys.exit(f"expected {expected}, found otherwise by {wrong}")


def _label_formats(python: str) -> list[str]:
    """The formats of labels that others read, as the product's registry lists them."""
    ask = (
        "from filter_core.formats.registry import FORMATS; "
        "print(*(one.name for one in FORMATS.values() if 'boxes' in one.options))"
    )
    listed = subprocess.run([python, "-c", ask], check=True, capture_output=True)
    return [name for name in listed.stdout.decode().split() if name not in NOT_READ]


def _make(python: str, root: Path, forms: Sequence[str]) -> None:
    """Write a small filtered street in every format that other programs read."""
    render = (
        "import sys; from pathlib import Path; "
        "from unghost.street.street import write_street; "
        "write_street(Path(sys.argv[1]), 9)"
    )
    subprocess.run([python, "-c", render, str(root / "street")], check=True)
    convert = [python, "-m", "unghost.cli", "convert", str(root / "street"), "--filter"]
    for form in forms:
        subprocess.run([*convert, "--to", form, "-o", str(root / form)], check=True)


def _read(root: Path, forms: Sequence[str]) -> Iterator[Found]:
    os.environ["YOLO_CONFIG_DIR"] = str(root / "settings")
    os.environ["YOLO_OFFLINE"] = "true"
    readers: tuple[Callable[[Path], Iterator[Found]], ...] = (
        _ultralytics,
        _supervision,
        partial(_datumaro, forms=forms),
    )
    for reader in readers:
        for found in reader(root):
            print(*found, sep="\t")
            yield found


def _ultralytics(root: Path) -> Iterator[Found]:
    from ultralytics.data.dataset import YOLODataset
    from ultralytics.data.utils import check_det_dataset

    data: Any = check_det_dataset(str(root / "yolo" / "data.yaml"), autodownload=False)
    sets = [
        YOLODataset(img_path=data[part], data=data, task="detect") for part in PARTS
    ]
    boxes = sum(len(label["cls"]) for one in sets for label in one.labels)
    yield "ultralytics yolo", sum(map(len, sets)), boxes


def _supervision(root: Path) -> Iterator[Found]:
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
        boxes = sum(len(one) for part in parts for one in part.annotations.values())
        yield f"supervision {form}", sum(map(len, parts)), boxes


def _datumaro(root: Path, forms: Sequence[str]) -> Iterator[Found]:
    import datumaro

    # It calls these formats as we do.
    for form in forms:
        dataset = datumaro.Dataset.import_from(str(root / form), form)
        items = list(dataset)
        kind = datumaro.AnnotationType.bbox
        boxes = [one for item in items for one in item.annotations if one.type == kind]
        yield f"datumaro {form}", len(items), len(boxes)


def _is_right(found: Found, expected: tuple[int, int]) -> bool:
    return found[1:] == expected


if __name__ == "__main__":
    main()
