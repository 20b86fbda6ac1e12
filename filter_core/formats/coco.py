"""COCO: all images and boxes of a dataset, or of a part of it, in one JSON file.

Files are read image by image, by way of `filter_core.formats.coco_index`; one file is
written for each part of the split.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Final

from filter_core.annotation.boxes import KNOWN_BOX_KEYS
from filter_core.annotation.frame import FORMS_3D
from filter_core.annotation.parsing import KNOWN_FRAME_KEYS
from filter_core.errors import FilterError, LayoutError
from filter_core.formats.coco_index import CocoIndex, index_coco, looks_like_coco
from filter_core.formats.files import Spool, json_bytes
from filter_core.formats.format import LABEL_OPTIONS, Format, Likeness, Source
from filter_core.formats.reading import (
    IMAGE_SUFFIXES,
    FileIndex,
    FrameSet,
    FrameSource,
    ReadOptions,
    Unmatched,
    frame_key,
    segmentation_folder,
    walk,
)
from filter_core.formats.writing import (
    PARTS,
    ExportContext,
    OutBox,
    OutFrame,
    Traits,
    band_name,
    write_labels,
)

_PARTS: Final = ("train", "val", "test")

_OURS: Final = frozenset({"id", "image_id", "category_id", "bbox", "attributes"})

_OUR_ATTRIBUTES: Final = ("id", "type_id", "base_type", "instance_id", "distance")

_MANY: Final = 3


@dataclass(frozen=True)
class _Row:
    """One image of one file: which file's, its row, its key, and its files."""

    index: CocoIndex
    row: int
    key: str
    image: Path | None
    segmentation: Path | None
    problem: FilterError | None = None


def coco_files(root: Path) -> list[Path]:
    """The files with boxes: the one given, or those at the usual places in a folder."""
    if root.is_file():
        return [root]
    found = [*root.glob("*.json"), *(root / "annotations").glob("*.json")]
    return [path for path in sorted(found) if looks_like_coco(path)]


def read_coco(root: Path, options: ReadOptions) -> FrameSet:
    """The frames of one or several COCO files.

    Images that share an id cannot be told apart by their boxes: they are one frame
    that says so, and the others go on.

    Raises
    ------
    LayoutError
        No such file, or one that is not COCO.
    """
    paths = [options.labels] if options.labels else coco_files(root)
    if not paths:
        raise LayoutError(
            "expected a .json file with images, annotations and categories, here or in "
            "annotations/, found none"
        )
    folder = root.parent if root.is_file() else root
    indices = [index_coco(path, path.name) for path in paths]
    rows, unmatched = _match(folder, indices, options)
    return FrameSet(
        layout="coco",
        frames=lambda: (_read(row) for row in rows),
        classes=tuple(options.classes or _classes(indices)),
        count=len(rows),
        unmatched=(*unmatched, *_orphans(indices)),
    )


def _classes(indices: Sequence[CocoIndex]) -> list[str]:
    """Names in the order of their ids, each once."""
    names: dict[str, None] = {}
    for index in indices:
        ordered = list(index.names.items())
        if all(isinstance(number, int) for number in index.names):
            ordered.sort()
        names.update(dict.fromkeys(word for _, word in ordered))
    return list(names)


def _orphans(indices: Sequence[CocoIndex]) -> Iterator[Unmatched]:
    for index in indices:
        if index.orphans:
            why = f"{index.orphans} annotations of images that it does not list"
            yield Unmatched(index.name, why)


def _match(
    folder: Path, indices: Sequence[CocoIndex], options: ReadOptions
) -> tuple[list[_Row], tuple[Unmatched, ...]]:
    tags = options.segmentation or segmentation_folder(folder)
    images = FileIndex(walk(folder, IMAGE_SUFFIXES, [tags] if tags else []))
    segmentations = FileIndex(walk(tags, IMAGE_SUFFIXES) if tags else ())
    named = [one for index in indices for one in _named(index)]
    bases = Counter(_base(one.file) for one in named)
    seen = Counter(one.key for one in named)
    rows = []
    for one in named:
        alone = bases[_base(one.file)] == 1
        image = images.take(f"{one.part}/{one.file}") if one.part else None
        image = image or images.take(one.file, by_base=alone)
        tag = segmentations.take(one.file, by_base=alone)
        rows.append(
            _Row(
                index=one.index,
                row=one.row,
                key=one.key,
                image=folder / image if image else None,
                segmentation=tags / tag if tags and tag else None,
                problem=_problem(one, seen[one.key]),
            )
        )
    unmatched = (
        *images.left_over("no COCO file lists this image"),
        *segmentations.left_over("no COCO file lists an image for this segmentation"),
    )
    return sorted(rows, key=lambda row: row.key), unmatched


@dataclass(frozen=True)
class _Name:
    """What an image is called: the frame's key, its file's, and its part."""

    index: CocoIndex
    row: int
    key: str
    file: str
    part: str


