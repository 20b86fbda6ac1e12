"""How much memory an export takes for each frame, measured in a process of its own.

`python -m tests.support.memory_of_exports FOLDER` writes one JSON object: for each
export format, how many bytes more its peak is for each further frame. Nothing else runs
in this process, so that nothing else is counted.
"""

from __future__ import annotations

import gc
import json
import sys
import tracemalloc
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from filter_core.formats.export import ExportFrame, ExportOptions
from filter_core.formats.registry import EXPORT_FORMATS, FORMATS, write_export
from tests.support.exporting import HEAD, street

FEW, MANY = 30, 110


def growth(name: str, temporary: Path) -> float:
    """Bytes that the peak grows by with each frame of ten boxes."""
    few, many = (peak(name, temporary, count) for count in (FEW, MANY))
    return (many - few) / (MANY - FEW)


def peak(name: str, temporary: Path, count: int) -> int:
    """The most bytes that were held at a time, by an export of so many frames."""
    # Small buffers, so that few boxes fill them; what is left is what would grow.
    head = replace(HEAD, temporary=temporary, buffer_bytes=4096, group_rows=100)
    chosen = {"images": "none"} if "images" in FORMATS[name].options else {}
    options = ExportOptions.from_mapping(chosen)
    tracemalloc.start()
    write_export(name, without_garbage(street(count)), swallow, head, options)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return most


def without_garbage(frames: Iterable[ExportFrame]) -> Iterator[ExportFrame]:
    """Frames, each after Python has freed what was left of the one before."""
    for one in frames:
        gc.collect()
        yield one


def swallow(_file: str, pieces: Iterable[bytes]) -> None:
    """A sink that keeps nothing."""
    for _ in pieces:
        pass


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    for each in EXPORT_FORMATS:
        peak(each, folder, 1)  # what is made once
    # What is imported by now is not looked at for every frame.
    gc.freeze()
    print(json.dumps({each: growth(each, folder) for each in EXPORT_FORMATS}))
