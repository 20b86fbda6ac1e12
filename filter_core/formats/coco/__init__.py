"""COCO: all images and boxes of a dataset, or of a part of it, in one JSON file.

A file is read image by image, with the byte positions that
`filter_core.formats.coco.index` found in it; one file is written per part of the split.

References
----------
.. [1] "COCO data format", https://cocodataset.org/#format-data
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path, PurePosixPath
from typing import BinaryIO, ClassVar, Final

from filter_core.annotation.boxes import KNOWN_BOX_KEYS
from filter_core.annotation.frame import FORMS_3D
from filter_core.annotation.parsing import KNOWN_FRAME_KEYS
from filter_core.errors import FilterError, LayoutError
from filter_core.formats.coco.index import (
    LISTS,
    CocoId,
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
from filter_core.formats.matching import FileIndex, FrameFileNames, frame_of
from filter_core.formats.reading import (
    BoxOrigin,
    FrameSet,
    FrameSource,
    Unmatched,
    annotated,
    frame_key,
    is_inside,
    last_name,
    missing_image,
    relative_path,
)
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.same import (
    BESIDE,
    SOURCE_LABELS,
    BoxSpan,
    joined_beside,
    spans_of_items,
    stored_labels,
)
from filter_core.formats.splits import completed_parts, part_of_labels
from filter_core.formats.streams import Streams, listing_files
from filter_core.formats.streams.outside import OUTSIDE_FILES_HINT, allowed_folders
from filter_core.formats.tables.patterns import FilePatterns
from filter_core.formats.writing import (
    EVERY_KEY,
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
    return "possible" if _coco_files(source.path, source.files) else "none"


def _coco_files(root: Path, files: FilePatterns) -> list[Path]:
    """The files with boxes: the one given, or those at the usual places in a folder."""
    paths = files.glob(root, "*.json", "annotations/*.json", f"*/{_ROBOFLOW}")
    return [path for path in paths if path == root or looks_like_coco(path)]


_ROBOFLOW: Final = "_annotations.coco.json"
"""Roboflow's file beside the images of each part."""

_INSTANCES: Final = "instances"

_OTHER_TASKS: Final = ("person_keypoints", "stuff", "panoptic", "captions")
"""How COCO's own files begin that list the images of ``instances_...`` once more."""


@COCO.reader
def read_coco(root: Path, options: RecordingDescription) -> FrameSet:
    """The frames of one or several COCO files.

    If several images share an id, it is unknown to which of them a box belongs: they
    become one frame with an error, and all other frames are read. So does a frame with
    an annotation that cannot be read. Annotations of no image are listed as unmatched.
    Raises `LayoutError`: no such file, or one that is not COCO.
    """
    expected = (
        "a .json file with images, annotations and categories, here, in annotations/, "
        f"or as {_ROBOFLOW} beside images"
    )
    paths = listing_files(root, options, _coco_files, expected)
    folder = root.parent if root.is_file() else root
    # Files for other tasks, each with the file that has the boxes of its images
    there = set(paths)
    tasks = ((path, task) for path in paths for task in _OTHER_TASKS)
    pairs = (
        (path, path.with_name(path.name.replace(task, _INSTANCES, 1)))
        for path, task in tasks
        if path.name.startswith(task)
    )
    repeating = {path: boxes for path, boxes in pairs if boxes in there}
    indices = [
        index_coco(path, _name_in(path, folder))
        for path in paths
        if path not in repeating
    ]
    streams = Streams(folder, options)
    rows, unmatched = _match(folder, indices, streams)
    rows = [
        (_with_outside_image(frame, entry, folder, options), entry)
        for frame, entry in rows
    ]
    notes = [
        *streams.notes,
        *(
            f"{path.name} was not read: {boxes.name} has the boxes of its images"
            for path, boxes in repeating.items()
        ),
    ]
    missing = [entry for frame, entry in rows if not frame.image and not frame.problem]
    if missing:
        notes.append(
            f"{len(missing)} of {len(rows)} images that are listed were not found, the "
            f"first is {shown(missing[0].path)}"
        )
    tell_parts = options.split in ("auto", "labels")
    parts = {index.name: part_of_labels(index.name) for index in indices if tell_parts}
    return FrameSet(
        layout="coco",
        frames=lambda: _frames(rows, parts),
        classes=tuple(options.classes or _classes(indices)),
        count=len(rows),
        unmatched=(*unmatched, *_unused(indices)),
        notes=lambda: tuple(notes),
        streams=streams.facts,
        texts=lambda: [path for path in paths if path not in repeating],
        parts=Counter(entry.index.name for _, entry in rows),
    )


