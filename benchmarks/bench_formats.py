"""How long does each export format take per box, and how much memory does it need?

    python -m benchmarks.bench_formats [--json]

Each format is written twice, with 30,000 boxes and with ten times as many, each in a
process of its own. What is written is discarded, so that the disk is not measured.
"""

from __future__ import annotations

import json
import time
from argparse import SUPPRESS
from collections.abc import Collection, Iterable, Iterator
from functools import partial

import numpy as np

from benchmarks.measuring import (
    AIM_MEMORY_RATIO,
    in_a_process,
    parser_of,
    peak_mib,
    show,
)
from filter_core.formats.export import (
    ExportFrame,
    ExportHead,
    ExportOptions,
    GivenAnnotation,
)
from filter_core.formats.format import Need
from filter_core.formats.registry import EXPORT_FORMATS, FORMATS, write_export
from filter_core.verdicts import DecidedBoxes, DecisionColumns, Reason

FEW, MANY = 1_000, 10_000
BOXES = 30
WH = (1280, 720)
CLASSES = ("car", "van", "walker")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--format", help=SUPPRESS)
    parser.add_argument("--frames", type=int, help=SUPPRESS)
    options = parser.parse_args()
    if options.frames:
        print(json.dumps(written(options.format, options.frames)))
        return
    figures = {}
    for name in EXPORT_FORMATS:
        few, many = (
            in_a_process("benchmarks.bench_formats", "--format", name, "--frames", n)
            for n in (FEW, MANY)
        )
        figures[f"{name}, us per box"] = many["us_per_box"]
        figures[f"{name}, peak of 300,000 boxes, MiB"] = many["peak_mib"]
        figures[f"{name}, peak against a tenth of them: measured"] = (
            many["peak_mib"] / few["peak_mib"]
        )
    figures["the same for each format: aim, at most"] = AIM_MEMORY_RATIO
    show(figures, as_json=options.json)


def written(name: str, frames: int) -> dict[str, float]:
    """Write an export and discard it; the figures of this process."""
    images = {"images": "none"} if "images" in FORMATS[name].options else {}
    head = ExportHead(CLASSES, expected_boxes=frames * BOXES)
    options = ExportOptions.from_mapping(images)
    started = time.process_time()
    write_export(name, street(frames, FORMATS[name].needs), discard, head, options)
    spent = time.process_time() - started
    return {"us_per_box": spent * 1e6 / (frames * BOXES), "peak_mib": peak_mib()}


def discard(_file: str, pieces: Iterable[bytes]) -> None:
    for _ in pieces:
        pass


def street(frames: int, needs: Collection[Need]) -> Iterator[ExportFrame]:
    """Frames with a third of the boxes rejected, so that lists of them grow, too."""
    for number in range(frames):
        boxes = boxes_of(number)
        given = {"boxes": [{"xyxy": each} for each in boxes.xyxy.tolist()]}
        yield ExportFrame(
            key=f"town/{number:06}",
            wh=WH,
            boxes=boxes,
            given=GivenAnnotation(partial(dict, given), WH),
            map="Town10HD",
            decisions=decisions_of(boxes) if "decisions" in needs else (),
            columns=columns_of(boxes) if "decision_columns" in needs else None,
        )


def boxes_of(frame: int) -> DecidedBoxes:
    number = np.arange(BOXES)
    low = np.stack([(frame * 7 + number * 31) % 1200, (number * 53) % 600], axis=1)
    rejected = number % 3 == 0
    absent = np.full((BOXES, 4), np.nan)
    return DecidedBoxes(
        ids=[str(each) for each in number.tolist()],
        class_names=CLASSES,
        class_index=(number % len(CLASSES)).astype(np.int32),
        reason=np.where(rejected, Reason.BELOW_THRESHOLD, Reason.VISIBLE).astype("u1"),
        answer=np.zeros(BOXES, np.uint8),
        lossy=np.zeros(BOXES, np.bool_),
        xyxy=np.hstack([low, low + np.array((64.5, 120.25))]),
        amodal_xyxy=absent,
        visible_xyxy=absent,
        tight_xyxy=absent,
        distance=4.0 * np.arange(BOXES, dtype=np.float64),
        distance_range=np.full((BOXES, 2), np.nan),
        match_percent=np.full(BOXES, 50.0),
        occlusion=np.full(BOXES, 3),
    )


def decisions_of(boxes: DecidedBoxes) -> list[dict[str, object]]:
    return [
        {
            "id": box_id,
            "class": boxes.class_name(row),
            "verdict": boxes.effective_verdict(row),
            "reason": boxes.reason_label(row),
            "match_percent": 50.0,
            "distance": row * 4.0,
            "xyxy": boxes.xyxy[row].tolist(),
        }
        for row, box_id in enumerate(boxes.ids)
    ]


def columns_of(boxes: DecidedBoxes) -> DecisionColumns:
    numbers, absent = np.full(BOXES, 50.0), [None] * BOXES
    return DecisionColumns(
        threshold=numbers,
        margin=numbers,
        toss_up=boxes.lossy,
        large=boxes.lossy,
        matched_pixels=np.arange(BOXES),
        box_pixels=np.arange(BOXES),
        unknown_pixels=np.arange(BOXES),
        area_percent=numbers,
        crowding=numbers,
        explained_by=absent,
        hidden_by=[()] * BOXES,
        reviewer=absent,
        comment=absent,
        config="0" * 64,
    )


if __name__ == "__main__":
    main()
