"""The books of an export: every box that went in is accounted for in manifest.json."""

from __future__ import annotations

import json
import tempfile
from collections import Counter
from collections.abc import Iterator
from types import TracebackType
from typing import Final

from filter_core.errors import FilterError
from filter_core.formats.export_frame import ExportBox, ExportFrame, ExportHead

_IN_MEMORY: Final = 4 * 1024 * 1024
"""Bytes of dropped and clipped boxes before they go to a temporary file."""
_PIECE: Final = 64 * 1024


class ExportError(FilterError):
    """An export whose numbers do not add up, or that lacks what it needs."""

    code = "bad_export"


class ExportTally:
    """Counts boxes in and out per class and remembers each that was changed.

    Use as a context manager: what does not fit into memory is in a temporary file.
    """

    def __init__(self, head: ExportHead) -> None:
        self._head = head
        self._classes = head.classes
        self._known = frozenset(head.classes)
        self._count = {fate: Counter[str]() for fate in _FATES}
        self._verdicts: Counter[str] = Counter()
        self._reasons: Counter[str] = Counter()
        self._frames: Counter[str] = Counter()
        self._changed = tempfile.SpooledTemporaryFile(max_size=_IN_MEMORY)  # noqa: SIM115  # closed by __exit__
        self._changes = 0

    def __enter__(self) -> ExportTally:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._changed.close()

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

    def box(self, box: ExportBox) -> None:
        """Note a box that came in.

        Raises
        ------
        ExportError
            Its class is not in the list of classes, whose order is frozen.
        """
        if box.class_name not in self._known:
            raise ExportError(
                f"box {box.id!r}: class {box.class_name!r} is not among the classes of "
                f"the export: {', '.join(self._classes)}"[:300],
                code="unknown_class",
            )
        self._count["in"][box.class_name] += 1
        self._verdicts[box.verdict] += 1

    def written(self, frame: ExportFrame, box: ExportBox, *, clipped: bool) -> None:
        """Note a box that went out, and whether the image's border cut it."""
        self._count["out"][box.class_name] += 1
        if clipped:
            self._change("clipped", frame, box, "beyond_image")

    def dropped(self, frame: ExportFrame, box: ExportBox, reason: str) -> None:
        """Note a box that did not go out, and why."""
        self._reasons[reason] += 1
        self._change("dropped", frame, box, reason)

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
        self._changed.write((",\n" if self._changes else "\n").encode() + _json(row))
        self._changes += 1

    def counts(self) -> dict[str, object]:
        """All counts, after checking that nothing was lost on the way.

        Raises
        ------
        ExportError
            Boxes in are not boxes out plus boxes dropped, or not as many as expected.
        """
        self._refuse_mismatch()
        per_class = {
            name: {fate: self._count[fate][name] for fate in _FATES}
            for name in self._classes
        }
        boxes = {fate: sum(self._count[fate].values()) for fate in _FATES}
        return {
            "frames": dict(sorted(self._frames.items())),
            "boxes": boxes,
            "classes": per_class,
            "verdicts": dict(sorted(self._verdicts.items())),
            "dropped_by_reason": dict(sorted(self._reasons.items())),
        }

    def _refuse_mismatch(self) -> None:
        expected_boxes = self._head.expected_boxes
        total = self._count["in"].total()
        if expected_boxes is not None and total != expected_boxes:
            raise ExportError(
                f"expected {expected_boxes} boxes, found {total}", code="count_mismatch"
            )
        for name in self._classes:
            came, went, fell = (self._count[f][name] for f in ("in", "out", "dropped"))
            if came != went + fell:
                raise ExportError(
                    f"class {name!r}: {came} boxes in, but {went} out and {fell} "
                    "dropped",
                    code="count_mismatch",
                )

    def manifest(self, name: str) -> Iterator[bytes]:
        """``manifest.json`` in pieces: the head, the counts, every changed box.

        `name` is the export's format. Raises as `counts`.
        """
        body = {
            "format": name,
            **self._head.facts,
            "class_names": list(self._classes),
            "counts": self.counts(),
        }
        text = json.dumps(body, ensure_ascii=False, indent=1, allow_nan=False)
        yield f'{text[:-2]},\n "boxes": ['.encode()
        self._changed.seek(0)
        while piece := self._changed.read(_PIECE):
            yield piece
        yield b"\n ]\n}\n"


_FATES: Final = ("in", "out", "dropped", "clipped")


def _json(value: object) -> bytes:
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return text.encode()
