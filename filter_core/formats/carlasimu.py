"""Folders of the tool carlasimu: images, labels by distance, and segmentations.

A label folder ``labels/labelNN`` holds the boxes up to NN metres, so that the folders
which have a box say between which distances it is. Labels have YOLO's form, or raw
centres in pixels; classes are numbered as in `_CARLASIMU_CLASSES`, if ``Readme.txt``
does not say otherwise. It also names the map and the weather of all frames.

On Windows it writes ``out/cam``, ``out/seg`` and so on; on Linux, folders whose names
have a backslash, such as ``out\\cam``.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import compress
from numbers import Real
from pathlib import Path
from typing import ClassVar, Final

import numpy as np

from filter_core.class_names import canonical_class, class_meant_by
from filter_core.errors import JsonError, LayoutError
from filter_core.formats.export import IMAGE_SUFFIX
from filter_core.formats.format import (
    FOLDER_OPTIONS,
    LABEL_NEEDS,
    LABEL_OPTIONS,
    Format,
    Recognition,
    Source,
)
from filter_core.formats.reading import (
    KEYS_NAME,
    FrameSet,
    FrameSource,
    Unmatched,
    annotated,
    frame_key,
    read_label_text,
)
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.same import (
    BESIDE,
    SOURCE_LABELS,
    OwnReading,
    joined_beside,
    stored_labels,
)
from filter_core.formats.streams import Streams, auxiliary_folders
from filter_core.formats.words import is_band
from filter_core.formats.writing import (
    RECTANGLE_KEYS,
    ExportContext,
    OutFrame,
    Traits,
    band_name,
    drawn_boxes,
)
from filter_core.formats.yolo import (
    RAW_COLUMNS,
    LabelFolders,
    frame_set,
    label_lines,
    line_rectangles,
    line_spans,
    ordered_names,
)
from filter_core.images.header import read_image_header
from filter_core.json_text import read_json
from filter_core.values import shown

CARLASIMU: Final = Format(
    name="carlasimu",
    title="carlasimu's folders",
    docs_row=(
        "labels in YOLO's form, or centres in raw pixels, in a folder for each "
        "distance band"
    ),
    brief="the folders of the paper's tool",
    recognised_by="carlasimu's labels/labelNN/ (label/ with img/ or Readme.txt)",
    read_options=FOLDER_OPTIONS | {"classes", "default_class"},
    needs=LABEL_NEEDS | {"files"},
    options=LABEL_OPTIONS | {"bands", "drawn"},
    numbers_classes=True,
)


@CARLASIMU.recogniser
def _recognise(source: Source) -> Recognition:
    camera = _camera_folder(source.path)
    if camera is None:
        return "none"
    # A ``label/`` alone may be anybody's.
    has_bands = any(is_band(path.name) for path in _bands(camera))
    is_theirs = (camera / "img").is_dir() or (camera / _README).is_file()
    return "certain" if has_bands or is_theirs else "none"


def _camera_folder(root: Path) -> Path | None:
    """The folder with carlasimu's labels: the one given, or one below ``out``."""
    if not root.is_dir():
        return None
    below = sorted(path for path in root.iterdir() if path.is_dir())
    nested = sorted(path for path in (root / "out").glob("*") if path.is_dir())
    places = (root, *below, *nested)
    return next((path for path in places if _bands(path)), None)


def _bands(folder: Path) -> list[Path]:
    """The folders of the distance bands, the widest last; else the only one."""
    labels = folder / "labels"
    if labels.is_dir():
        bands = [path for path in labels.iterdir() if is_band(path.name)]
        if bands:
            return sorted(bands, key=_metres)
    single = folder / "label"
    return [single] if single.is_dir() else []


def _metres(band: Path) -> int:
    """Up to which distance a folder has boxes."""
    return int(band.name[len("label") :])


_IMAGES: Final = ("images", "img")

_README: Final = "Readme.txt"

_README_KEYS: Final = (
    *("classes", "box", "weather", "img_size", "distance", "map"),
    *("number_of_vehicles", "number_of_walkers", "radar"),
)
"""In the order in which the tool writes them."""


