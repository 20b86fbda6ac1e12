"""The counts of an export: manifest.json accounts for every box of the dataset."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np

from filter_core.arrays import IntArray
from filter_core.formats.export import ExportError, ExportFrame, ExportHead
from filter_core.formats.files import Spool
from filter_core.verdicts import VERDICTS, Answer

Counts: TypeAlias = dict[str, dict[str, int] | dict[str, dict[str, int]]]
"""Frames and boxes in and out, as ``manifest.json`` has them."""

_FATES: Final = ("in", "out", "dontcare", "dropped", "clipped")

_MARKS: Final = (*(verdict.value for verdict in VERDICTS), "unsure", "lossy")


class Change(NamedTuple):
    """The outcome of a box that was not written unchanged.

    Attributes
    ----------
    row : int
        Its place in the frame.
    fate : str
        ``dontcare``: written as a region to be ignored; ``dropped``: not written;
        ``clipped``: written without what lies beyond the image.
    reason : str
        Why, such as the label of a `Reason`.
    """

    row: int
    fate: Literal["dontcare", "dropped", "clipped"]
    reason: str


class ExportTally:
    """Counts boxes in and out per class and remembers each that was changed.

    Use as a context manager: what does not fit into memory is in temporary files.
    """

    def __init__(self, head: ExportHead) -> None:
        self._head = head
        self._classes = head.classes
        self._number = {name: number for number, name in enumerate(head.classes)}
        count = len(head.classes)
        self._count = {name: np.zeros(count, np.int64) for name in (*_FATES, *_MARKS)}
        self._reasons: Counter[str] = Counter()
        self._frames: Counter[str] = Counter()
        self._rectangles: Counter[str] = Counter()
        self._bands: Counter[str] = Counter()
        self._unmeasured: Counter[str] = Counter()
        self._split: Counter[str] = Counter()
        self._sequences: Counter[str] = Counter()
        self._changed = Spool(head.temporary, head.buffer_bytes)
        self._renamed = Spool(head.temporary, head.buffer_bytes)

    def __enter__(self) -> ExportTally:
        return self

    def __exit__(self, *error: object) -> None:
        self._changed.__exit__(*error)
        self._renamed.__exit__(*error)

    def frame(self, frame: ExportFrame, part: str = "") -> None:
        """Note a frame, and the part of a split that it went to."""
        self._frames["in"] += 1
        if part:
            self._frames[part] += 1
        if not len(frame.boxes):
            self._frames["without_boxes"] += 1

    def split(
        self, told: Mapping[str, int], sequences: Mapping[str, Collection[str]]
    ) -> None:
        """Note the frames by what told their parts, and the sequences of each part."""
        self._split.update(told)
        self._sequences.update({part: len(some) for part, some in sequences.items()})

    def left_out(self, frame: ExportFrame, unmeasured: int) -> None:
        """Note a frame that is left out because of so many unmeasured boxes."""
        self.frame(frame)
        self._unmeasured["frames_left_out"] += 1
        self._unmeasured["left_out"] += unmeasured

    def unmeasured_written(self, boxes: int) -> None:
        """Count boxes that were written although they could not be measured."""
        if boxes:
            self._unmeasured["written"] += boxes

    def image_missing(self, *, left_out: bool = False) -> None:
        """Count a frame whose image is missing although images are copied."""
        self._frames["without_image"] += 1
        if left_out:
            self._frames["left_out"] += 1

    def renamed(self, key: str, file: str) -> None:
        """List a frame whose files have another name than its key."""
        self._renamed.add({"frame": key, "file": file})

    def count_boxes(self, frame: ExportFrame) -> IntArray:
        """Count the boxes of a frame. Returns (N,): the number of each box's class.

        Raises `ExportError`: a class is not in the list of classes, whose order is
        frozen.
        """
        boxes = frame.boxes
        places = [self._number.get(name, -1) for name in boxes.class_names]
        number = np.array(places, np.int64)[boxes.class_index]
        if (number < 0).any():
            row = int(np.argmin(number))
            raise ExportError(
                f"box {boxes.ids[row]!r}: class {boxes.class_name(row)!r} is not among "
                f"the classes of the export: {', '.join(self._classes)}"[:300],
                code="unknown_class",
            )
        self._add("in", number)
        verdict = boxes.effective
        for code, name in enumerate(VERDICTS):
            self._add(name.value, number[verdict == code])
        self._add("unsure", number[boxes.answer == Answer.UNSURE])
        self._add("lossy", number[boxes.lossy])
        return number

    def _add(self, name: str, number: IntArray) -> None:
        self._count[name] += np.bincount(number, minlength=len(self._classes))

    def written(self, number: IntArray, rectangles: Sequence[str] = ()) -> None:
        """Count boxes that were written, by the numbers of their classes.

        `rectangles` names the rectangle that was written for each box, if any.
        """
        self._add("out", number)
        for name, boxes in Counter(rectangles).items():
            self._rectangles[name] += boxes if name else 0

    def changed(
        self, frame: ExportFrame, number: Sequence[int], changes: Sequence[Change]
    ) -> None:
        """Count changed boxes of a frame, by the numbers of their classes."""
        ids = frame.boxes.ids
        for place, (row, fate, reason) in zip(number, changes, strict=True):
            self._count[fate][place] += 1
            if fate != "clipped":
                self._reasons[reason] += 1
            self._changed.add(
                {
                    "frame": frame.key,
                    "box": ids[row],
                    "class": self._classes[place],
                    "fate": fate,
                    "reason": reason,
                }
            )

    def banded(self, band: str, boxes: int) -> None:
        """Count the boxes of a frame in a distance band."""
        self._bands[band] += boxes

    def counts(self) -> Counts:
        """All counts, after checking that nothing was lost on the way.

        Raises `ExportError`: boxes in are not boxes out plus boxes dropped, or not as
        many as expected.
        """
        expected_boxes = self._head.expected_boxes
        total = int(self._count["in"].sum())
        if expected_boxes is not None and total != expected_boxes:
            raise ExportError(
                f"expected {expected_boxes} boxes, found {total}", code="count_mismatch"
            )
        for place, name in enumerate(self._classes):
            came, *fates = (int(self._count[fate][place]) for fate in _FATES[:4])
            if came != sum(fates):
                raise ExportError(
                    f"class {name!r}: {came} boxes in, but {fates[0]} out, {fates[1]} "
                    f"to be ignored and {fates[2]} dropped",
                    code="count_mismatch",
                )
        per_class = {
            name: {what: int(count[place]) for what, count in self._count.items()}
            for place, name in enumerate(self._classes)
        }
        counts: Counts = {
            "frames": dict(sorted(self._frames.items())),
            "boxes": {what: int(count.sum()) for what, count in self._count.items()},
            "classes": per_class,
            "not_kept_by_reason": dict(sorted(self._reasons.items())),
        }
        more = {
            "rectangles": self._rectangles,
            "bands": self._bands,
            "unmeasured": self._unmeasured,
            "split": self._split,
            "sequences": self._sequences,
        }
        used = {name: dict(count) for name, count in more.items() if count.total()}
        return {**counts, **used}

    def manifest(self, more: Mapping[str, object] | None = None) -> Iterator[bytes]:
        """``manifest.json`` in pieces: the head, the counts, every changed box.

        `more` has the format's own keys. Raises as `counts`.
        """
        body = {
            "format": self._head.format,
            **self._head.facts,
            "class_names": list(self._classes),
            **(more or {}),
            "counts": self.counts(),
        }
        text = json.dumps(body, ensure_ascii=False, indent=1, allow_nan=False)
        yield text[:-2].encode("utf-8", "backslashreplace")
        for key, spool in (("renamed", self._renamed), ("boxes", self._changed)):
            yield f',\n "{key}": ['.encode()
            yield from spool.pieces()
            yield b"\n ]"
        yield b"\n}\n"
