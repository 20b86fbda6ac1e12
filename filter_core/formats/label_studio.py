"""Label Studio: tasks with people's annotations and the filter's predictions.

References
----------
.. [1] HumanSignal, "Label Studio JSON format of annotated tasks",
   https://labelstud.io/guide/task_format
.. [2] HumanSignal, "RectangleLabels" (rotation),
   https://labelstud.io/tags/rectanglelabels
"""

from __future__ import annotations

import html
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import timedelta
from functools import partial
from itertools import chain
from pathlib import Path
from typing import ClassVar, Final
from urllib.parse import quote

from filter_core.errors import LayoutError
from filter_core.formats.export import ExportFrame
from filter_core.formats.files import attributes
from filter_core.formats.format import (
    FOLDER_OPTIONS,
    LABEL_NEEDS,
    LABEL_OPTIONS,
    Format,
    Recognition,
    Source,
)
from filter_core.formats.reading import (
    IMAGE_SUFFIXES,
    LOCAL_FILES,
    FrameSet,
    FrameSource,
    Labelled,
    Unmatched,
    annotated,
    counted_notes,
    open_regular,
    read_label_text,
    relative_path,
    split_name,
    time_of,
)
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.streams import listed_frames, listing_files
from filter_core.formats.tables.json_items import JsonItem, decode_value, read_list
from filter_core.formats.tables.patterns import FilePatterns
from filter_core.formats.writing import ExportContext, LabelBoxes, OutFrame, Traits
from filter_core.values import shown
from filter_core.verdicts import REJECTED

LABEL_STUDIO: Final = Format(
    name="label-studio",
    title="Label Studio",
    docs_row=(
        "`tasks.json`: for each frame an annotation with all boxes, and a prediction "
        "with the filter's own and their scores; `label_config.xml` for the project"
    ),
    brief="tasks with predictions",
    recognised_by="Label Studio's .json file of tasks",
    read_options=FOLDER_OPTIONS | {"classes", "default_class"},
    needs=LABEL_NEEDS,
    options=LABEL_OPTIONS,
)

_CONFIG_NAME: Final = "label_config.xml"


@LABEL_STUDIO.recogniser
def _recognise(source: Source) -> Recognition:
    return "certain" if _task_files(source.path, source.files) else "none"


def _task_files(root: Path, files: FilePatterns) -> list[Path]:
    return [path for path in files.glob(root, "*.json") if _has_tasks(path)]


_OF_TASK: Final = ("annotations", "predictions", "completions")


def _has_tasks(path: Path) -> bool:
    """Whether a file is a list whose first value is a task; never raises."""
    if path.suffix.lower() != ".json":
        return False
    try:
        with open_regular(path) as file:
            first = next((item.value for item in read_list(file, path.name)), None)
    except (LayoutError, OSError):
        return False
    task = _mapping(first)
    return isinstance(task.get("data"), dict) and any(key in task for key in _OF_TASK)


@dataclass(frozen=True)
class _Task:
    """The place of a task in its file, what names its frame, and who labelled it."""

    path: Path
    item: JsonItem
    key: str | None
    image: str
    labelled: Labelled | None

    def read(self) -> Mapping[str, object]:
        """The task."""
        try:
            with open_regular(self.path) as file:
                content = self.item.read(file)
        except OSError as exc:
            raise LayoutError(f"{self.path.name}: cannot be read: {exc}") from exc
        return _mapping(decode_value(content, self.path.name))


def _mapping(value: object) -> Mapping[str, object]:
    return value if isinstance(value, Mapping) else {}


def _list(value: object) -> Sequence[object]:
    return value if isinstance(value, list) else ()


