"""COCO: all images and boxes of a dataset, or of a part of it, in one JSON file.

A file is read image by image, with the byte positions that
`filter_core.formats.coco_index` found in it; one file is written per part of the split.

References
----------
.. [1] "COCO data format", https://cocodataset.org/#format-data
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import ClassVar, Final
from urllib.parse import unquote

from filter_core.annotation.boxes import KNOWN_BOX_KEYS
from filter_core.annotation.frame import FORMS_3D
from filter_core.annotation.parsing import KNOWN_FRAME_KEYS
from filter_core.errors import FilterError, LayoutError
from filter_core.formats.coco_index import (
    CocoIndex,
    coco_id,
    index_coco,
    looks_like_coco,
)
from filter_core.formats.export import ExportFrame
from filter_core.formats.files import Spool, json_bytes
from filter_core.formats.format import (
    FOLDER_OPTIONS,
    LABEL_NEEDS,
    LABEL_OPTIONS,
    Format,
    Recognition,
    Source,
)
from filter_core.formats.outside import OUTSIDE_FILES_HINT, allowed_folders
from filter_core.formats.reading import (
    FileIndex,
    FrameFileNames,
    FrameSet,
    FrameSource,
    Unmatched,
    annotated,
    frame_key,
    frame_of,
    is_inside,
    last_name,
)
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.streams import Streams
from filter_core.formats.writing import (
    PARTS,
    ExportContext,
    LabelBox,
    OutFrame,
    Traits,
    band_name,
)
from filter_core.values import shown

COCO: Final = Format(
    name="coco",
    title="COCO",
    docs_row=(
        "`bbox` and every other key of images and annotations; "
        "`annotations/instances_train.json` and `instances_val.json`, images beside "
        "them; all ids are whole numbers from 1; `attributes` carry the box's own "
        "id, its distance and its 3D box"
    ),
    brief="one JSON file per part of the split",
    recognised_by="a COCO .json file",
    read_options=FOLDER_OPTIONS | {"classes"},
    needs=LABEL_NEEDS,
    numbers_classes=True,
    options=LABEL_OPTIONS | {"bands", "rejected"},
)


@COCO.recogniser
def _recognise(source: Source) -> Recognition:
    if source.path.is_file():
        return "certain" if source.path.suffix.lower() == ".json" else "none"
    return "possible" if _coco_files(source.path) else "none"


def _coco_files(root: Path) -> list[Path]:
    """The files with boxes: the one given, or those at the usual places in a folder."""
    if root.is_file():
        return [root]
    found = [*root.glob("*.json"), *(root / "annotations").glob("*.json")]
    return [path for path in sorted(found) if looks_like_coco(path)]


_INSTANCES: Final = "instances"

_OTHER_TASKS: Final = ("person_keypoints", "stuff", "panoptic", "captions")
"""How COCO's own files begin that list the images of ``instances_...`` once more."""


def _without_picture(rows: Sequence[tuple[FrameSource, _Name]]) -> Iterator[str]:
    """Says how many of the images that COCO files list are not there."""
    images = (name for frame, name in rows if not frame.image and not frame.problem)
    missing = list(images)
    if missing:
        yield (
            f"{len(missing)} of {len(rows)} images that are listed were not found, the "
            f"first is {shown(missing[0].path)}"
        )


def _repeating(paths: Sequence[Path]) -> dict[Path, Path]:
    """Files for other tasks, each with the file that has the boxes of its images."""
    there = set(paths)
    tasks = ((path, task) for path in paths for task in _OTHER_TASKS)
    found = (
        (path, path.with_name(path.name.replace(task, _INSTANCES, 1)))
        for path, task in tasks
        if path.name.startswith(task)
    )
    return {path: boxes for path, boxes in found if boxes in there}


