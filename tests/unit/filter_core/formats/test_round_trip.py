"""Read a folder, filter it, export it, read it again: only the ghosts are missing."""

from __future__ import annotations

import numpy as np

from filter_core.config.filter import FilterConfig
from filter_core.formats.export import ExportHead, ExportOptions
from filter_core.formats.registry import read_source, write_export
from filter_core.geometry.boxes import to_xyxy
from filter_core.local import export_sources
from tests.support.folders import street_tags, write_files
from tests.support.pictures import painted, png

CAR = (10.25, 10.5, 50, 40)
LABELS = "0 0.3765625 0.42083333 0.496875 0.49166667\n1 0.8125 0.79 0.125 0.25\n"


def filtered_frames(source):
    """The frames of a folder after filtering, ready for export."""
    frames = read_source(source)
    return export_sources(frames, FilterConfig(), measure=True)


def test_kept_boxes_round_trip_through_a_yolo_export(tmp_path):
    files: dict[str, object] = {"data.yaml": "names: [car, walker]\n"}
    for key in ("a/1.5", "straße 7"):
        files[f"images/{key}.png"] = None
        files[f"labels/{key}.txt"] = LABELS
        files[f"seg/{key}.png"] = png(painted(street_tags()))
    source = write_files(tmp_path / "in", files)
    out = {}

    def sink(name, pieces):
        out[name] = b"".join(pieces)

    head = ExportHead(("car", "walker"), expected_boxes=4)
    write_export("yolo", filtered_frames(source), sink, head, ExportOptions())
    again = read_source(write_files(tmp_path / "out", out))

    assert again.layout == "yolo"
    assert again.classes == ("car", "walker")
    found = {frame.key: frame for frame in again}
    assert sorted(found) == ["a/1.5", "straße 7"]
    for frame in found.values():
        boxes = (frame.annotation or {})["boxes"]
        assert isinstance(boxes, list)
        (box,) = boxes
        assert box["class"] == "car"
        xyxy = to_xyxy("cxcywhn", [box["cxcywhn"]], (80, 60))
        np.testing.assert_allclose(xyxy, [CAR], atol=1e-5)
