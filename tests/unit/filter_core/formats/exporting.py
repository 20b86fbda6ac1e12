"""Small exports: boxes and frames as a server hands them out, files as they come."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from filter_core.config.filter import FilterConfig
from filter_core.formats.export import ExportBox, ExportFrame, ExportHead, ExportOptions
from filter_core.formats.registry import FORMATS, read_source, write_export
from filter_core.local import LeftOut, class_order, export_sources
from tests.unit.filter_core.formats.folders import png, write_files

CLASSES = ("car", "traffic light", "walker")
WH = (100, 80)
HEAD = ExportHead(CLASSES, {"dataset": "d", "config": "0" * 64})


def box(number, xyxy=(10, 20, 30, 60), verdict="kept", class_name="car", **more):
    """A box with its decision; `given` is its annotation."""
    given = more.pop("given", {})
    vertices = more.pop("vertices", None)
    decision = {
        "id": str(number),
        "class": class_name,
        "verdict": verdict,
        "reason": "visible" if verdict == "kept" else "below_threshold",
        "xyxy": None if xyxy is None else list(xyxy),
        "distance": None,
        **more,
    }
    annotation = {"class": class_name, "xyxy": xyxy and list(xyxy), **given}
    return ExportBox(decision, given=annotation, vertices=vertices)


@lru_cache
def black(wh):
    """A black image."""
    return png(np.zeros((wh[1], wh[0], 3), np.uint8))


def frame(key, *boxes, wh=WH, **more):
    """A frame with a black image."""
    image = black(wh)
    return ExportFrame(key, wh, boxes, **{"read_image": lambda: image, **more})


def export(name, frames, head=HEAD, **options):
    """The files of an export by name, each written once and after the other."""
    files = {}

    def sink(file, pieces):
        assert file not in files
        files[file] = b"".join(pieces)

    chosen = ExportOptions.from_mapping(options)
    write_export(name, iter(frames), sink, head, chosen)
    return files


def convert(name, folder, layout="auto", **options):
    """A folder into files of a format, every box taken over."""
    found = read_source(folder, layout)
    made = list(export_sources(found, FilterConfig(), workers=1))
    problems = [one for one in made if isinstance(one, LeftOut)]
    assert not problems, problems[0].problem
    head = ExportHead(found.classes or class_order(found))
    if "include" in FORMATS[name].options:
        options = {"include": "all", **options}
    return export(name, made, head, **options)


def unpacked(folder, files):
    """The files in a folder."""
    return write_files(folder, files)


def labels_of(files):
    """All but the books, which tell where the boxes came from."""
    return {name: one for name, one in files.items() if name != "manifest.json"}
