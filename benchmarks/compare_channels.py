"""Which channel finds the ghost boxes of a street, and at what cost?

    python -m benchmarks.compare_channels [--folder FOLDER] [--frames 200] [--seed 2026]
                                          [--json] [--write] [--questions]

`--write` writes docs/evaluation.md. `--questions` compares no channels: it shows how
many of the filter's errors a reviewer is asked about first, for docs/review.md.

Renders two streets with known ground truth (unless the folder has them already): one
with as many boxes per frame as recordings have, one crowded. Measures every channel on
them and counts. Channels are compared on frames with 3D boxes; frames with rectangles
only show what each channel can do without 3D boxes. Costs are medians within one run,
file included, as ratios to the segmentation's.
"""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
import time
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

from benchmarks.evaluation_page import write_page
from benchmarks.measuring import parser_of
from benchmarks.street import AS_RECORDINGS
from filter_core.annotation.frame import FORMS_3D
from filter_core.config.filter import FilterConfig
from filter_core.decisions.doubt import Bin, bins_of, doubts
from filter_core.decisions.rules import decide
from filter_core.evaluation.comparison import EvaluationObject
from filter_core.evidence_kinds import STRONGEST_FIRST
from filter_core.formats.reading import MANIFEST_NAME, FrameSource
from filter_core.formats.registry import read_source
from filter_core.local import (
    EvaluationTask,
    KnownBoxes,
    evaluate_source,
    measure_source,
    read_truth,
)
from filter_core.verdicts import Reason
from unghost.street.street import TRUTH, StreetScene, write_street

COSTED = ("ordered", "depth", "depth_center", "instance", "lidar")
COST_FRAMES = 24
COST_ROUNDS = 5
STREETS = {"recorded": AS_RECORDINGS, "crowded": 1.0}
FIRST_QUESTIONS = (100, 300, 1000)
SIZES = (1, 3, 10, 100)
"""Visible pixels from which the next group begins."""


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--write", action="store_true", help="write docs/evaluation.md")
    parser.add_argument("--questions", action="store_true")
    options = parser.parse_args()
    found: dict[str, Any] = {"frames": options.frames, "seed": options.seed}
    with tempfile.TemporaryDirectory() as temporary:
        for name, actors in STREETS.items():
            folder = (options.folder or Path(temporary)) / name
            if not (folder / MANIFEST_NAME).exists():
                scene = StreetScene(options.seed, actors=actors)
                write_street(folder, options.frames, scene, report)
            found[name] = questions(folder) if options.questions else compared(folder)
    if options.write:
        write_page(found)
    if options.json or not options.write:
        print(json.dumps(found, indent=1))


def report(done: int, of: int) -> None:
    """Report the progress: rendering takes minutes."""
    if sys.stderr.isatty() and done % 10 == 0:
        print(f"{done} of {of} frames rendered", file=sys.stderr)


def compared(folder: Path) -> dict[str, Any]:
    """All comparisons of one street."""
    named = [frame for frame in read_source(folder) if is_solid(frame)]
    solid = list(without_instance_ids(named))
    flat = [frame for frame in read_source(folder) if not is_solid(frame)]
    truth = read_truth(folder / TRUTH)
    task = EvaluationTask(FilterConfig(profile="paper"), truth)
    semantic = replace(task, channels=("semantic",))
    projected = FilterConfig(profile="paper", projection="naive", min_forward=1)
    naive = replace(semantic, config=projected)
    least = FilterConfig(profile="paper", ordered_min_pixels=1)
    one_pixel = EvaluationTask(least, truth, channels=("ordered",))
    return {
        "solid": counted(solid, task),
        "flat": counted(list(without_instance_ids(flat)), task),
        "naive": counted(solid, naive),
        "one_pixel": counted(solid, one_pixel),
        "named": counted(named, replace(task, channels=("instance",))),
        "lost": lost_by_size(solid, folder),
        "cost": costs(solid[:COST_FRAMES]),
    }


