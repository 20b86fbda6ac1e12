"""YOLO as Ultralytics reads it: images, labels, data.yaml, and the books."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Final

import yaml

from filter_core.formats.export_boxes import OutBox, Traits
from filter_core.formats.writing import PARTS, Desk, OutFrame

_DECIMALS: Final = 8
"""Finer than a thousandth of a pixel in the largest image."""

_HALF_UNITS: Final = 10**_DECIMALS // 2
"""Edges lie on every second unit of the last digit: centres are whole units then."""


class YoloWriter:
    """Writes ``images/PART/STEM.png``, ``labels/PART/STEM.txt`` and ``data.yaml``.

    A frame without boxes has an empty label file. Distance bands are folders like
    ``labels``: ``label50/PART/STEM.txt``.

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

    traits: ClassVar[Traits] = Traits("yolo", keys=True, flat=True)

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._parts: set[str] = set()

    def image(self, out: OutFrame) -> str:
        """The name of a frame's image in the export."""
        return f"images/{out.part}/{out.stem}{out.suffix}"

    def labels(self, band: str, out: OutFrame) -> None:
        """One label file."""
        self._parts.add(out.part)
        lines = "".join(_line(one, out.frame.wh) for one in out.boxes)
        folder = band or "labels"
        self._desk.sink(f"{folder}/{out.part}/{out.stem}.txt", [lines.encode()])

    def finish(self) -> None:
        """The list of classes and where the images are."""
        text = _data_yaml(self._desk.head.classes, self._parts)
        self._desk.sink("data.yaml", [text])


def _line(out: OutBox, wh: tuple[int, int]) -> str:
    x_min, y_min, x_max, y_max = out.xyxy
    columns = zip(_share(x_min, x_max, wh[0]), _share(y_min, y_max, wh[1]), strict=True)
    shares = [share for column in columns for share in column]
    return f"{out.number} {' '.join(f'{share:.{_DECIMALS}f}' for share in shares)}\n"


def _share(low: float, high: float, side: int) -> tuple[float, float]:
    """Centre and extent as shares of a side, so rounded that both edges are exact.

    Rounded by themselves, a centre and an extent can reach beyond the image by their
    last digit, and whoever reads, clips and writes them again would get other digits.
    """
    first, last = (round(edge / side * _HALF_UNITS) for edge in (low, high))
    return (first + last) / 2 / _HALF_UNITS, (last - first) / _HALF_UNITS


def _data_yaml(classes: Sequence[str], parts: set[str]) -> bytes:
    # A part without a frame would be a folder that is not there, and no training.
    only = next(iter(parts)) if len(parts) == 1 else None
    document = {
        **{part: f"images/{only or part}" for part in PARTS},
        "names": dict(enumerate(classes)),
    }
    return yaml.safe_dump(document, sort_keys=False, allow_unicode=True).encode()
