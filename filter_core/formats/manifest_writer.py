"""The product's own format: every annotation as it came, without what is rejected."""

from __future__ import annotations

from typing import ClassVar, Final

from filter_core.formats.export_boxes import Traits
from filter_core.formats.manifest import FILES, MANIFEST_NAME
from filter_core.formats.spool import json_bytes
from filter_core.formats.writing import Desk, OutFrame

_OURS: Final = frozenset({"boxes", "key", *FILES})


class ManifestWriter:
    """Writes ``manifest.jsonl`` and ``images/STEM.png``.

    A box that goes out is the box that came in: its geometry in whatever form, 3D
    boxes, cameras and every key that nobody here knows. Nothing is clipped.
    """

    traits: ClassVar[Traits] = Traits("manifest", crowds=True, unplaced=True)

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._lines = desk.spool()

    def image(self, out: OutFrame) -> str:
        """The name of a frame's image in the export."""
        return f"images/{out.stem}{out.suffix}"

    def labels(self, band: str, out: OutFrame) -> None:
        """One line."""
        frame = out.frame
        copied = self._desk.options.images == "copy" and frame.read_image is not None
        known = {key: v for key, v in frame.annotation.items() if key not in _OURS}
        # Without an id its place was its id, and places move when a box goes.
        boxes = [{"id": one.box.id, **one.box.given} for one in out.boxes]
        line = {
            "key": frame.key,
            **({"image": self.image(out)} if copied else {}),
            **known,
            "boxes": boxes,
        }
        self._lines.write(json_bytes(line, by_key=True) + b"\n")

    def finish(self) -> None:
        """The manifest, now that it is complete."""
        self._desk.sink(MANIFEST_NAME, self._lines.pieces())
