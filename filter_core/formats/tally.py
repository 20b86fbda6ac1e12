"""The books of an export: every box that went in is accounted for in manifest.json."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from types import TracebackType
from typing import Any, Final, TypeAlias

from filter_core.formats.export import ExportBox, ExportError, ExportFrame, ExportHead
from filter_core.formats.files import Spool

Counts: TypeAlias = dict[str, Any]
"""Frames and boxes in and out, as ``manifest.json`` has them."""

_FATES: Final = ("in", "out", "dontcare", "dropped", "clipped")

_MARKS: Final = ("kept", "rejected", "unmeasured", "unsure", "lossy")


class ExportTally:
    """Counts boxes in and out per class and remembers each that was changed.

    Use as a context manager: what does not fit into memory is in temporary files.
    """

    def __init__(self, head: ExportHead) -> None:
        self._head = head
        self._classes = head.classes
        self._known = frozenset(head.classes)
        self._count = {name: Counter[str]() for name in (*_FATES, *_MARKS)}
        self._reasons: Counter[str] = Counter()
        self._frames: Counter[str] = Counter()
        self._rectangles: Counter[str] = Counter()
        self._bands: Counter[str] = Counter()
        self._changed = Spool(head.temporary)
        self._renamed = Spool(head.temporary)

    def __enter__(self) -> ExportTally:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._changed.__exit__(kind, error, trace)
        self._renamed.__exit__(kind, error, trace)

    def frame(self, frame: ExportFrame, part: str = "") -> None:
        """Note a frame, and the part of a split that it went to."""
        self._frames["in"] += 1
        if part:
            self._frames[part] += 1
        if not frame.boxes:
            self._frames["without_boxes"] += 1

    def image_missing(self) -> None:
        """Note a frame whose image was to be copied and is not there."""
        self._frames["without_image"] += 1

    def renamed(self, key: str, file: str) -> None:
        """Note a frame whose files could not be named as it is."""
        self._renamed.add({"frame": key, "file": file})

    def box(self, box: ExportBox) -> None:
        """Note a box that came in.

        Raises
        ------
        ExportError
            Its class is not in the list of classes, whose order is frozen.
        """
        name = box.class_name
        if name not in self._known:
            raise ExportError(
                f"box {box.id!r}: class {name!r} is not among the classes of the "
                f"export: {', '.join(self._classes)}"[:300],
                code="unknown_class",
            )
        self._count["in"][name] += 1
        self._count[box.verdict][name] += 1
        for mark in ("unsure", "lossy"):
            self._count[mark][name] += bool(getattr(box, f"is_{mark}"))

    def written(
        self, frame: ExportFrame, box: ExportBox, *, clipped: bool, rectangle: str = ""
    ) -> None:
        """Note a box that went out, and whether the image's border cut it.

        `rectangle` says which of the box's rectangles it was.
        """
        self._count["out"][box.class_name] += 1
        self._rectangles[rectangle] += bool(rectangle)
        if clipped:
            self._change("clipped", frame, box, "beyond_image")

    def dont_care(self, frame: ExportFrame, box: ExportBox, reason: str) -> None:
        """Note a box that went out as a region to be ignored, and why."""
        self._reasons[reason] += 1
        self._change("dontcare", frame, box, reason)

    def dropped(self, frame: ExportFrame, box: ExportBox, reason: str) -> None:
        """Note a box that did not go out, and why."""
        self._reasons[reason] += 1
        self._change("dropped", frame, box, reason)

    def banded(self, band: str, boxes: int) -> None:
        """Note how many boxes of a frame are in a distance band."""
        self._bands[band] += boxes

    def _change(
        self, fate: str, frame: ExportFrame, box: ExportBox, reason: str
    ) -> None:
        self._count[fate][box.class_name] += 1
        row = {
            "frame": frame.key,
            "box": box.id,
            "class": box.class_name,
            "fate": fate,
            "reason": reason,
        }
        self._changed.add(row)

    def counts(self) -> Counts:
        """All counts, after checking that nothing was lost on the way.

        Raises
        ------
        ExportError
            Boxes in are not boxes out plus boxes dropped, or not as many as expected.
        """
        self._refuse_mismatch()
        per_class = {
            name: {what: self._count[what][name] for what in self._count}
            for name in self._classes
        }
        counts: Counts = {
            "frames": dict(sorted(self._frames.items())),
            "boxes": {what: count.total() for what, count in self._count.items()},
            "classes": per_class,
            "not_kept_by_reason": dict(sorted(self._reasons.items())),
        }
        more = {"rectangles": self._rectangles, "bands": self._bands}
        used = {name: dict(count) for name, count in more.items() if count.total()}
        return {**counts, **used}

    def _refuse_mismatch(self) -> None:
        expected_boxes = self._head.expected_boxes
        total = self._count["in"].total()
        if expected_boxes is not None and total != expected_boxes:
            raise ExportError(
                f"expected {expected_boxes} boxes, found {total}", code="count_mismatch"
            )
        for name in self._classes:
            came, *fates = (self._count[fate][name] for fate in _FATES[:4])
            if came != sum(fates):
                raise ExportError(
                    f"class {name!r}: {came} boxes in, but {fates[0]} out, {fates[1]} "
                    f"to be ignored and {fates[2]} dropped",
                    code="count_mismatch",
                )

    def manifest(
        self, name: str, more: Mapping[str, object] | None = None
    ) -> Iterator[bytes]:
        """``manifest.json`` in pieces: the head, the counts, every changed box.

        `name` is the export's format, `more` what that format has to say. Raises as
        `counts`.
        """
        body = {
            "format": name,
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