CARLASIMU.spans(line_spans)


@CARLASIMU.reader
def read_carlasimu(root: Path, options: RecordingDescription) -> FrameSet:
    """The frames of a carlasimu folder, by the widest of its distance bands.

    The bands are cumulative (``label200`` holds what ``label50`` does), so the others
    only say how far away a box is (``distance_range``); a frame that only a narrower
    band has is listed as unmatched. Raises `LayoutError`: there is neither
    ``labels/labelNN/`` nor ``label/``.
    """
    camera = _camera_folder(root)
    if camera is None:
        raise LayoutError("expected labels/labelNN/ or label/, found neither")
    bands = _bands(camera)
    labels = options.labels or bands[-1]
    images = next((camera / n for n in _IMAGES if (camera / n).is_dir()), labels)
    # On Linux it writes `out\\seg`, a folder of this name beside `out` or `out\\cam`.
    above = camera.name.split("\\")[0]
    beside = auxiliary_folders(camera, camera.parent, of=above)
    radar = next(filter(Path.is_dir, _beside(camera, "radar")), None)
    lidar = next(filter(Path.is_dir, _beside(camera, "lidar")), None)
    document = _read_readme(camera)
    folders = LabelFolders(
        images=images,
        labels=labels,
        classes=tuple(options.classes or _carlasimu_classes(camera)),
        default_class=options.default_class,
        beside=document,
        export=root if (root / KEYS_NAME).is_file() else None,
    )
    names = partial(options.files.walk, root, suffixes=(".txt",))
    streams = Streams(images, options, root=root, beside=beside)
    frames = frame_set("carlasimu", folders, streams, names(labels))
    narrower_bands = () if options.labels else bands[:-1]
    widest = set(map(frame_key, names(bands[-1]))) if narrower_bands else set()
    narrower = [
        Unmatched(f"{band.name}/{name}", f"not in the widest band, {bands[-1].name}")
        for band in narrower_bands
        for name in names(band)
        if frame_key(name) not in widest
    ]
    texts, notes = frames.texts, frames.notes
    # Map and weather from carlasimu's ``Readme.txt``, as keys of an annotation
    of_all: dict[str, object] = {}
    if isinstance(town := document.get("map"), str):
        of_all["map"] = town
    numbers = _WEATHER.findall(str(document.get("weather", "")))
    if numbers:
        of_all["weather"] = {name: float(value) for name, value in numbers}

    within = bands if not options.labels and is_band(labels.name) else ()

    def read() -> Iterator[FrameSource]:
        for frame in frames.frames():
            if frame.annotation is None or frame.label is None:
                yield frame
                continue
            others = dict(frame.others)
            name = f"{Path(frame.label).stem}.ply"
            if points := _file_in(radar, name):
                others["radar"] = points
            own = {**of_all, **frame.annotation}
            ranged = partial(_with_ranges, own, within, frame.label)
            plain = _file_in(lidar, name)
            completed = replace(frame, others=others, plain_points=plain)
            yield annotated(completed, ranged)

    return replace(
        frames,
        frames=read,
        unmatched=(*frames.unmatched, *narrower),
        texts=lambda: (*(texts() if texts else ()), camera / _README),
        notes=lambda: (*notes(), *((_PLAIN_LIDAR,) if lidar else ())),
    )


_PLAIN_LIDAR: Final = (
    "the LiDAR files are not measured: carlasimu writes points without tags, which "
    "are no evidence"
)


def _beside(camera: Path, sensor: str) -> Iterator[Path]:
    """Where the folder of a sensor may be, as it is called on Windows and on Linux."""
    above = camera.name.split("\\")[0]
    yield from (
        place / name
        for place in (camera, camera.parent)
        for name in (sensor, f"{above}\\{sensor}")
    )


def _file_in(folder: Path | None, name: str) -> Path | None:
    path = folder and folder / name
    return path if path and path.is_file() else None