def questions(folder: Path) -> dict[str, Any]:
    """How many errors are among the first questions, and how many in each bin: with all
    files, decided by the strongest evidence, and with tags only, as in the paper."""
    frames, truth = list(read_source(folder)), read_truth(folder / TRUTH)
    by_tags, by_all = FilterConfig(profile="paper"), FilterConfig()
    return {
        "tags only": asked(frames, EvaluationTask(by_tags, truth, ("semantic",))),
        "all files": asked(frames, EvaluationTask(by_all, truth, STRONGEST_FIRST)),
    }


def asked(frames: list[FrameSource], task: EvaluationTask) -> dict[str, Any]:
    doubt: list[int] = []
    wrong: list[bool] = []
    config = task.config

    def ask(boxes: KnownBoxes) -> None:
        decisions = decide(boxes.evidence, config)
        doubt.extend(doubts(boxes.evidence, config, decisions).doubt.tolist())
        kept = decisions.reason == Reason.VISIBLE
        wrong.extend((kept != boxes.visible).tolist())

    evaluate_source(frames, task, also=ask)
    worth, errors = np.array(doubt), np.array(wrong)
    order = np.argsort(-worth, kind="stable")
    bins = bins_of(worth)
    return {
        "errors": int(errors.sum()),
        "among the first": {
            first: int(errors[order[:first]][worth[order[:first]] > 0].sum())
            for first in FIRST_QUESTIONS
        },
        "bins": {
            bin_.label: {
                "boxes": int((bins == bin_).sum()),
                "errors": int(errors[bins == bin_].sum()),
            }
            for bin_ in Bin
        },
    }


def is_solid(frame: FrameSource) -> bool:
    """Whether a frame's boxes are 3D."""
    boxes: Any = (frame.annotation or {}).get("boxes", [])
    return any(form in box for box in boxes for form in FORMS_3D)


def without_instance_ids(frames: Iterable[FrameSource]) -> Iterator[FrameSource]:
    """The same frames, without the instance ids of actors."""
    for frame in frames:
        annotation = dict(frame.annotation or {})
        boxes: Any = annotation["boxes"]
        annotation["boxes"] = [
            {key: value for key, value in box.items() if key != "instance_id"}
            for box in boxes
        ]
        yield replace(frame, annotation=annotation)


def lost_by_size(frames: list[FrameSource], folder: Path) -> list[dict[str, int]]:
    """Of visible objects, by how many pixels are seen: how many ordered loses."""
    lines = map(json.loads, (folder / TRUTH).read_text("utf-8").splitlines())
    pixels = {(one["key"], one["id"]): one["visible_pixels"] for one in lines}
    groups = [{"from": size, "visible": 0, "lost": 0} for size in SIZES]
    config = FilterConfig(evidence="ordered")

    def sort_in(boxes: KnownBoxes) -> None:
        kept = decide(boxes.evidence, config).reason == Reason.VISIBLE
        for box_id, visible, is_kept in zip(
            boxes.ids, boxes.visible.tolist(), kept.tolist(), strict=True
        ):
            if visible:
                seen = pixels[boxes.key, box_id]
                group = groups[bisect_right(SIZES, seen) - 1]
                group["visible"] += 1
                group["lost"] += not is_kept

    config = FilterConfig(profile="paper")
    task = EvaluationTask(config, read_truth(folder / TRUTH), channels=("ordered",))
    evaluate_source(frames, task, also=sort_in)
    return groups


def counted(frames: list[FrameSource], task: EvaluationTask) -> EvaluationObject:
    shown = track(frames, "Measuring", disable=not sys.stderr.isatty())
    evaluation, left_out = evaluate_source(shown, task)
    if left_out:
        raise SystemExit(f"{len(left_out)} frames could not be used: {left_out[0]}")
    return evaluation.as_dict()


def costs(frames: list[FrameSource]) -> dict[str, float]:
    """Each channel with everything it reads, against the segmentation alone."""
    config = FilterConfig(profile="paper")
    times: dict[str, list[float]] = {name: [] for name in ("semantic", *COSTED)}
    for _ in range(COST_ROUNDS):
        for frame in frames:
            for name, taken in times.items():
                wanted = () if name == "semantic" else (name,)
                begun = time.process_time()
                measure_source(frame, config, wanted)
                taken.append(time.process_time() - begun)
    base = statistics.median(times["semantic"])
    return {name: statistics.median(taken) / base for name, taken in times.items()}


if __name__ == "__main__":
    main()