@COCO.reader
def read_coco(root: Path, options: RecordingDescription) -> FrameSet:
    """The frames of one or several COCO files.

    If several images share an id, it is unknown to which of them a box belongs: they
    become one frame with an error, and all other frames are read. So does a frame with
    an annotation that cannot be read. Annotations of no image are listed as unmatched.

    Raises
    ------
    LayoutError
        No such file, or one that is not COCO.
    """
    paths = [options.labels] if options.labels else _coco_files(root)
    if not paths:
        raise LayoutError(
            "expected a .json file with images, annotations and categories, here or in "
            "annotations/, found none"
        )
    folder = root.parent if root.is_file() else root
    repeating = _repeating(paths)
    indices = [index_coco(path, path.name) for path in paths if path not in repeating]
    streams = Streams(folder, options.segmentation)
    rows, unmatched = _match(folder, indices, streams)
    rows = [
        (_with_outside_image(frame, one, folder, options), one) for frame, one in rows
    ]
    repeated = (
        f"{path.name} was not read: {boxes.name} has the boxes of its images"
        for path, boxes in repeating.items()
    )
    notes = (*streams.notes, *repeated, *_without_picture(rows))
    return FrameSet(
        layout="coco",
        frames=lambda: (_read(frame, image) for frame, image in rows),
        classes=tuple(options.classes or _classes(indices)),
        count=len(rows),
        unmatched=(*unmatched, *_unused(indices)),
        notes=lambda: notes,
        streams=streams.facts,
        texts=lambda: [path for path in paths if path not in repeating],
        parts=Counter(one.index.name for _, one in rows),
    )


def _with_outside_image(
    frame: FrameSource, name: _Name, folder: Path, options: RecordingDescription
) -> FrameSource:
    """The frame with the image outside the folder that its name leads to, if any.

    If it may not be read, that is the frame's problem.
    """
    if frame.image or not name.is_elsewhere or options.outside_files is None:
        return frame
    path = folder / str(name.index.image(name.row)["file_name"])
    if not path.is_file():
        return frame
    allowed = allowed_folders(options, folder)
    if allowed is None or is_inside(path, allowed):
        return replace(frame, image=path)
    problem = LayoutError(
        f"{name.index.name}, images[{name.row}]: expected a file_name in the folder, "
        f"found {shown(str(path))}; {OUTSIDE_FILES_HINT}"
    )
    return replace(frame, problem=frame.problem or problem)


_SPLITS: Final = ("train", "val", "test")
"""The parts of a split in which the name of a COCO file may end."""


def _match(
    folder: Path, indices: Sequence[CocoIndex], streams: Streams
) -> tuple[list[tuple[FrameSource, _Name]], tuple[Unmatched, ...]]:
    """Every image as a frame with its files, by their keys; what is left over."""
    images = FileIndex(streams.images)
    listed: list[_Name] = []
    nameless: list[Unmatched] = []
    for index in indices:
        for row in _rows(index):
            try:
                listed.append(_name(index, row))
            except LayoutError as exc:
                nameless.append(Unmatched(index.name, exc.detail))
    named = _with_images(listed, images)
    seen = Counter(one.key for one in named)
    files = []
    for one in named:
        files.append(FrameFileNames(one.key, f"{frame_key(one.path)}.", one.image))
    files, left_over = streams.complete(files, "image of a COCO file")
    files, shared = _of_one_frame_each(files, folder)
    rows = [
        (replace(frame_of(file, folder), label=None, problem=problem), one)
        for file, one in zip(files, named, strict=True)
        for problem in [_problem(one, seen[one.key])]
    ]
    unmatched = (
        *images.left_over("no COCO file lists this image"),
        *left_over,
        *shared,
        *_first(nameless),
    )
    return sorted(rows, key=lambda row: row[0].key), unmatched


@dataclass(frozen=True)
class _Name:
    """An image of a COCO file.

    Attributes
    ----------
    index, row : CocoIndex, int
        The file, and the place of the image in it.
    key : str
        Of its frame.
    path : str
        As the file gives it, but relative; see `_relative`.
    part : str
        The part of a split that the name of the COCO file ends in, or "".
    is_ours : bool
        The key is that of an export.
    is_elsewhere : bool
        The path was not relative: it is that of another machine, or an address.
    image : str or None
        The image, relative to the folder.
    """

    index: CocoIndex
    row: int
    key: str
    path: str
    part: str
    is_ours: bool
    is_elsewhere: bool
    image: str | None = None


def _rows(index: CocoIndex) -> Iterator[int]:
    """All images; of images with one id only the first."""
    later = {row for rows in index.repeated.values() for row in rows[1:]}
    return (row for row in range(len(index.places)) if row not in later)


