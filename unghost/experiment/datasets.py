"""Writes a data set for each arm: the same images and split, each with its own labels.

A data set has its labels twice, as YOLO and as COCO, so that it fits most trainers. Its
part ``val`` has the labels of the truth, the same in every arm.
"""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, TypedDict

import numpy as np
import yaml

from filter_core.arrays import BoxesXYXY
from filter_core.evaluation.arms import DOUBTFUL, GHOST, OBJECT, LabelledBoxes
from filter_core.formats.files import FileNames, json_bytes, write_whole
from filter_core.formats.splits import part_by_shares, role_of_part, sequence_of
from filter_core.local import LabelledFrame

PARTS: Final = ("train", "val")

TRUTH: Final = "truth.json"
"""The file with what all arms are scored against: COCO's, with more keys."""

OWN_LABELS: Final = "own_val.json"
"""The file of an arm with its own labels of the part ``val``."""

_DECIMALS: Final = 3


class ImageObject(TypedDict):
    """An image of a COCO file, with the key of its frame and its drive."""

    id: int
    file_name: str
    width: int
    height: int
    key: str
    sequence: str | None


class FactsObject(TypedDict, total=False):
    """What the truth says about a box besides its rectangle; see `LabelledBoxes`."""

    ignore: int
    distance: float | None
    visible_pixels: int
    tight_bbox: list[float] | None


class AnnotationObject(FactsObject):
    """A box of a COCO file."""

    id: int
    image_id: int
    category_id: int
    bbox: list[float]
    area: float
    iscrowd: int


class CategoryObject(TypedDict):
    """A class of a COCO file; `id` counts from 1."""

    id: int
    name: str


class CocoObject(TypedDict):
    """A COCO file."""

    images: list[ImageObject]
    categories: list[CategoryObject]
    annotations: list[AnnotationObject]


class TruthObject(CocoObject):
    """The file `TRUTH`: objects and doubtful boxes, and the raw boxes of ghosts."""

    ghosts: list[AnnotationObject]


def arm_folder(data: Path, arm: str) -> Path:
    """The folder of an arm's data set; `data` is the folder of all."""
    return data / "arms" / arm


@dataclass
class _Coco:
    """The content of a COCO file that is being made."""

    images: list[ImageObject] = field(default_factory=list)
    annotations: list[AnnotationObject] = field(default_factory=list)

    def add(
        self, xyxy: BoxesXYXY, labels: Sequence[int], facts: Sequence[FactsObject] = ()
    ) -> None:
        """Add boxes to the last image, with `facts` about each, if there are any."""
        more = facts or [FactsObject() for _ in labels]
        for box, label, own in zip(xyxy.tolist(), labels, more, strict=True):
            x, y, right, bottom = box
            width, height = right - x, bottom - y
            self.annotations.append(
                {
                    "id": len(self.annotations) + 1,
                    "image_id": self.images[-1]["id"],
                    "category_id": label + 1,
                    "bbox": [
                        round(number, _DECIMALS) for number in (x, y, width, height)
                    ],
                    "area": round(width * height, _DECIMALS),
                    "iscrowd": 0,
                    **own,
                }
            )

    def content(self, classes: Sequence[str]) -> CocoObject:
        return {
            "images": self.images,
            "categories": [
                {"id": number, "name": name}
                for number, name in enumerate(classes, start=1)
            ],
            "annotations": self.annotations,
        }