@LABEL_STUDIO.reader
def read_label_studio(root: Path, options: RecordingDescription) -> FrameSet:
    """The frames of Label Studio's files of tasks, as an export or a project has them.

    Of several annotations of a task the one that is marked as ground truth counts, else
    the one that was changed last. A task without an annotation has the boxes of its
    last prediction; one with neither was not labelled yet, and is listed. Raises
    `LayoutError`: no file of tasks, or one that cannot be read.
    """
    expected = "a .json file with Label Studio's tasks"
    paths = listing_files(root, options, _task_files, expected)
    folder = root.parent if root.is_file() else root
    tasks: list[_Task] = []
    without: list[Unmatched] = []
    for path in paths:
        for number, (task, item) in enumerate(_tasks(path)):
            at = f"task {shown(task.get('id', number))}"
            data = _mapping(task.get("data"))
            key, image = data.get("key"), _image_of(data)
            if image is None:
                why = f"{at}: expected the path of an image in data, found none"
                without.append(Unmatched(path.name, why))
            elif _chosen(task) is None:
                without.append(Unmatched(path.name, f"{at}: not labelled yet"))
            else:
                own = key if isinstance(key, str) and key else None
                labelled = _labelled(task)
                place = replace(item, value=None)
                tasks.append(_Task(path, place, own, image, labelled))
    listed = listed_frames(
        folder, options, [(task.key, task.image) for task in tasks], "task"
    )
    reading = _Reading(options.default_class)

    def frames() -> Iterator[FrameSource]:
        reading.counts.clear()
        for frame, task in zip(listed, tasks, strict=True):
            if not frame.problem:
                frame = replace(frame, labelled=task.labelled)
                frame = annotated(frame, partial(reading.annotation, task))
            yield frame

    return replace(
        listed,
        layout="label-studio",
        frames=frames,
        classes=tuple(options.classes or _classes(folder)) or None,
        unmatched=(*listed.unmatched, *without),
        notes=lambda: (*listed.notes(), *counted_notes(reading.counts, _NOTES)),
        texts=lambda: [*paths, folder / _CONFIG_NAME],
    )


def _tasks(path: Path) -> Iterator[tuple[Mapping[str, object], JsonItem]]:
    with open_regular(path) as file:
        for item in read_list(file, path.name):
            text = item.value if isinstance(item.value, dict) else {}
            if any(
                isinstance(value, str) and not value.isascii()
                for value in _mapping(text.get("data")).values()
            ):  # the file was read as Latin-1
                with open_regular(path) as again:
                    content = item.read(again)
                text = {
                    **text,
                    "data": _mapping(decode_value(content, path.name)).get("data"),
                }
            yield text, item


_UPLOADED: Final = re.compile(r"(?<=/)[0-9a-f]{8}-(?=[^/]+$)")
"""What Label Studio puts before the names of uploaded files."""


def _image_of(data: Mapping[str, object]) -> str | None:
    """The relative path of a task's image: under ``image``, or the first one."""
    values = (data.get("image"), *data.values())
    paths = (value for value in values if isinstance(value, str))
    for address in paths:
        path, _ = relative_path(address)
        path = path.partition("?")[0]
        if split_name(path)[1].lower() in IMAGE_SUFFIXES:
            return _UPLOADED.sub("", f"/{path}")[1:] if "/upload/" in address else path
    return None


def _chosen(task: Mapping[str, object]) -> tuple[Mapping[str, object], bool] | None:
    """The labelling of a task that counts, and whether it is an annotation."""
    labellings = task.get("annotations", task.get("completions"))
    annotations = [
        labelling
        for labelling in map(_mapping, _list(labellings))
        if not labelling.get("was_cancelled") and not labelling.get("skipped")
    ]
    if annotations:
        best = max(
            enumerate(annotations),
            key=lambda numbered: (
                numbered[1].get("ground_truth") is True,
                # Texts in ISO 8601 have the order of their times.
                str(
                    numbered[1].get("updated_at") or numbered[1].get("created_at") or ""
                ),
                numbered[0],
            ),
        )
        return best[1], True
    predictions = [
        prediction
        for prediction in map(_mapping, _list(task.get("predictions")))
        if prediction
    ]
    return (predictions[-1], False) if predictions else None


def _labelled(task: Mapping[str, object]) -> Labelled | None:
    """Who made the annotation that counts, and when; None if it was only imported.

    Label Studio gives imported annotations a person and a time, too, but they have no
    time that was spent on them (``lead_time``), and were not changed later.
    """
    chosen = _chosen(task)
    if chosen is None or not chosen[1]:
        return None
    annotation = chosen[0]
    created, updated = (time_of(annotation.get(f"{word}_at")) for word in _WHEN)
    is_changed = created and updated and updated - created > _AT_ONCE
    if annotation.get("lead_time") is None and not is_changed:
        return None
    who = annotation.get("completed_by")
    name = _mapping(who).get("email") or _mapping(who).get("username")
    if isinstance(who, int):
        name = f"label-studio-{who}"
    return Labelled(str(name)[:_MOST_NAME] if name else None, updated or created)


_WHEN: Final = ("created", "updated")

_AT_ONCE: Final = timedelta(seconds=1)
"""Between the two times of an annotation that was never changed, at most."""

