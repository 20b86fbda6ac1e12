"""Which evidence, and which `min_visible_pixels`, leave the best labels on streets?

    python -m benchmarks.label_noise FOLDER [FOLDER ...] [--json]

Each FOLDER is a rendered street, such as those of `benchmarks.experiment`. An object is
what has at least so many visible pixels: 1, 3, 10 or 30. With fewer, down to 1, it is
doubtful. docs/experiment.md has the table.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from dataclasses import replace
from itertools import chain
from pathlib import Path

from rich.progress import track

from benchmarks.measuring import parser_of
from filter_core.evaluation.arms import Arm, LabelNoise, NoiseObject, truth_of_pixels
from filter_core.formats.registry import read_source
from filter_core.local import ArmsTask, LabelledFrame, label_sources

PIXELS = (1, 3, 10, 30)
KINDS = ("paper", "carlasimu", "ordered", "depth", "auto")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    options = parser.parse_args()
    filtered = [f"{kind}@{pixels}" for kind in KINDS for pixels in PIXELS]
    arms = tuple(map(Arm.named, ("raw", "clipped", *filtered)))
    noises = {least: LabelNoise([arm.name for arm in arms]) for least in PIXELS}
    streets = chain.from_iterable(map(read_source, options.folders))
    frames = label_sources(streets, ArmsTask(arms, least_pixels=1))
    for frame in track(frames, "Labelling", disable=not sys.stderr.isatty()):
        if not isinstance(frame, LabelledFrame):
            raise SystemExit(f"{frame.key}: {frame.problem}")
        for least, noise in noises.items():
            truth = truth_of_pixels(frame.boxes.pixels, least).truth
            noise.add(replace(frame.boxes, truth=truth))
    found = {least: noise.as_dict() for least, noise in noises.items()}
    print(json.dumps(found, indent=1) if options.json else table(found))


def table(found: dict[int, NoiseObject]) -> str:
    """The rows of the table in docs/experiment.md."""
    lines = [
        "| labels by | pixels | labels | ghosts | of 1-9 px | lost of 10 px and more "
        "| F1, 1 px | 3 px | 10 px | 30 px |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for name, arm in found[10]["arms"].items():
        kind, _, pixels = name.partition("@")
        groups = Counter({one["pixels"]: one["labelled"] for one in arm["by_pixels"]})
        scores = (noise["arms"][name]["f1"] for noise in found.values())
        cells = [
            *(f"`{kind}`", pixels, f"{arm['labels']:,}", f"{arm['kept_hidden']:,}"),
            f"{groups['1-2'] + groups['3-9']:,}",
            f"{arm['rejected_visible']:,}",
            *(f"{one['value']:.3f}" for one in scores if one is not None),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