def _name(index: CocoIndex, row: int) -> _Name:
    """The name of an image; raises `LayoutError` if it has none."""
    image = index.image(row)
    key, name = image.get("key"), image.get("file_name")
    is_ours = isinstance(key, str) and key != ""
    path, is_elsewhere = _relative(name) if isinstance(name, str) else ("", False)
    if not path:
        raise LayoutError(f"images[{row}]: expected a file_name, found {shown(name)}")
    own = frame_key(path)
    stem = Path(index.name).stem.lower()
    part = next((one for one in _SPLITS if stem.endswith(one)), "")
    return _Name(
        index, row, str(key) if is_ours else own, path, part, is_ours, is_elsewhere
    )


_LOCAL_FILES: Final = "/data/local-files/?d="
"""How Label Studio begins the address of a file of its machine."""

_ADDRESS: Final = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:/*|/+")
"""The beginning of an address, of a path on a drive, or of an absolute path."""


def _relative(name: str) -> tuple[str, bool]:
    """A path without root, drive, address and ``..``; whether it had any of these."""
    path = name
    if _LOCAL_FILES in path:
        path = unquote(path.partition(_LOCAL_FILES)[2])
    path = path.replace("\\", "/")
    begins = _ADDRESS.match(path)
    parts = path[begins.end() if begins else 0 :].split("/")
    kept = [part for part in parts if part not in ("", ".", "..")]
    is_elsewhere = path != name.replace("\\", "/") or bool(begins) or ".." in parts
    return "/".join(kept), is_elsewhere


def _of_one_frame_each(
    frames: Sequence[FrameFileNames], folder: Path
) -> tuple[list[FrameFileNames], list[Unmatched]]:
    """Frames without the files that belong to another frame; files that may be of any.

    The segmentation of ``a.png`` and ``a.jpg`` is that of the picture with its suffix.
    """
    users: dict[Path, list[FrameFileNames]] = {}
    for frame in frames:
        for path in frame.files.values():
            users.setdefault(path, []).append(frame)
    lost: dict[str, set[Path]] = {}
    unclear = []
    for path, sharing in users.items():
        if len({one.image for one in sharing}) == 1:
            continue
        alike = [
            one
            for one in sharing
            if PurePosixPath(one.image or "").suffix.lower() == path.suffix.lower()
        ]
        for one in sharing:
            if len(alike) != 1 or one is not alike[0]:
                lost.setdefault(one.key, set()).add(path)
        if len(alike) != 1:
            names = " or ".join(one.key for one in sharing[:_MOST_NAMED])
            why = f"may belong to {names}, so it is not used"
            inside = path.is_relative_to(folder)
            name = path.relative_to(folder).as_posix() if inside else path.name
            unclear.append(Unmatched(name, why))
    own = [
        replace(
            one,
            files={
                role: path
                for role, path in one.files.items()
                if path not in lost[one.key]
            },
        )
        if one.key in lost
        else one
        for one in frames
    ]
    return own, unclear


def _with_images(listed: Sequence[_Name], images: FileIndex) -> list[_Name]:
    """The names with their images: each the file whose path ends most alike.

    Of a path from elsewhere only its end says anything, so the frame is called by the
    file in the folder; and pictures that differ in their suffix only by that, too.
    """
    bases = Counter(last_name(one.path) for one in listed)
    taken: list[str | None] = []
    for one in listed:
        depth = one.path.count("/") + 1
        least = 1 if bases[last_name(one.path)] == 1 else 2
        image = None
        if one.part:
            image = images.take_named(f"{one.part}/{one.path}", least=depth + 1)
        taken.append(image or images.take_named(one.path, least=least))
    uses = Counter(taken)
    named = []
    for one, image in zip(listed, taken, strict=True):
        exact = image is not None and frame_key(image) == frame_key(one.path)
        # A file that only resembles several names is not known to be any of them.
        sure = image if exact or uses[image] == 1 else None
        own = frame_key(sure) if one.is_elsewhere and sure else one.key
        named.append(replace(one, image=sure, key=one.key if one.is_ours else own))
    suffixes: dict[str, set[str]] = {}
    for one in named:
        suffixes.setdefault(one.key, set()).add(PurePosixPath(one.path).suffix)
    return [
        replace(one, key=f"{one.key}{PurePosixPath(one.path).suffix}")
        if not one.is_ours and len(suffixes[one.key]) > 1
        else one
        for one in named
    ]


_MOST_NAMED: Final = 3
"""Images with the same id that an error names; further ones are counted."""


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
    first = ", ".join(f"images[{number}]" for number in same[:_MOST_NAMED])
    more = f" and {len(same) - _MOST_NAMED} more" if len(same) > _MOST_NAMED else ""
    return LayoutError(
        f"{index.name}: expected each image id once, found {first}{more} with id "
        f"{index.image(row)['id']!r}: it is not known to which the {boxes} boxes belong"
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


def _unused(indices: Sequence[CocoIndex]) -> Iterator[Unmatched]:
    """Images, annotations and categories that cannot be used."""
    for index in indices:
        yield from (Unmatched(index.name, why) for why in index.faulty)
        if orphans := sorted(index.orphans):
            first = ", ".join(f"annotations[{n}]" for n in orphans[:_MOST_NAMED])
            more = len(orphans) - _MOST_NAMED
            yield Unmatched(
                index.name,
                f"{len(orphans)} annotations of images that it does not list: {first}"
                + (f" and {more:,} more" if more > 0 else ""),
            )


_MOST_NAMELESS: Final = 10


def _first(nameless: Sequence[Unmatched]) -> Iterator[Unmatched]:
    """The first images without a name; the others are counted."""
    yield from nameless[:_MOST_NAMELESS]
    if len(nameless) > _MOST_NAMELESS:
        more = len(nameless) - _MOST_NAMELESS
        yield Unmatched(nameless[0].path, f"{more:,} more images without a file_name")


def _read(frame: FrameSource, image: _Name) -> FrameSource:
    # Boxes are not read if it is not known to which image they belong.
    return frame if frame.problem else annotated(frame, partial(_annotation, image))


_IMAGE_KEYS: Final = frozenset({"id", "file_name", "width", "height", "key"})


def _annotation(one: _Name) -> dict[str, object]:
    """An image and its boxes; only files that `CocoWriter` wrote give a ``key``."""
    image = one.index.image(one.row)
    kept = {k: v for k, v in image.items() if k not in _IMAGE_KEYS}
    ours = isinstance(image.get("key"), str)
    if not ours:
        kept = _beside(kept, KNOWN_FRAME_KEYS)
    annotation: dict[str, object] = {**kept, "boxes": list(_boxes(one, ours=ours))}
    size = {key: image.get(key) for key in ("width", "height")}
    if "camera" not in annotation and all(_is_side(side) for side in size.values()):
        annotation["camera"] = size
    return annotation


def _is_side(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value > 0


_OURS: Final = frozenset({"id", "image_id", "category_id", "bbox", "attributes"})
"""Keys of an annotation that are interpreted; all others are only kept."""


def _boxes(one: _Name, *, ours: bool) -> Iterator[dict[str, object]]:
    boxes = list(one.index.boxes(one.row))
    ids = [_own_id(box) for box in boxes if "id" in box]
    # If an id occurs twice, the boxes are identified by their positions instead.
    use_ids = len(set(ids)) == len(boxes)
    for number, given in enumerate(boxes):
        at = f"{one.index.name}, annotation {str(given.get('id', number))[:40]!r}"
        category = coco_id(given.get("category_id"))
        name = None if category is None else one.index.names.get(category)
        if name is None:
            raise LayoutError(
                f"{at}: expected the id of a category, found "
                f"{str(given.get('category_id'))[:40]!r}"
            )
        kept = {key: value for key, value in given.items() if key not in _OURS}
        box = {
            **({"id": _own_id(given)} if use_ids else {}),
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


def _own_id(box: Mapping[str, object]) -> str:
    number = coco_id(box["id"])
    return str(box["id"] if number is None else number)


_OUR_ATTRIBUTES: Final = ("id", "type_id", "base_type", "instance_id", "distance")


def _from_attributes(attributes: dict[str, object]) -> dict[str, object]:
    """The keys that `CocoWriter` stored under ``attributes``."""
    known: dict[str, object] = {
        key: attributes[key] for key in _OUR_ATTRIBUTES if key in attributes
    }
    written = (*_OUR_ATTRIBUTES, "verdict", "reason")
    rest = {key: value for key, value in attributes.items() if key not in written}
    return {**known, "attributes": rest} if rest else known


def _beside(given: dict[str, object], known: frozenset[str]) -> dict[str, object]:
    """Unknown keys of a file; keys that have a meaning here are put under ``extra``."""
    clashing = {key: value for key, value in given.items() if key in known}
    free = {key: value for key, value in given.items() if key not in known}
    return {**free, "extra": clashing} if clashing else free


@COCO.label_writer
class CocoWriter:
    """Writes ``annotations/instances_PART.json`` and ``images/PART/STEM.png``.

    Ids of images, categories and annotations are whole numbers from 1, unique in their
    file: with an annotation id of 0 pycocotools counts a perfect detection as wrong.
    Values without a key in COCO are under ``attributes``: the box's own id, its
    distance and its 3D box. Regions to ignore are crowds.
    """

    traits: ClassVar[Traits] = Traits(
        image="images/{part}/{stem}{suffix}", can_hold_crowds=True
    )

    def __init__(self, context: ExportContext) -> None:
        self._context = context
        bands = ("", *map(band_name, context.options.bands))
        is_tight = context.options.boxes == "tight"
        self._files = {
            (band, part): _CocoFile(context.spool(), context.spool(), is_tight)
            for band in bands
            for part in PARTS
        }

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
    def __init__(self, images: Spool, annotations: Spool, is_tight: bool) -> None:
        self._images, self._annotations = images, annotations
        self._is_tight = is_tight

    def add(self, out: OutFrame) -> None:
        frame, number = out.frame, self._images.count + 1
        known = {
            key: value
            for key, value in frame.given.frame.items()
            if key in KNOWN_FRAME_KEYS and key not in ("boxes", "extra", "camera")
        }
        if frame.given.camera is not None:
            known["camera"] = frame.given.frame["camera"]
        image = {
            **frame.given.frame_extra(),
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
            annotation = {
                **_described(one, frame, is_tight=self._is_tight),
                "id": self._annotations.count + 1,
                "image_id": number,
            }
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


def _described(
    one: LabelBox, frame: ExportFrame, *, is_tight: bool
) -> dict[str, object]:
    """One annotation, without its own id and that of its image.

    `is_tight`: its rectangle is that of the visible pixels, and not the given one.
    """
    x_min, y_min, x_max, y_max = one.xyxy
    bbox = [_round(v) for v in (x_min, y_min, x_max - x_min, y_max - y_min)]
    kept = frame.given.box_extra(one.row)
    if is_tight:
        # An outline and an area that came with a box are those of its given rectangle.
        kept.pop("segmentation", None)
        kept.pop("area", None)
    if one.is_cut or "area" not in kept:
        kept["area"] = _round(bbox[2] * bbox[3])
    return {
        "segmentation": [],
        "iscrowd": 0,
        **kept,
        **({"iscrowd": 1} if one.ignored else {}),
        "category_id": one.class_number + 1,
        "bbox": bbox,
        "attributes": _attributes(one.row, frame),
    }


_ATTRIBUTES: Final = ("type_id", "base_type", "instance_id", *FORMS_3D)


def _attributes(row: int, frame: ExportFrame) -> dict[str, object]:
    boxes, given = frame.boxes, frame.given.boxes[row]
    own = given.get("attributes")
    attributes = dict(own) if isinstance(own, Mapping) else {}
    attributes |= {key: given[key] for key in _ATTRIBUTES if key in given}
    attributes["id"] = boxes.ids[row]
    distance = float(boxes.distance[row])
    if not math.isnan(distance):
        attributes["distance"] = _round(distance)
    verdict = boxes.effective_verdict(row)
    if verdict == "rejected":
        attributes["verdict"] = verdict
        attributes["reason"] = boxes.reason_label(row)
    return attributes


_DECIMALS: Final = 9


def _round(value: float) -> float:
    return round(value, _DECIMALS)