def _with_ranges(
    annotation: Mapping[str, object], bands: Sequence[Path], label: str
) -> Mapping[str, object]:
    """An annotation from the widest band, with ``distance_range`` for each box.

    A box is in all bands from the narrowest one that is wide enough for it, as the same
    line of text.
    """
    boxes = annotation["boxes"]
    if not bands or not isinstance(boxes, list):
        return annotation
    lines = [_lines_of(band, label) for band in bands]
    limits = [0, *(_metres(band) for band in bands)]
    left = list(map(Counter, lines))
    ranged = []
    for box, line in zip(boxes, lines[-1], strict=True):
        # The widest band has the line itself.
        first = next(number for number, rest in enumerate(left) if rest[line] > 0)
        for rest in left[first:]:
            rest[line] -= 1
        between = [float(limits[first]), float(limits[first + 1])]
        ranged.append({**box, "distance_range": between})
    return {**annotation, "boxes": ranged}


def _lines_of(band: Path, label: str) -> list[str]:
    """The lines of a label file that are not empty; none if a band lacks the file."""
    if not (band / label).is_file():
        return []
    text = read_label_text(band / label, f"{band.name}/{label}")
    return [" ".join(line.split()) for line in text.splitlines() if line.strip()]


_WEATHER: Final = re.compile(r"(\w+)=(-?\d+(?:\.\d+)?)")
"""A number in the text of `carla.WeatherParameters`: ``cloudiness=20.000000``."""


_CARLASIMU_CLASSES: Final = ("car", "bus", "truck", "van", "walker", "street_light")
"""The order that carlasimu writes; it has no numbers for two-wheelers."""


def _carlasimu_classes(root: Path) -> tuple[str, ...]:
    """Class names from carlasimu's ``Readme.txt``, else in the order of its code."""
    numbers = _read_readme(root).get("classes")
    if not isinstance(numbers, dict):
        return _CARLASIMU_CLASSES
    for number in numbers.values():
        if not isinstance(number, int):
            raise LayoutError(
                f"{_README}: expected a number for each class, found {shown(number)}"
            )
    return ordered_names({number: word for word, number in numbers.items()}, _README)


def _read_readme(root: Path) -> Mapping[str, object]:
    """The content of carlasimu's ``Readme.txt``; nothing if it is somebody else's."""
    path = root / _README
    if not path.is_file():
        return {}
    try:
        document = read_json(read_label_text(path, _README))
    except JsonError:
        # People put other readmes into folders; only carlasimu's own is JSON.
        return {}
    return document if isinstance(document, dict) else {}