def _name_in(path: Path, folder: Path) -> str:
    """The name of a COCO file in its folder; Roboflow's with the folder of its part."""
    is_beside = path.name == _ROBOFLOW and path.parent != folder
    return f"{path.parent.name}/{path.name}" if is_beside else path.name


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


def _match(
    folder: Path, indices: Sequence[CocoIndex], streams: Streams
) -> tuple[list[tuple[FrameSource, _Name]], tuple[Unmatched, ...]]:
    """Every image as a frame with its files, by their keys; what is left over."""
    images = FileIndex(streams.images)
    listed: list[_Name] = []
    nameless: list[Unmatched] = []
    for index in indices:
        # Of images with one id only the first
        later = {row for rows in index.repeated.values() for row in rows[1:]}
        for row in sorted({*range(len(index.places))} - later):
            try:
                listed.append(_name(index, row))
            except LayoutError as exc:
                nameless.append(Unmatched(index.name, exc.detail))
    # The names with their images: each the file whose path ends most alike
    bases = Counter(last_name(entry.path) for entry in listed)
    taken: list[str | None] = []
    for entry in listed:
        depth = entry.path.count("/") + 1
        least = 1 if bases[last_name(entry.path)] == 1 else 2
        image = None
        if entry.part:
            image = images.take_named(f"{entry.part}/{entry.path}", least=depth + 1)
        taken.append(image or images.take_named(entry.path, least=least))
    uses = Counter(taken)
    named = []
    for entry, image in zip(listed, taken, strict=True):
        exact = image is not None and frame_key(image) == frame_key(entry.path)
        # A file that only resembles several names is not known to be any of them.
        sure = image if exact or uses[image] == 1 else None
        own = frame_key(sure) if entry.is_elsewhere and sure else entry.key
        named.append(
            replace(entry, image=sure, key=entry.key if entry.is_ours else own)
        )
    suffixes: dict[str, set[str]] = {}
    for entry in named:
        suffixes.setdefault(entry.key, set()).add(PurePosixPath(entry.path).suffix)
    named = [
        replace(entry, key=f"{entry.key}{PurePosixPath(entry.path).suffix}")
        if not entry.is_ours and len(suffixes[entry.key]) > 1
        else entry
        for entry in named
    ]
    seen = Counter(entry.key for entry in named)
    names = (
        FrameFileNames(entry.key, f"{frame_key(entry.path)}.", entry.image)
        for entry in named
    )
    completed, left_over = streams.complete(names, "image of a COCO file")
    files, shared = _of_one_frame_each([*completed], folder)
    rows = [
        (replace(frame_of(file, folder), label=None, problem=problem), entry)
        for file, entry in zip(files, named, strict=True)
        for problem in [_problem(entry, seen[entry.key])]
    ]
    more = len(nameless) - _MOST_NAMELESS
    why = f"{more:,} more images without a file_name"
    unmatched = (
        *images.left_over("no COCO file lists this image"),
        *left_over,
        *shared,
        *nameless[:_MOST_NAMELESS],
        *([Unmatched(nameless[0].path, why)] if more > 0 else ()),
    )
    return sorted(rows, key=lambda row: row[0].key), unmatched


_MOST_NAMELESS: Final = 10
"""Images without a name that are listed; further ones are counted."""


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
        As the file gives it, but relative; see `relative_path`.
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