_MOST_NAME: Final = 100
"""Letters of a reviewer's name."""


def _classes(folder: Path) -> list[str]:
    """The labels of the project's interface in their order, if it is there."""
    try:
        text = read_label_text(folder / _CONFIG_NAME, _CONFIG_NAME)
    except LayoutError:
        return []
    return [html.unescape(name) for name in _LABEL.findall(text)]


_LABEL: Final = re.compile(r"""<Label\s[^<>]{0,1000}?value=["']([^"'<>]{1,1000})["']""")


@dataclass
class _Reading:
    """Reads tasks, and counts what is no plain rectangle."""

    default_class: str
    counts: Counter[str] = field(default_factory=Counter)

    def annotation(self, task: _Task) -> dict[str, object]:
        """The boxes of one task."""
        document = task.read()
        chosen = _chosen(document)
        labelling, is_annotation = chosen or ({}, True)
        self.counts["prediction"] += not is_annotation
        regions = [_mapping(region) for region in _list(labelling.get("result"))]
        # By the id of the region, of which they may be a result of their own
        labels = {
            region["id"]: label
            for region in regions
            if isinstance(region.get("id"), str | int)
            and (label := _label(_mapping(region.get("value"))))
        }
        boxes = []
        size: dict[str, int] = {}
        for number, region in enumerate(regions):
            at = f"task {shown(document.get('id'))}, region {number}"
            box = self._box(region, labels, at)
            if box is not None:
                boxes.append(box)
                size = size or _size(region)
        data = _mapping(document.get("data"))
        about = {
            key: data[key] for key in ("map", "split") if isinstance(data.get(key), str)
        }
        return {**about, **({"camera": size} if size else {}), "boxes": boxes}

    def _box(
        self, region: Mapping[str, object], labels: Mapping[object, str], at: str
    ) -> dict[str, object] | None:
        value = _mapping(region.get("value"))
        points = value.get("points")
        if {"x", "y", "width", "height"} <= value.keys():
            corners = _corners(value, region, at)
            self.counts["rotated"] += value.get("rotation") not in (None, 0)
        elif isinstance(points, list) and points:
            corners = [_pair(point, at) for point in points]
            self.counts["outline"] += 1
        else:
            if region.get("type") != "labels":
                self.counts["other"] += 1
            return None
        number = region.get("id")
        has_id = isinstance(number, str | int)
        of_id = labels.get(number) if has_id else None
        label = _label(value) or of_id or self.default_class
        edges = [[corner[axis] / 100 for corner in corners] for axis in (0, 1)]
        size = _size(region)
        sides = [size["width"], size["height"]] if size else [1, 1]
        low, high = (
            [side * of(axis) for side, axis in zip(sides, edges, strict=True)]
            for of in (min, max)
        )
        box: dict[str, object] = {
            "class": label,
            ("xyxy" if size else "xyxyn"): [*low, *high],
        }
        if has_id:
            box["id"] = number
        return box


def _label(value: Mapping[str, object]) -> str | None:
    """The first label of a region."""
    for key in ("rectanglelabels", "polygonlabels", "labels"):
        names = value.get(key)
        if isinstance(names, list) and names and isinstance(names[0], str):
            return names[0]
    return None


def _size(region: Mapping[str, object]) -> dict[str, int]:
    """Width and height of the image in px, if the region has them."""
    sides = [region.get(f"original_{side}") for side in ("width", "height")]
    width, height = (
        side if isinstance(side, int) and side > 0 else 0 for side in sides
    )
    return {"width": width, "height": height} if width and height else {}


