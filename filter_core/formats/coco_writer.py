"""COCO: one file of boxes for each part of the split."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Final

from filter_core.annotation.frame import FORMS_3D
from filter_core.annotation.parsing import KNOWN_FRAME_KEYS
from filter_core.formats.export_boxes import OutBox, Traits
from filter_core.formats.spool import Spool, json_bytes
from filter_core.formats.writing import PARTS, Desk, OutFrame, band_name

_ATTRIBUTES: Final = ("type_id", "base_type", "instance_id", *FORMS_3D)

_DECIMALS: Final = 4


class CocoWriter:
    """Writes ``annotations/instances_PART.json`` and ``images/PART/STEM.png``.

    Ids of images, categories and annotations are whole numbers from 1, unique in their
    file: with an annotation id of 0 pycocotools counts a perfect detection as wrong.
    What COCO has no key for is under ``attributes``: the box's own id, its distance and
    its 3D box. Regions to ignore are crowds.

    References
    ----------
    .. [1] "COCO data format", https://cocodataset.org/#format-data
    """

    traits: ClassVar[Traits] = Traits("coco", crowds=True)

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        bands = ("", *map(band_name, desk.options.bands))
        self._files = {
            (band, part): _CocoFile(desk.spool(), desk.spool())
            for band in bands
            for part in PARTS
        }

    def image(self, out: OutFrame) -> str:
        """The name of a frame's image in the export."""
        return f"images/{out.part}/{out.stem}{out.suffix}"

    def labels(self, band: str, out: OutFrame) -> None:
        """One image, and its annotations."""
        self._files[band, out.part].add(out)

    def finish(self) -> None:
        """The files, now that they are complete."""
        for (band, part), file in self._files.items():
            folder = f"annotations/{band}" if band else "annotations"
            pieces = file.pieces(self._desk.head.classes)
            self._desk.sink(f"{folder}/instances_{part}.json", pieces)


class _CocoFile:
    def __init__(self, images: Spool, annotations: Spool) -> None:
        self._images, self._annotations = images, annotations

    def add(self, out: OutFrame) -> None:
        frame, number = out.frame, self._images.count + 1
        known = {
            key: value
            for key, value in frame.annotation.items()
            if key in KNOWN_FRAME_KEYS and key not in ("boxes", "extra", "camera")
        }
        if frame.camera is not None:
            known["camera"] = frame.annotation.get("camera")
        image = {
            **frame.extra,
            **known,
            **({"map": frame.map} if frame.map is not None else {}),
            "id": number,
            "file_name": f"{out.stem}{out.suffix}",
            "width": frame.wh[0],
            "height": frame.wh[1],
            "key": frame.key,
        }
        self._images.add(image, by_key=True)
        for one in out.boxes:
            annotation = _annotation_of(one, self._annotations.count + 1, number)
            self._annotations.add(annotation, by_key=True)

    def pieces(self, classes: tuple[str, ...]) -> Iterator[bytes]:
        categories = [
            {"id": number, "name": name, "supercategory": "none"}
            for number, name in enumerate(classes, start=1)
        ]
        yield b'{"info":{"description":"written by Unghost"},"licenses":[],'
        yield b'"categories":'
        yield json_bytes(categories)
        for key, spool in (
            ("images", self._images),
            ("annotations", self._annotations),
        ):
            yield f',\n"{key}":['.encode()
            yield from spool.pieces()
            yield b"]"
        yield b"}\n"


def _annotation_of(out: OutBox, number: int, image: int) -> dict[str, Any]:
    x_min, y_min, x_max, y_max = out.xyxy
    bbox = [_round(v) for v in (x_min, y_min, x_max - x_min, y_max - y_min)]
    kept = out.box.extra
    if out.is_cut or "area" not in kept:
        kept["area"] = _round(bbox[2] * bbox[3])
    return {
        "segmentation": [],
        "iscrowd": 0,
        **kept,
        **({"iscrowd": 1} if out.ignored else {}),
        "id": number,
        "image_id": image,
        "category_id": out.number + 1,
        "bbox": bbox,
        "attributes": _attributes(out),
    }


def _attributes(out: OutBox) -> dict[str, Any]:
    box = out.box
    given = box.given.get("attributes")
    attributes = dict(given) if isinstance(given, Mapping) else {}
    attributes |= {key: box.given[key] for key in _ATTRIBUTES if key in box.given}
    attributes["id"] = box.id
    if box.distance is not None:
        attributes["distance"] = _round(box.distance)
    if box.verdict == "rejected":
        attributes["verdict"] = "rejected"
        attributes["reason"] = box.decision["reason"]
    return attributes


def _round(value: float) -> float:
    return round(value, _DECIMALS)