def _name(index: CocoIndex, row: int) -> _Name:
    """The name of an image; raises `LayoutError` if it has none."""
    image = index.image(row)
    key, name = image.get("key"), image.get("file_name")
    is_ours = isinstance(key, str) and key != ""
    path, is_elsewhere = relative_path(name) if isinstance(name, str) else ("", False)
    if not path:
        raise LayoutError(f"images[{row}]: expected a file_name, found {shown(name)}")
    own = frame_key(path)
    part = part_of_labels(index.name) or ""
    beside = index.name.rpartition("/")[0]
    if beside and not is_ours:  # Roboflow's names are those in the folder of the file
        path = f"{beside}/{path}"
        own = frame_key(path)
    return _Name(
        index, row, str(key) if is_ours else own, path, part, is_ours, is_elsewhere
    )


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
        if len({frame.image for frame in sharing}) == 1:
            continue
        alike = [
            frame
            for frame in sharing
            if PurePosixPath(frame.image or "").suffix.lower() == path.suffix.lower()
        ]
        for frame in sharing:
            if len(alike) != 1 or frame is not alike[0]:
                lost.setdefault(frame.key, set()).add(path)
        if len(alike) != 1:
            names = " or ".join(frame.key for frame in sharing[:_MOST_NAMED])
            why = f"may belong to {names}, so it is not used"
            inside = path.is_relative_to(folder)
            name = path.relative_to(folder).as_posix() if inside else path.name
            unclear.append(Unmatched(name, why))
    own = [
        replace(
            frame,
            files={
                role: path
                for role, path in frame.files.items()
                if path not in lost[frame.key]
            },
        )
        if frame.key in lost
        else frame
        for frame in frames
    ]
    return own, unclear


_MOST_NAMED: Final = 3
"""Images with the same id that an error names; further ones are counted."""