def _number(value: object, at: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise LayoutError(f"{at}: expected a number, found {shown(value)}")
    if not math.isfinite(value):
        raise LayoutError(f"{at}: expected a finite number, found {value}")
    return float(value)


def _pair(value: object, at: str) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != len("xy"):
        raise LayoutError(f"{at}: expected points of two numbers, found {shown(value)}")
    return _number(value[0], at), _number(value[1], at)


def _corners(
    value: Mapping[str, object], region: Mapping[str, object], at: str
) -> list[tuple[float, float]]:
    """The corners of a rectangle in percent; it is turned about the first, clockwise.

    It is turned in pixels, so for an image whose size is not known as if of a square.
    """
    x, y, width, height, angle = (
        _number(value.get(key, 0), at)
        for key in ("x", "y", "width", "height", "rotation")
    )
    if not angle:
        return [(x, y), (x + width, y + height)]
    size = _size(region) or {"width": 1, "height": 1}
    aspect = size["height"] / size["width"]
    cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    return [
        (x + right * cos - down * aspect * sin, y + right / aspect * sin + down * cos)
        for right in (0.0, width)
        for down in (0.0, height)
    ]


_NOTES: Final = {
    "prediction": "{:,} tasks have no annotation: their boxes are those of the last "
    "prediction",
    "rotated": "{:,} rotated rectangles were read as the rectangles around them",
    "outline": "{:,} outlines were read as the rectangles around them",
    "other": "{:,} results that are no rectangles or outlines were left out",
}


@LABEL_STUDIO.label_writer
class LabelStudioWriter:
    """Writes ``tasks.json``, ``label_config.xml`` and ``images/STEM.png``.

    Rectangles are in percent of the image. A task has one annotation with all boxes,
    since Label Studio takes an annotation as the whole labelling, and exports nothing
    else: of a frame whose boxes are all rejected its result is empty, and the task is
    done. Its boxes say whether a person decided them (``origin``). The prediction has
    those that the filter did not reject, with their shares of matching pixels.
    """

    traits: ClassVar[Traits] = Traits(image="images/{stem}{suffix}")

    def __init__(self, context: ExportContext) -> None:
        self._context = context
        self._tasks = context.spool()

    def labels(self, band: str, out: OutFrame) -> None:
        """One task."""
        not_rejected = out.frame.boxes.verdict[out.boxes.row] != REJECTED
        regions = _regions(out.boxes, out.frame)
        task = {
            "id": out.number + 1,
            "data": {
                "image": LOCAL_FILES + quote(out.image),
                "key": out.frame.key,
                "map": out.frame.map,
                "split": out.part,
            },
            "predictions": [self._prediction(out.boxes[not_rejected], out.frame)],
            "annotations": [{"result": regions, "ground_truth": False}],
        }
        self._tasks.add(task)

    def finish(self) -> None:
        """The tasks, and the labelling interface that shows them."""
        tasks = chain([b"["], self._tasks.pieces(), [b"\n]\n"])
        self._context.sink("tasks.json", tasks)
        labels = "".join(
            f"    <Label{attributes(value=name)}/>\n"
            for name in self._context.head.classes
        )
        config = (
            '<View>\n  <Image name="image" value="$image"/>\n'
            '  <RectangleLabels name="label" toName="image">\n'
            f"{labels}  </RectangleLabels>\n</View>\n"
        )
        self._context.sink("label_config.xml", [config.encode("utf-8", "replace")])

    def _prediction(self, chosen: LabelBoxes, frame: ExportFrame) -> dict[str, object]:
        digest = self._context.head.facts.get("config")
        all_scores = (_score(row, frame) for row in chosen.row.tolist())
        scores = [score for score in all_scores if score is not None]
        return {
            "model_version": f"unghost-{str(digest)[:12]}" if digest else "unghost",
            "score": min(scores, default=None),
            "result": _regions(chosen, frame),
        }


def _regions(chosen: LabelBoxes, frame: ExportFrame) -> list[dict[str, object]]:
    boxes, (width, height) = frame.boxes, frame.wh
    regions = []
    for box in chosen:
        row, (x_min, y_min, x_max, y_max) = box.row, box.xyxy
        score = _score(row, frame)
        verdict, reason = boxes.effective_verdict(row), boxes.reason_label(row)
        region: dict[str, object] = {
            "id": boxes.ids[row],
            "type": "rectanglelabels",
            "from_name": "label",
            "to_name": "image",
            "original_width": width,
            "original_height": height,
            "image_rotation": 0,
            "origin": "manual" if boxes.is_reviewed(row) else "prediction",
            "value": {
                "x": _percent(x_min, width),
                "y": _percent(y_min, height),
                "width": _percent(x_max - x_min, width),
                "height": _percent(y_max - y_min, height),
                "rotation": 0,
                "rectanglelabels": [boxes.class_name(row)],
            },
            **({} if score is None else {"score": score}),
            "meta": {"text": [f"{verdict}: {reason}"]},
        }
        regions.append(region)
    return regions


_DECIMALS: Final = 12


def _percent(part: float, side: int) -> float:
    return round(100 * part / side, _DECIMALS)


def _score(row: int, frame: ExportFrame) -> float | None:
    """The share of a box's pixels that match; None if they were not measured."""
    match = float(frame.boxes.match_percent[row])
    return None if math.isnan(match) else match / 100
