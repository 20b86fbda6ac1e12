"""Folders that the tool carlasimu writes: images, labels by distance, and seg.

A label folder ``labels/labelNN`` holds the boxes up to NN metres. Labels have YOLO's
form, or raw centres in pixels; classes are numbered as in `_CARLASIMU_CLASSES`, if
``Readme.txt`` does not say otherwise.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

from filter_core.errors import JsonError, LayoutError
from filter_core.formats.format import FOLDER_OPTIONS, Format, Recognition, Source
from filter_core.formats.reading import (
    FrameSet,
    Unmatched,
    frame_key,
    read_label_text,
    walk,
)
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.streams import Streams, auxiliary_folders
from filter_core.formats.yolo import LabelFolders, frame_set, ordered_names
from filter_core.json_text import read_json
from filter_core.values import shown

CARLASIMU: Final = Format(
    name="carlasimu",
    title="carlasimu",
    docs_row=(
        "labels in YOLO's form, or centres in raw pixels, in a folder for each "
        "distance band"
    ),
    recognised_by="carlasimu's labels/labelNN/ (label/ with img/ or Readme.txt)",
    read_options=FOLDER_OPTIONS | {"classes", "default_class"},
)


@CARLASIMU.recogniser
def _recognise(source: Source) -> Recognition:
    camera = _camera_folder(source.path)
    return "certain" if camera and _is_carlasimus(camera) else "none"


def _camera_folder(root: Path) -> Path | None:
    """The folder with carlasimu's labels: the one given, or one right below it."""
    if not root.is_dir():
        return None
    below = sorted(path for path in root.iterdir() if path.is_dir())
    return next((path for path in (root, *below) if _has_labels(path)), None)


def _has_labels(folder: Path) -> bool:
    return bool(_bands(folder))


_BAND: Final = re.compile(r"label(\d+)", re.IGNORECASE)


def _bands(folder: Path) -> list[Path]:
    """The folders of the distance bands, the widest last; else the only one."""
    labels = folder / "labels"
    if labels.is_dir():
        found = [path for path in labels.iterdir() if _BAND.fullmatch(path.name)]
        if found:
            return sorted(found, key=lambda path: int(path.name[len("label") :]))
    single = folder / "label"
    return [single] if single.is_dir() else []


def _is_carlasimus(folder: Path) -> bool:
    """Whether carlasimu wrote a folder: a ``label/`` alone may be anybody's."""
    has_bands = any(_BAND.fullmatch(path.name) for path in _bands(folder))
    has_list = (folder / _README).is_file()
    return has_bands or (
        bool(_bands(folder)) and ((folder / "img").is_dir() or has_list)
    )


_IMAGES: Final = ("images", "img")

_README: Final = "Readme.txt"


@CARLASIMU.reader
def read_carlasimu(root: Path, options: RecordingDescription) -> FrameSet:
    """The frames of a carlasimu folder, by the widest of its distance bands.

    The bands are cumulative (``label200`` holds what ``label50`` does), so the others
    add nothing; a frame that only a narrower band has is listed as unmatched.

    Raises
    ------
    LayoutError
        There is neither ``labels/labelNN/`` nor ``label/``.
    """
    camera = _camera_folder(root)
    if camera is None:
        raise LayoutError("expected labels/labelNN/ or label/, found neither")
    bands = _bands(camera)
    labels = options.labels or bands[-1]
    images = next((camera / n for n in _IMAGES if (camera / n).is_dir()), labels)
    # On Linux it writes `out\\seg`, a folder of this name beside `out`.
    beside = auxiliary_folders(camera, camera.parent, of=camera.name)
    folders = LabelFolders(
        images=images,
        labels=labels,
        streams=Streams(images, options.segmentation, beside=beside),
        classes=tuple(options.classes or _carlasimu_classes(camera)),
        default_class=options.default_class,
    )
    frames = frame_set("carlasimu", folders, walk(labels, (".txt",)))
    narrower = [] if options.labels else list(_only_narrower(bands))
    read = frames.texts
    return replace(
        frames,
        unmatched=(*frames.unmatched, *narrower),
        texts=lambda: (*(read() if read else ()), camera / _README),
    )


_CARLASIMU_CLASSES: Final = ("car", "bus", "truck", "van", "walker", "street_light")
"""The order that carlasimu writes; it has no numbers for two-wheelers."""


def _carlasimu_classes(root: Path) -> tuple[str, ...]:
    """Class names from carlasimu's ``Readme.txt``, else in the order of its code."""
    path = root / _README
    if not path.is_file():
        return _CARLASIMU_CLASSES
    try:
        document = read_json(read_label_text(path, _README))
    except JsonError:
        # People put other readmes into folders; only carlasimu's own is JSON.
        return _CARLASIMU_CLASSES
    numbers = document.get("classes") if isinstance(document, dict) else None
    if not isinstance(numbers, dict):
        return _CARLASIMU_CLASSES
    for number in numbers.values():
        if not isinstance(number, int):
            raise LayoutError(
                f"{_README}: expected a number for each class, found {shown(number)}"
            )
    return ordered_names({number: word for word, number in numbers.items()}, _README)


def _only_narrower(bands: list[Path]) -> Iterator[Unmatched]:
    widest = {frame_key(name) for name in walk(bands[-1], (".txt",))}
    for band in bands[:-1]:
        for name in walk(band, (".txt",)):
            if frame_key(name) not in widest:
                yield Unmatched(
                    f"{band.name}/{name}", f"not in the widest band, {bands[-1].name}"
                )
