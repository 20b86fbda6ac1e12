"""YOLO as Ultralytics reads it: images, labels, data.yaml, and the books."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import yaml

from filter_core.formats.export_frame import (
    IMAGE_SUFFIX,
    ExportBox,
    ExportFrame,
    ExportHead,
    Rectangle,
    Sink,
    file_stem,
)
from filter_core.formats.export_tally import ExportError, ExportTally

_DECIMALS: Final = 8
"""Finer than a thousandth of a pixel in the largest image."""


@dataclass(frozen=True)
class YoloOptions:
    """What of a dataset is exported, and how.

    Attributes
    ----------
    include : ``effective`` (what a person or else the filter keeps), ``kept`` (what the
        filter keeps, whatever people say) or ``all``
    include_unmeasured : bool
        Also boxes that nothing could be measured of and nobody has decided.
    boxes : ``visible`` or ``amodal`` rectangles, where a box has both
    images : ``copy`` or ``none``
    split : share of the frames that are for training, 0..1
    """

    include: Literal["effective", "kept", "all"] = "effective"
    include_unmeasured: bool = False
    boxes: Literal["visible", "amodal"] = "visible"
    images: Literal["copy", "none"] = "copy"
    split: float = 0.8

    def __post_init__(self) -> None:
        if not 0 <= self.split <= 1:
            raise ExportError(
                f"split: expected a share from 0 to 1, found {self.split}"
            )


def write_yolo(
    frames: Iterable[ExportFrame],
    sink: Sink,
    head: ExportHead,
    options: YoloOptions,
) -> None:
    """Write frames as a YOLO dataset.

    Parameters
    ----------
    frames : iterable of ExportFrame
        Read once, one at a time, and written in the same order.
    sink : callable
        Gets ``images/PART/STEM.png``, ``labels/PART/STEM.txt`` (empty for a frame
        without boxes), ``data.yaml`` and ``manifest.json``.
    head : ExportHead
    options : YoloOptions

    Raises
    ------
    ExportError
        A class that is not in the list, or counts that do not add up.

    Notes
    -----
    Lines are ``class cx cy w h`` as shares of the frame's own size, of the rectangle
    clipped to the image. ``data.yaml`` has no ``path``, which would be joined to a
    folder of the user's settings.

    References
    ----------
    .. [1] Ultralytics, "Object detection datasets overview",
       https://docs.ultralytics.com/datasets/detect/
    """
    writer = _YoloWriter(sink, head.classes, options)
    with ExportTally(head) as tally:
        for frame in frames:
            writer.write(frame, tally)
        sink("data.yaml", [_data_yaml(head.classes)])
        sink("manifest.json", tally.manifest("yolo"))


def split_of(key: str, map_name: str | None, share: float) -> str:
    """``train`` or ``val``, from the names alone: adding frames reshuffles nothing.

    Every map is split by a hash of its own, so that each gives about the same share;
    exact shares per map would need all frames at once, and would move frames later.
    """
    name = f"{map_name or ''}\0{key}".encode("utf-8", "surrogatepass")
    place = int.from_bytes(hashlib.sha256(name).digest()[:8], "big") / 2**64
    return "train" if place < share else "val"


class _YoloWriter:
    def __init__(
        self, sink: Sink, classes: Sequence[str], options: YoloOptions
    ) -> None:
        self.sink, self.options = sink, options
        self.number = {name: index for index, name in enumerate(classes)}

    def write(self, frame: ExportFrame, tally: ExportTally) -> None:
        """One label file, and the image if images are copied."""
        part = split_of(frame.key, frame.map, self.options.split)
        stem = f"{part}/{file_stem(frame.key)}"
        tally.frame(frame, part)
        lines = [self._line(frame, box, tally) for box in frame.boxes]
        self.sink(f"labels/{stem}.txt", ["".join(lines).encode()])
        if self.options.images == "none":
            return
        if frame.read_image is None:
            tally.image_missing()
        else:
            suffix = IMAGE_SUFFIX[frame.media_type]
            self.sink(f"images/{stem}{suffix}", [frame.read_image()])

    def _line(self, frame: ExportFrame, box: ExportBox, tally: ExportTally) -> str:
        """The box's line; empty if it is dropped."""
        tally.box(box)
        reason = self._reason_to_drop(box)
        xyxy = self._rectangle(box)
        if reason is None and xyxy is None:
            reason = str(box.decision["reason"])
        if reason is not None or xyxy is None:
            tally.dropped(frame, box, reason or "")
            return ""
        inside = _clipped(xyxy, frame.wh)
        if inside[0] >= inside[2] or inside[1] >= inside[3]:
            tally.dropped(frame, box, "degenerate")
            return ""
        given = box.given_xyxy if box.given_xyxy is not None else xyxy
        tally.written(frame, box, clipped=_clipped(given, frame.wh) != list(given))
        return _yolo_line(self.number[box.class_name], inside, frame.wh)

    def _rectangle(self, box: ExportBox) -> Rectangle | None:
        amodal = self.options.boxes == "amodal"
        return (box.rectangle("amodal_xyxy") if amodal else None) or box.rectangle(
            "xyxy"
        )

    def _reason_to_drop(self, box: ExportBox) -> str | None:
        include = self.options.include
        if include == "all":
            return None
        verdict = box.verdict if include == "effective" else box.decision["verdict"]
        if verdict == "kept":
            return None
        if verdict == "unmeasured" and self.options.include_unmeasured:
            return None
        by_person = include == "effective" and box.is_reviewed
        return "rejected_by_person" if by_person else str(box.decision["reason"])


def _clipped(xyxy: Rectangle, wh: tuple[int, int]) -> list[float]:
    limits = (*wh, *wh)
    return [
        min(max(float(value), 0.0), float(limit))
        for value, limit in zip(xyxy, limits, strict=True)
    ]


def _yolo_line(number: int, xyxy: Rectangle, wh: tuple[int, int]) -> str:
    x_min, y_min, x_max, y_max = xyxy
    width, height = wh
    shares = (
        (x_min + x_max) / 2 / width,
        (y_min + y_max) / 2 / height,
        (x_max - x_min) / width,
        (y_max - y_min) / height,
    )
    return f"{number} {' '.join(f'{share:.{_DECIMALS}f}' for share in shares)}\n"


def _data_yaml(classes: Sequence[str]) -> bytes:
    document = {
        "train": "images/train",
        "val": "images/val",
        "names": dict(enumerate(classes)),
    }
    return yaml.safe_dump(document, sort_keys=False, allow_unicode=True).encode()