@CARLASIMU.label_writer
class CarlaSimuWriter:
    """Writes ``out/cam`` with images, labels and ``Readme.txt``, and ``out/seg``.

    Also ``out/depth``, ``out/lidar`` and ``out/radar`` where a frame has such a file.
    Classes have the numbers that the tool gives them, by what their names mean; others
    follow. A box beyond the widest band is in none, as there, and is counted.
    """

    traits: ClassVar[Traits] = Traits(
        image="out/cam/images/{stem}{suffix}",
        needs_key_list=True,
        needs_flat_names=True,
        box_keys=RECTANGLE_KEYS | {"distance", "distance_range"},
        frame_keys=frozenset({"boxes", "map", "weather", SOURCE_LABELS}),
        own=OwnReading(line_spans, line_rectangles),
        bands=(50, 100, 150, 200),
    )

    def __init__(self, context: ExportContext) -> None:
        self._context = context
        self._bands = context.options.bands or self.traits.bands
        self._numbers = {name: at for at, name in enumerate(_CARLASIMU_CLASSES)}
        # Their numbers are those that ``Readme.txt`` lists.
        theirs = {canonical_class(name): name for name in _CARLASIMU_CLASSES}
        names = (
            theirs.get(class_meant_by(name) or "", name)
            for name in context.head.classes
        )
        self._number_of = [
            self._numbers.setdefault(name, len(self._numbers)) for name in names
        ]
        self._beside: list[object] = []
        self._facts: dict[str, Counter[str]] = {"map": Counter(), "weather": Counter()}
        self._beyond = 0
        self._size: tuple[int, int] | None = None

    def labels(self, band: str, out: OutFrame) -> None:
        """The label file of a band; without one, the frame's other files."""
        if not band:
            self._add(out)
            self._beyond += len(out.boxes)
            return
        if band == band_name(self._bands[-1]):
            self._beyond -= len(out.boxes)
        numbers = {box.row: self._number_of[box.class_number] for box in out.boxes}
        if out.own is None:
            places = np.array(list(numbers.values()), np.int64)
            boxes = replace(out.boxes, class_number=places)
            text = "".join(label_lines(boxes, out.frame.wh))
        else:
            words = {row: str(number) for row, number in numbers.items()}
            text = out.own.with_words(words, fewest_columns=RAW_COLUMNS + 1)
        name = f"out/cam/labels/{band}/{out.stem}.txt"
        self._context.sink(name, [text.encode()])

    def _add(self, out: OutFrame) -> None:
        frame, context = out.frame, self._context
        if out.own is not None:
            context.note_own("")
        beside = stored_labels(frame.given, CARLASIMU.name).get(BESIDE)
        self._beside += [beside] if beside else []
        self._size = self._size or frame.wh
        weather = frame.given.frame.get("weather")
        if frame.map:
            self._facts["map"][frame.map] += 1
        if isinstance(weather, Mapping):
            # As `str` of `carla.WeatherParameters` is, which ``Readme.txt`` has
            values = ", ".join(
                f"{name}={float(value):.6f}"
                for name, value in weather.items()
                if isinstance(value, Real)
            )
            self._facts["weather"][f"WeatherParameters({values})"] += 1
        if context.options.images == "copy":
            self._copy_files(out)
        if context.options.drawn and frame.draw:
            rows = set(out.boxes.row.tolist())
            for folder, only in (("images_bbox", None), ("images_bbox_filter", rows)):
                boxes = list(drawn_boxes(frame.boxes, only=only, metres=True))
                context.sink(f"out/cam/{folder}/{out.stem}.png", [frame.draw(boxes)])

    def _copy_files(self, out: OutFrame) -> None:
        for kind, folder in _FOLDERS.items():
            if read := out.frame.read_files.get(kind):
                content = read()
                begins = map(content.startswith, _CLOUDS)
                suffix = next(compress(_CLOUDS.values(), begins), "")
                suffix = suffix or IMAGE_SUFFIX[read_image_header(content).media_type]
                name = f"out/{folder}/{out.stem}{suffix}"
                self._context.sink(name, [content])

    def finish(self) -> None:
        """``Readme.txt``: what the tool said where the frames are its own, else ours.

        Its map and weather are those of most frames; ``frames.jsonl`` has each map.
        """
        width, height = self._size or (0, 0)
        usual = {
            key: counts.most_common(1)[0][0]
            for key, counts in self._facts.items()
            if counts
        }
        theirs = joined_beside(self._beside)
        limits = theirs.get("distance")
        distance: dict[str, object] = {"max_distance": list(self._bands)}
        if isinstance(limits, Mapping) and "min_distance" in limits:
            distance["min_distance"] = limits["min_distance"]
        document: dict[str, object] = {
            "box": "[x_center,y_center,width,hight]",
            **theirs,
            "img_size": {"width": width, "hight": height},
            "classes": self._numbers,
            **usual,
            "distance": distance,
        }
        several = {
            key: dict(counts) for key, counts in self._facts.items() if len(counts) > 1
        }
        if self._beyond:
            self._context.facts["beyond_all_bands"] = self._beyond
        if several:
            self._context.facts["several_in_one_readme"] = several
        names = [*_README_KEYS, *sorted(document.keys() - set(_README_KEYS))]
        ordered = {name: document[name] for name in names if name in document}
        text = json.dumps(ordered, indent=4, ensure_ascii=False)
        self._context.sink(f"out/cam/{_README}", [text.encode("utf-8", "replace")])


_FOLDERS: Final = {
    "segmentation": "seg",
    "depth": "depth",
    "lidar": "lidar",
    "radar": "radar",
}
"""The folders of the tool by the files of a frame."""

_CLOUDS: Final = {b"ply": ".ply", b"\x93NUMPY": ".npy"}
"""The suffixes of point clouds by the first bytes of their files."""
