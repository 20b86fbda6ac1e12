"""Makes small frames, runs exports and conversions, and collects their files."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from filter_core.annotation.frame import GEOMETRIES
from filter_core.arrays import NOT_MEASURED
from filter_core.config.filter import FilterConfig
from filter_core.formats.export import (
    ExportFrame,
    ExportHead,
    ExportOptions,
    GivenAnnotation,
)
from filter_core.formats.registry import FORMATS, read_source, write_export
from filter_core.local import LeftOut, class_order, export_sources
from filter_core.verdicts import Answer, DecidedBoxes, DecisionColumns, Reason
from tests.support.folders import write_files
from tests.support.pictures import png

CLASSES = ("car", "traffic light", "walker")
WH = (100, 80)
OUTSIDE = (-2, -2, -1, -1)
REASONS = {
    "kept": Reason.VISIBLE,
    "rejected": Reason.BELOW_THRESHOLD,
    "unmeasured": Reason.NO_SEGMENTATION,
}
HEAD = ExportHead(CLASSES, {"dataset": "d", "config": "0" * 64})


@dataclass(frozen=True)
class MadeBox:
    """A box for `frame`: its decision, and its annotation as it was sent."""

    decision: dict[str, Any]
    given: dict[str, Any]


def box(number, xyxy=(10, 20, 30, 60), verdict="kept", class_name="car", **more):
    """A box with its decision; `given` holds further keys of its annotation."""
    given = more.pop("given", {})
    if not given.keys() & GEOMETRIES:
        given = {"xyxy": list(xyxy or OUTSIDE), **given}
    decision = {
        "id": str(number),
        "class": class_name,
        "verdict": verdict,
        "reason": REASONS[verdict].label,
        "xyxy": None if xyxy is None else list(xyxy),
        "distance": None,
        **more,
    }
    return MadeBox(decision, {"class": class_name, **given})


@lru_cache
def black(wh):
    """A black PNG of this width and height."""
    return png(np.zeros((wh[1], wh[0], 3), np.uint8))


def frame(key, *boxes, wh=WH, annotation=None, **more):
    """A frame with a black image; `annotation` holds its keys besides the boxes."""
    image = black(wh)
    whole = {**(annotation or {}), "boxes": [box.given for box in boxes]}
    return ExportFrame(
        key=key,
        wh=wh,
        boxes=columns([box.decision for box in boxes]),
        given=GivenAnnotation(lambda: whole, wh),
        decisions=[box.decision for box in boxes],
        **{
            "read_image": lambda: image,
            "columns": table_columns([box.decision for box in boxes]),
            **more,
        },
    )


def sample_frames(count, boxes=10, **more):
    """Frames with kept and rejected boxes, some of which reach out of the image."""
    for number in range(count):
        made = [
            box(
                each,
                (each, 5, each + 20, 130 if each % 3 else 50),
                "rejected" if each % 4 == 0 else "kept",
                distance=each * 11.0,
            )
            for each in range(boxes)
        ]
        yield frame(f"town/{number:06}", *made, map=f"Town{number % 3}", **more)


def column(decisions, name, dtype=np.float64, absent=np.nan):
    """One value of each decision, as an array."""
    values = (row.get(name) for row in decisions)
    return np.array([absent if each is None else each for each in values], dtype)


def reason_of(decision):
    """The reason of a decision; where several share a name, that of its verdict."""
    return next(
        reason
        for reason in Reason.with_label(decision["reason"])
        if reason.verdict.value == decision["verdict"]
    )


def columns(decisions):
    """Turn decisions (dicts) into the columns that label formats are written from."""
    names = tuple({row["class"]: None for row in decisions})

    def rectangles(name):
        return column(decisions, name, absent=(np.nan,) * 4).reshape(-1, 4)

    said = [(row.get("review") or {}).get("verdict", "none") for row in decisions]
    return DecidedBoxes(
        ids=[row["id"] for row in decisions],
        class_names=names,
        class_index=np.array([names.index(row["class"]) for row in decisions], int),
        reason=np.array([reason_of(row) for row in decisions], "u1"),
        answer=np.array([Answer[each.upper()] for each in said], np.uint8),
        lossy=column(decisions, "lossy", bool, absent=False),
        xyxy=rectangles("xyxy"),
        amodal_xyxy=rectangles("amodal_xyxy"),
        visible_xyxy=rectangles("visible_xyxy"),
        tight_xyxy=rectangles("tight_xyxy"),
        distance=column(decisions, "distance"),
        distance_range=column(
            decisions, "distance_range", absent=(np.nan,) * 2
        ).reshape(-1, 2),
        match_percent=column(decisions, "match_percent"),
        occlusion=column(decisions, "occluded", np.int64, absent=3),
    )


def table_columns(decisions):
    """Turn decisions into the further columns that only tables of decisions need."""
    numbers = ("threshold", "margin", "area_percent", "crowding")
    reviews = [row.get("review") or {} for row in decisions]
    return DecisionColumns(
        **{name: column(decisions, name) for name in numbers},
        toss_up=column(decisions, "toss_up", bool, absent=False),
        large=column(decisions, "large", bool, absent=False),
        matched_pixels=column(decisions, "matched_pixels", np.int64, NOT_MEASURED),
        box_pixels=column(decisions, "box_pixels", np.int64, absent=0),
        unknown_pixels=column(decisions, "unknown_pixels", np.int64, absent=0),
        explained_by=[row.get("explained_by") for row in decisions],
        hidden_by=[row.get("hidden_by", []) for row in decisions],
        reviewer=[review.get("reviewer") for review in reviews],
        comment=[review.get("comment") for review in reviews],
        config="0" * 64,
    )


def export(name, frames, head=HEAD, **options):
    """Run an export; returns its files by name, each of which must be written once."""
    files = {}

    def sink(file, pieces):
        assert file not in files
        files[file] = b"".join(pieces)

    chosen = ExportOptions.from_mapping(options)
    write_export(name, iter(frames), sink, head, chosen)
    return files


def convert(name, folder, layout="auto", **options):
    """Convert a folder of labels into files of a format, with every box included."""
    source = read_source(folder, layout)
    needs = FORMATS[name].needs
    made = list(export_sources(source, FilterConfig(), needs=needs))
    problems = [frame for frame in made if isinstance(frame, LeftOut)]
    assert not problems, problems[0].problem
    head = ExportHead(source.classes or class_order(source))
    if "include" in FORMATS[name].options:
        options = {"include": "all", **options}
    return export(name, made, head, **options)


def write_exported_files(folder, files):
    """Write the files of an export into a folder."""
    return write_files(folder, files)


def labels_of(files):
    """All files but manifest.json, which also says where the boxes came from."""
    return {name: content for name, content in files.items() if name != "manifest.json"}