def _named(index: CocoIndex) -> Iterator[_Name]:
    """The names of all images; of images with one id only the first."""
    later = {row for rows in index.repeated.values() for row in rows[1:]}
    stem = Path(index.name).stem.lower()
    part = next((one for one in _PARTS if stem.endswith(one)), "")
    for row in range(len(index.places)):
        if row in later:
            continue
        image = index.image(row)
        key, name = image.get("key"), image.get("file_name")
        if not isinstance(name, str) or not name:
            raise LayoutError(
                f"{index.name}, images[{row}]: expected a file_name, found "
                f"{str(name)[:40]!r}"
            )
        file = frame_key(name.replace("\\", "/"))
        yield _Name(
            index, row, key if isinstance(key, str) and key else file, file, part
        )


def _problem(one: _Name, seen: int) -> FilterError | None:
    index, row = one.index, one.row
    if seen > 1:
        return LayoutError(
            f"{index.name}, images[{row}]: expected each file_name once, found "
            f"{one.key!r} {seen} times"
        )
    same = index.repeated.get(row)
    if same is None:
        return None
    boxes = sum(1 for _ in index.boxes(row))
    first = ", ".join(f"images[{number}]" for number in same[:_MANY])
    more = f" and {len(same) - _MANY} more" if len(same) > _MANY else ""
    return LayoutError(
        f"{index.name}: expected each image id once, found {first}{more} with id "
        f"{index.image(row)['id']!r}: nobody can say whose the {boxes} boxes are"
    )


def _read(row: _Row) -> FrameSource:
    annotation: dict[str, Any] | None = None
    problem = row.problem
    if problem is None:
        try:
            annotation = _annotation(row)
        except FilterError as exc:
            problem = exc
    return FrameSource(row.key, annotation, row.image, row.segmentation, {}, problem)


def _annotation(row: _Row) -> dict[str, Any]:
    image = row.index.image(row.row)
    kept = {k: v for k, v in image.items() if k not in _IMAGE_KEYS}
    ours = isinstance(image.get("key"), str)
    if not ours:
        kept = _beside(kept, KNOWN_FRAME_KEYS)
    annotation: dict[str, Any] = {**kept, "boxes": list(_boxes(row, ours=ours))}
    size = {key: image.get(key) for key in ("width", "height")}
    if "camera" not in annotation and all(_is_side(side) for side in size.values()):
        annotation["camera"] = size
    return annotation


_IMAGE_KEYS: Final = frozenset({"id", "file_name", "width", "height", "key"})


def _is_side(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value > 0


def _boxes(row: _Row, *, ours: bool) -> Iterator[dict[str, Any]]:
    boxes = list(row.index.boxes(row.row))
    ids = [str(box["id"]) for box in boxes if "id" in box]
    # Ids that do not tell boxes apart are none; their places do.
    use_ids = len(set(ids)) == len(boxes)
    for number, given in enumerate(boxes):
        at = f"{row.index.name}, annotation {str(given.get('id', number))[:40]!r}"
        category = given.get("category_id")
        names = row.index.names
        name = names.get(category) if isinstance(category, (int, str)) else None
        if name is None:
            raise LayoutError(
                f"{at}: expected the id of a category, found {str(category)[:40]!r}"
            )
        kept = {key: value for key, value in given.items() if key not in _OURS}
        box = {
            **({"id": str(given["id"])} if use_ids else {}),
            "class": name,
            "xywh": given.get("bbox"),
            **_beside(kept, KNOWN_BOX_KEYS),
        }
        attributes = given.get("attributes")
        if isinstance(attributes, dict) and ours:
            box |= _from_attributes(attributes)
        elif attributes is not None:
            box["attributes"] = attributes
        yield box


def _from_attributes(attributes: dict[str, Any]) -> dict[str, Any]:
    """What the writer of this product put there; 3D boxes stay beside the rectangle."""
    known: dict[str, Any] = {
        key: attributes[key] for key in _OUR_ATTRIBUTES if key in attributes
    }
    written = (*_OUR_ATTRIBUTES, "verdict", "reason")
    rest = {key: value for key, value in attributes.items() if key not in written}
    return {**known, "attributes": rest} if rest else known


def _beside(given: dict[str, Any], known: frozenset[str]) -> dict[str, Any]:
    """Keys of the file's own that mean something else here go under `extra`."""
    clashing = {key: value for key, value in given.items() if key in known}
    free = {key: value for key, value in given.items() if key not in known}
    return {**free, "extra": clashing} if clashing else free


def _base(key: str) -> str:
    return key.rpartition("/")[2]


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

    def __init__(self, context: ExportContext) -> None:
        self._context = context
        bands = ("", *map(band_name, context.options.bands))
        self._files = {
            (band, part): _CocoFile(context.spool(), context.spool())
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
            pieces = file.pieces(self._context.head.classes)
            self._context.sink(f"{folder}/instances_{part}.json", pieces)


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


def _likeness(source: Source) -> Likeness:
    if source.path.is_file():
        return "certain" if source.path.suffix.lower() == ".json" else "none"
    return "possible" if coco_files(source.path) else "none"


COCO: Final = Format(
    name="coco",
    title="COCO",
    likeness=_likeness,
    read=read_coco,
    write=partial(write_labels, new_writer=CocoWriter),
    options=LABEL_OPTIONS | {"bands", "rejected"},
)