def _problem(entry: _Name, seen: int) -> FilterError | None:
    index, row = entry.index, entry.row
    if seen > 1:
        return LayoutError(
            f"{index.name}, images[{row}]: expected each file_name once, found "
            f"{entry.key!r} {seen} times"
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


def _frames(
    rows: Sequence[tuple[FrameSource, _Name]], parts: Mapping[str, str | None]
) -> Iterator[FrameSource]:
    """The frames; the first of each file says what the file says of them all."""
    told: set[Path] = set()
    for frame, image in rows:
        if frame.problem:  # it is not known to which image boxes belong
            yield frame
            continue
        index, kept = image.index, dict(frame.annotation or {})
        if part := parts.get(index.name):
            kept["split"] = part
        origin = BoxOrigin(
            index.path,
            index.places_of_boxes(image.row),
            # Boxes of our own files are called by other ids than their annotations.
            image_id=None if image.is_ours else index.ids[image.row],
            categories=index.categories,
        )
        frame = replace(frame, annotation=kept or None, origin=origin)
        frame = annotated(frame, partial(_annotation, image))
        can_tell = not (image.is_ours or frame.problem or index.path in told)
        if can_tell and not missing_image(frame):
            told.add(index.path)
            frame = replace(frame, origin=origin._replace(beside=index.beside))
        yield frame


@COCO.spans
def _spans(file: BinaryIO) -> Iterator[BoxSpan]:
    """All annotations of a file."""
    return spans_of_items(file, "annotations")


_IMAGE_KEYS: Final = frozenset({"id", "file_name", "width", "height", "key"})


def _annotation(entry: _Name) -> dict[str, object]:
    """An image and its boxes; only files that `CocoWriter` wrote give a ``key``."""
    image = entry.index.image(entry.row)
    kept = {k: v for k, v in image.items() if k not in _IMAGE_KEYS}
    ours = isinstance(image.get("key"), str)
    if not ours:
        kept = _beside(kept, KNOWN_FRAME_KEYS)
    annotation: dict[str, object] = {**kept, "boxes": list(_boxes(entry, ours=ours))}
    size = {key: image.get(key) for key in ("width", "height")}
    has_size = all(type(side) is int and side > 0 for side in size.values())
    if "camera" not in annotation and has_size:
        annotation["camera"] = size
    return annotation


_OURS: Final = frozenset({"id", "image_id", "category_id", "bbox", "attributes"})
"""Keys of an annotation that are interpreted; all others are only kept."""


def _boxes(entry: _Name, *, ours: bool) -> Iterator[dict[str, object]]:
    boxes = list(entry.index.boxes(entry.row))
    ids = [_own_id(box) for box in boxes if "id" in box]
    # If an id occurs twice, the boxes are identified by their positions instead.
    use_ids = len(set(ids)) == len(boxes)
    for number, annotation in enumerate(boxes):
        at = (
            f"{entry.index.name}, annotation {str(annotation.get('id', number))[:40]!r}"
        )
        category = coco_id(annotation.get("category_id"))
        name = None if category is None else entry.index.names.get(category)
        if name is None:
            raise LayoutError(
                f"{at}: expected the id of a category, found "
                f"{str(annotation.get('category_id'))[:40]!r}"
            )
        kept = {key: value for key, value in annotation.items() if key not in _OURS}
        box = {
            **({"id": _own_id(annotation)} if use_ids else {}),
            "class": name,
            "xywh": annotation.get("bbox"),
            **_beside(kept, KNOWN_BOX_KEYS),
        }
        attributes = annotation.get("attributes")
        if isinstance(attributes, dict) and ours:
            # The keys that `CocoWriter` stored under ``attributes``
            stored: dict[str, object] = {
                key: attributes[key] for key in _OUR_ATTRIBUTES if key in attributes
            }
            written = (*_OUR_ATTRIBUTES, "verdict", "reason")
            rest = {
                key: value for key, value in attributes.items() if key not in written
            }
            box |= {**stored, "attributes": rest} if rest else stored
        elif attributes is not None:
            box["attributes"] = attributes
        yield box


def _own_id(box: Mapping[str, object]) -> str:
    number = coco_id(box["id"])
    return str(box["id"] if number is None else number)


_OUR_ATTRIBUTES: Final = ("id", "type_id", "base_type", "instance_id", "distance")


def _beside(raw: dict[str, object], known_keys: frozenset[str]) -> dict[str, object]:
    """Unknown keys of a file; keys that have a meaning here are put under ``extra``."""
    clashing = {key: value for key, value in raw.items() if key in known_keys}
    free = {key: value for key, value in raw.items() if key not in known_keys}
    return {**free, "extra": clashing} if clashing else free


@COCO.label_writer
class CocoWriter:
    """Writes ``annotations/instances_PART.json`` and ``images/PART/STEM.png``.

    Ids of images, categories and annotations that came with a COCO file are kept.
    Others are whole numbers from 1, unique in their file: with an annotation id of 0
    pycocotools counts a perfect detection as wrong.
    Values without a key in COCO are under ``attributes``: the box's own id, its
    distance and its 3D box. Regions to ignore are crowds.
    """

    traits: ClassVar[Traits] = Traits(
        image="images/{part}/{stem}{suffix}",
        can_hold_crowds=True,
        box_keys=EVERY_KEY,
        keeps_rectangles=True,
    )

    def __init__(self, context: ExportContext) -> None:
        self._context = context
        self._bands = ("", *map(band_name, context.options.bands))
        self._categories = _Categories(context.head.classes)
        self._files: dict[str, dict[str, _CocoFile]] = {}
        self._beside: dict[str, list[object]] = {}

    def labels(self, band: str, out: OutFrame) -> None:
        """One image, and its annotations."""
        stored = stored_labels(out.frame.given, COCO.name)
        self._categories.add(stored.get("categories"))
        if stored:
            self._context.note_own(band)
        if BESIDE in stored:
            self._beside.setdefault(out.part, []).append(stored[BESIDE])
        if out.part not in self._files:
            self._files[out.part] = self._new_files()
        self._files[out.part][band].add(out, stored)

    def finish(self) -> None:
        """The files, now that they are complete."""
        files = {
            part: self._files.get(part) or self._new_files()
            for part in completed_parts(self._files)
        }
        for band in self._bands:
            folder = f"annotations/{band}" if band else "annotations"
            for part, of_part in files.items():
                name = f"{folder}/{_file_name(part)}"
                # Where parts are others than those of the files, each is of them all.
                beside = self._beside.get(part) or chain(*self._beside.values())
                self._context.sink(name, of_part[band].pieces(joined_beside(beside)))

    def _new_files(self) -> dict[str, _CocoFile]:
        """The files of one part by band."""
        spool, rectangle = self._context.spool, self._context.options.boxes
        return {
            band: _CocoFile(spool(), spool(), self._categories, rectangle=rectangle)
            for band in self._bands
        }


_WRITTEN_KEYS: Final = KNOWN_FRAME_KEYS - {"boxes", "extra", "camera", "split"}
"""The keys of a frame that its image has as they are."""


def _file_name(part: str) -> str:
    return f"{_INSTANCES}_{part}.json"


class _Categories:
    """The classes of an export, and what COCO files have said of them."""

    def __init__(self, classes: Sequence[str]) -> None:
        self._classes = classes
        self._ids = _Ids()
        self._own: dict[str, dict[str, object]] = {}
        self._numbers: dict[str, CocoId] = {}

    def add(self, categories: object) -> None:
        """Note the categories of a frame by name; the first of a name counts."""
        if not isinstance(categories, Mapping):
            return
        for name, own in categories.items():
            if name not in self._numbers and isinstance(own, Mapping):
                self._own[name] = dict(own)
                self._numbers[name] = self._ids.take(own.get("id"))

    def number(self, place: int) -> CocoId:
        """The id of the class at this place of the list."""
        number = self._numbers.get(name := self._classes[place])
        if number is None:
            number = self._numbers[name] = self._ids.take(place + 1)
        return number

    def listed(self) -> list[dict[str, object]]:
        """The categories as COCO has them."""
        return [
            {
                **self._own.get(name, {"supercategory": "none"}),
                "id": self.number(place),
                "name": name,
            }
            for place, name in enumerate(self._classes)
        ]


class _Ids:
    """Ids that are different: those that came, else the next number from 1."""

    def __init__(self) -> None:
        self._taken: set[CocoId] = set()
        self._next = 1

    def take(self, own: object) -> CocoId:
        """An id that no other has; its own if possible."""
        number = coco_id(own)
        # A smaller number may have been given to one without an own.
        is_past = isinstance(number, int) and 0 < number < self._next
        if number is None or number in self._taken or is_past:
            return self.new()
        self._taken.add(number)
        return number

    def new(self) -> int:
        """The next number."""
        while self._next in self._taken:
            self._next += 1
        self._next += 1
        return self._next - 1


class _CocoFile:
    def __init__(
        self,
        images: Spool,
        annotations: Spool,
        categories: _Categories,
        *,
        rectangle: str,
    ) -> None:
        self._images, self._annotations = images, annotations
        self._categories = categories
        self._is_tight = rectangle == "tight"
        self._is_given = rectangle == "visible"
        self._image_ids, self._ids = _Ids(), _Ids()

    def add(self, out: OutFrame, stored: Mapping[str, object]) -> None:
        frame = out.frame
        number = self._image_ids.take(stored.get("image_id"))
        kept = {
            key: value
            for key, value in frame.given.frame.items()
            if key in _WRITTEN_KEYS
        }
        if frame.split and frame.split != part_of_labels(_file_name(out.part)):
            kept["split"] = frame.split
        if frame.given.camera is not None:
            kept["camera"] = frame.given.frame["camera"]
        extra = dict(frame.given.frame_extra())
        extra.pop(SOURCE_LABELS, None)  # in another format
        image = {
            **extra,
            **kept,
            **({"map": frame.map} if frame.map is not None else {}),
            "id": number,
            "file_name": f"{out.stem}{out.suffix}",
            "width": frame.wh[0],
            "height": frame.wh[1],
            "key": frame.key,
        }
        self._images.add(image, by_key=True)
        ids = self._ids
        for box in out.boxes:
            described = _described(box, frame, is_tight=self._is_tight)
            if stored:
                raw = frame.given.boxes[box.row]
                described = _as_came(described, raw, is_given=self._is_given)
            own = ids.take(_number_of(frame, box.row)) if stored else ids.new()
            described["category_id"] = self._categories.number(box.class_number)
            described["id"] = own
            described["image_id"] = number
            self._annotations.add(described, by_key=True)

    def pieces(self, beside: Mapping[str, object]) -> Iterator[bytes]:
        own = {"info": {"description": "written by Unghost"}, "licenses": []}
        others = {key: beside[key] for key in beside if key not in LISTS}
        yield json_bytes({**own, **others})[:-1]
        yield b',"categories":'
        yield json_bytes(self._categories.listed(), by_key=True)
        for key, spool in (
            ("images", self._images),
            ("annotations", self._annotations),
        ):
            yield f',\n"{key}":['.encode()
            yield from spool.pieces()
            yield b"]"
        yield b"}\n"


def _described(
    box: LabelBox, frame: ExportFrame, *, is_tight: bool
) -> dict[str, object]:
    """One annotation, without its own id and that of its image.

    `is_tight`: its rectangle is that of the visible pixels, and not the given one.
    """
    x_min, y_min, x_max, y_max = box.xyxy
    bbox = [_round(v) for v in (x_min, y_min, x_max - x_min, y_max - y_min)]
    kept = frame.given.box_extra(box.row)
    if is_tight:
        # An outline and an area that came with a box are those of its given rectangle.
        kept.pop("segmentation", None)
        kept.pop("area", None)
    if box.is_cut or "area" not in kept:
        kept["area"] = _round(bbox[2] * bbox[3])
    row = box.row
    boxes, raw = frame.boxes, frame.given.boxes[row]
    own = raw.get("attributes")
    attributes = dict(own) if isinstance(own, Mapping) else {}
    attributes |= {key: raw[key] for key in _ATTRIBUTES if key in raw}
    attributes["id"] = boxes.ids[row]
    distance = float(boxes.distance[row])
    if not math.isnan(distance):
        attributes["distance"] = _round(distance)
    verdict = boxes.effective_verdict(row)
    if verdict == "rejected":
        attributes["verdict"] = verdict
        attributes["reason"] = boxes.reason_label(row)
    return {
        "segmentation": [],
        "iscrowd": 0,
        **kept,
        **({"iscrowd": 1} if box.ignored else {}),
        "bbox": bbox,
        "attributes": attributes,
    }


_COMPOSED: Final = ("segmentation", "iscrowd", "area", "attributes")
"""Keys that an annotation is given if it has none."""


def _as_came(
    described: dict[str, object], raw: Mapping[str, object], *, is_given: bool
) -> dict[str, object]:
    """An annotation with only the keys that it came with, and its own numbers."""
    attributes = described["attributes"]
    is_rejected = isinstance(attributes, dict) and "verdict" in attributes
    own = {
        key: value
        for key, value in described.items()
        if key not in _COMPOSED
        or key in raw
        or (key == "iscrowd" and value)
        or (key == "attributes" and is_rejected)
    }
    if "attributes" in own and not is_rejected:
        own["attributes"] = raw["attributes"]
    if is_given and "xywh" in raw:
        own["bbox"] = raw["xywh"]
    return own


def _number_of(frame: ExportFrame, row: int) -> CocoId | None:
    """The annotation's own id, if it has one: a number, unless it is other text."""
    if "id" not in frame.given.boxes[row]:
        return None
    text = frame.boxes.ids[row]
    digits = text.removeprefix("-")
    is_number = digits.isascii() and digits.isdigit() and str(int(digits)) == digits
    return int(text) if is_number else text


_ATTRIBUTES: Final = ("type_id", "base_type", "instance_id", *FORMS_3D)


_DECIMALS: Final = 9


def _round(value: float) -> float:
    return round(value, _DECIMALS)