class DatasetsWriter:
    """Writes the data sets of all arms into a folder, frame by frame.

    Classes are counted from 0 in YOLO, from 1 in COCO. `share` is that of ``train``
    among frames that are of no part, by whole sequences. `frames` counts the frames of
    each part, and those left out: ``no_image``, and ``other_parts``, which are neither
    for training nor for validation.
    """

    def __init__(
        self, folder: Path, arms: Sequence[str], classes: Sequence[str], share: float
    ) -> None:
        self.frames: Counter[str] = Counter()
        self._folder, self._arms, self._classes = folder, arms, classes
        self._number = {name: number for number, name in enumerate(classes)}
        self._shares = {"train": share, "val": 1 - share}
        self._names = FileNames(flat=True)
        self._labels = {arm: {part: _Coco() for part in PARTS} for arm in arms}
        self._truth, self._ghosts = _Coco(), _Coco()

    def add(self, frame: LabelledFrame) -> None:
        """Write one frame into every data set."""
        if frame.source.image is None:
            self.frames["no_image"] += 1
            return
        part = self._part(frame)
        if part not in PARTS:
            self.frames["other_parts"] += 1
            return
        self.frames[part] += 1
        # A name of digits alone could be taken for the number of an image.
        key = frame.source.key
        stem = self._names.stem(f"frame_{key}" if key.isdecimal() else key)
        boxes = frame.boxes
        numbers = [self._number[name] for name in boxes.class_names]
        labels = np.array([numbers[index] for index in boxes.class_index], np.int64)
        image: ImageObject = {
            "id": self.frames["train"] + self.frames["val"],
            "file_name": f"{stem}{frame.source.image.suffix.lower()}",
            "width": frame.wh[0],
            "height": frame.wh[1],
            "key": key,
            "sequence": sequence_of(key, frame.annotation.sequence),
        }
        if part == "val":
            self._add_truth(image, boxes, labels.tolist())
        for arm in self._arms:
            rows = boxes.labelled[arm]
            own = self._labels[arm][part]
            own.images.append(image)
            own.add(boxes.rectangles(arm)[rows], labels[rows].tolist())
            taught, xyxy = rows, boxes.rectangles(arm)
            if part == "val":
                taught, xyxy = boxes.truth == OBJECT, boxes.xyxy
            place = arm_folder(self._folder, arm)
            _link(frame.source.image, place / "images" / part / image["file_name"])
            text = "".join(_yolo_lines(xyxy[taught], labels[taught], frame.wh))
            _write(place / "labels" / part / f"{stem}.txt", text.encode())

    def _part(self, frame: LabelledFrame) -> str:
        said, key = frame.annotation, frame.source.key
        if said.split:
            return role_of_part(said.split) or said.split
        return part_by_shares(key, said.map, said.sequence, self._shares)

    def _add_truth(
        self, image: ImageObject, boxes: LabelledBoxes, labels: list[int]
    ) -> None:
        self._truth.images.append(image)
        self._ghosts.images.append(image)
        is_seen = ~np.isnan(boxes.xyxy[:, 0])
        objects = np.flatnonzero((boxes.truth != GHOST) & is_seen)
        self._truth.add(
            boxes.xyxy[objects],
            [labels[row] for row in objects],
            [_facts(boxes, row) for row in objects.tolist()],
        )
        sides = boxes.raw_xyxy[:, 2:] - boxes.raw_xyxy[:, :2]
        ghosts = np.flatnonzero((boxes.truth == GHOST) & (sides > 0).all(axis=1))
        self._ghosts.add(boxes.raw_xyxy[ghosts], [labels[row] for row in ghosts])

    def finish(self) -> None:
        """Write the files that list all frames."""
        truth = self._truth.content(self._classes)
        for arm, parts in self._labels.items():
            place = arm_folder(self._folder, arm)
            train, own = (parts[part].content(self._classes) for part in PARTS)
            _write_json(place / "annotations" / "instances_train.json", train)
            _write_json(place / OWN_LABELS, own)
            objects = [
                annotation
                for annotation in self._truth.annotations
                if not annotation["ignore"]
            ]
            val = {**truth, "annotations": objects}
            _write_json(place / "annotations" / "instances_val.json", val)
            described = {
                **{part: f"images/{part}" for part in PARTS},
                "names": dict(enumerate(self._classes)),
            }
            text = yaml.safe_dump(described, sort_keys=False, allow_unicode=True)
            _write(place / "data.yaml", text.encode())
        ghosts = self._ghosts.annotations
        _write_json(self._folder / TRUTH, {**truth, "ghosts": ghosts})


def _facts(boxes: LabelledBoxes, row: int) -> FactsObject:
    """What the truth says about a box besides its rectangle."""
    tight, distance = boxes.tight_xyxy[row], float(boxes.distance[row])
    x, y, right, bottom = (round(float(edge), _DECIMALS) for edge in tight)
    return {
        "ignore": int(boxes.truth[row] == DOUBTFUL),
        "distance": None if np.isnan(distance) else round(distance, _DECIMALS),
        "visible_pixels": int(boxes.pixels[row]),
        "tight_bbox": None if np.isnan(tight).any() else [x, y, right - x, bottom - y],
    }


def _yolo_lines(
    xyxy: BoxesXYXY, labels: Iterable[int], wh: tuple[int, int]
) -> Iterator[str]:
    size = np.array(wh, np.float64)
    centre = (xyxy[:, :2] + xyxy[:, 2:]) / 2 / size
    sides = (xyxy[:, 2:] - xyxy[:, :2]) / size
    for label, numbers in zip(labels, np.hstack([centre, sides]).tolist(), strict=True):
        yield f"{label} {' '.join(f'{number:.9f}' for number in numbers)}\n"


def _link(image: Path, place: Path) -> None:
    """Link an image, or copy it where that is not possible.

    The link is a hard one: Ultralytics follows others before it looks for labels.
    """
    place.parent.mkdir(parents=True, exist_ok=True)
    with suppress(OSError):
        os.link(image.resolve(), place)
        return
    shutil.copy2(image, place)


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, content)


def _write_json(path: Path, value: object) -> None:
    _write(path, json_bytes(value))
