"""A program that measures how much memory exports take for each further frame.

`python -m tests.support.memory_of_exports FOLDER` writes one JSON object: for each
export format, the bytes by which its peak grows per frame. It is a process of its own
so that only the export is measured.
"""

import gc
import json
import sys
import tracemalloc
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from filter_core.formats.export import ExportFrame, ExportOptions
from filter_core.formats.registry import EXPORT_FORMATS, FORMATS, write_export
from tests.support.exporting import HEAD, sample_frames

FEW, MANY = 20, 60


def growth(name: str, temporary: Path) -> float:
    """The bytes by which the peak grows with each frame of ten boxes."""
    few, many = (peak(name, temporary, count) for count in (FEW, MANY))
    return (many - few) / (MANY - FEW)


def peak(name: str, temporary: Path, count: int) -> int:
    """The most bytes that an export of `count` frames holds at a time."""
    # Small buffers are soon full; what still grows after that grows with each frame.
    head = replace(HEAD, temporary=temporary, buffer_bytes=4096, group_rows=100)
    chosen = {"images": "none"} if "images" in FORMATS[name].options else {}
    options = ExportOptions.from_mapping(chosen)
    tracemalloc.start()
    write_export(name, without_garbage(sample_frames(count)), swallow, head, options)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return most


def without_garbage(frames: Iterable[ExportFrame]) -> Iterator[ExportFrame]:
    """Yield the frames; garbage is collected before each of them."""
    for frame in frames:
        gc.collect()
        yield frame


def swallow(_file: str, pieces: Iterable[bytes]) -> None:
    """A sink that reads all pieces and keeps none."""
    for _ in pieces:
        pass


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    for each in EXPORT_FORMATS:
        peak(each, folder, 1)  # make what is made only once
    # Keep the collector from looking at all imported objects for every frame.
    gc.freeze()
    print(json.dumps({each: growth(each, folder) for each in EXPORT_FORMATS}))
