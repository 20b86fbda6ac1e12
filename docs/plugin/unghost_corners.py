"""Corner files: `corners/NAME.txt` with a line `class x1 y1 x2 y2` for each box."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from filter_core.errors import LayoutError
from filter_core.formats.format import Format, Recognition, Source
from filter_core.formats.matching import frame_of, match
from filter_core.formats.reading import (
    FrameSet,
    annotated,
    read_label_text,
    walk,
)
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.streams import Streams

EXAMPLE = Path(__file__).parent / "example"
CORNERS = Format(
    name="corners",
    title="Corner files",
    docs_row="`corners/NAME.txt` for each image: `CORNERS`, then a box per line",
    recognised_by="corners/ with files that begin with CORNERS",
    read_options=frozenset({"segmentation", "files"}),
)


@CORNERS.recogniser
def recognise(source: Source) -> Recognition:
    names = (name for name in source.label_files if name.startswith("corners/"))
    return "certain" if any(has_head(source.path / name) for name in names) else "none"


def has_head(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(7) == b"CORNERS"


@CORNERS.reader
def read(root: Path, options: RecordingDescription) -> FrameSet:
    folder = root / "corners"
    streams = Streams(root, options)
    frames, unmatched = match(walk(folder, (".txt",)), streams.images)
    frames, left_over = streams.complete(frames, "corner file")
    return FrameSet(
        layout="corners",
        frames=lambda: (
            annotated(frame_of(one, root), partial(boxes_of, folder, one.label))
            for one in frames
        ),
        count=len(frames),
        unmatched=(*unmatched, *left_over),
        streams=streams.facts,
        texts=lambda: (folder / one.label for one in frames),
    )


def boxes_of(folder: Path, name: str) -> dict[str, object]:
    head, *lines = read_label_text(folder / name, name).splitlines() or [""]
    if head != "CORNERS":
        raise LayoutError(f"{name}: expected CORNERS in line 1, found {head[:40]!r}")
    boxes = []
    for number, line in enumerate(lines, 2):
        try:
            class_name, *corners = line.split()
            x_min, y_min, x_max, y_max = map(float, corners)
        except ValueError as error:
            raise LayoutError(
                f"{name}, line {number}: expected class x1 y1 x2 y2, found {line[:9]!r}"
            ) from error
        boxes.append({"class": class_name, "xyxy": [x_min, y_min, x_max, y_max]})
    return {"boxes": boxes}
