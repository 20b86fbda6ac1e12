"""A pin of every format's export of a rendered frame: the first of the demo's towns.

It has all actors: 166 boxes of eight classes, of which 75 are kept, where the frames of
`street` are tiny and have a dozen. ``unghost demo`` leaves most of them out.
"""

from typing import Any

from filter_core import FilterConfig
from filter_core.formats.export import ExportFrame, ExportHead, ExportOptions
from filter_core.formats.reading import FrameSet
from filter_core.formats.registry import (
    EXPORT_FORMATS,
    FORMATS,
    read_source,
    write_export,
)
from filter_core.local import class_order, export_sources
from tests.pins.service import digest
from tests.support.demo_street import demo_street


def found() -> dict[str, dict[str, Any]]:
    """The digest of each exported file, by the file's name, by format.

    An image is only compared with the one that was rendered, and has no digest: other
    machines and other versions of numpy may round its light and shadow otherwise.
    """
    folder = demo_street().folder
    street = read_source(folder)
    (image,) = folder.glob("rgb/**/*.png")
    rendered = image.read_bytes()
    return {
        name: {
            file: "the frame's image" if content == rendered else digest(file, content)
            for file, content in _exported(name, street).items()
        }
        for name in EXPORT_FORMATS
    }


def _exported(name: str, street: FrameSet) -> dict[str, bytes]:
    """The files of an export with the filter's default configuration."""
    needs = FORMATS[name].needs
    frames = export_sources(street, FilterConfig(), measure=True, needs=needs)
    decided = [frame for frame in frames if isinstance(frame, ExportFrame)]
    files: dict[str, bytes] = {}
    write_export(
        name,
        decided,
        lambda file, pieces: files.update({file: b"".join(pieces)}),
        ExportHead(class_order(street)),
        ExportOptions(),
    )
    return files
