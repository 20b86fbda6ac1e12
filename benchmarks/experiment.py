"""What do ghost boxes cost a detector, and what does filtering gain?

    python -m benchmarks.experiment FOLDER [--small] [--python PYTHON]

Renders streets as crowded as recordings, of three towns, then trains on two towns and
tests on the third, in turn: every arm, each with three seeds. FOLDER keeps everything:
the same command continues what was interrupted. `--small` shows in minutes that it
works; its numbers mean nothing. docs/experiment.md has the results.
"""

from __future__ import annotations

import argparse
import itertools
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from benchmarks.street import AS_RECORDINGS
from filter_core.evaluation.trials import ComparisonObject
from filter_core.formats.reading import MANIFEST_NAME
from unghost.cli.local.evaluate import interval_plot
from unghost.cli.worth_page import score_tables
from unghost.street.street import StreetScene, write_street
from unghost.street.towns import STYLES

FIRST_SEED = 4001
"""Of the streets; neither the development of the filter nor docs/evaluation.md has
used these."""
STREETS_COUNT, FRAMES = 12, 102
"""Of each town, 34 frames of a street: one drive along it."""
ARMS = "raw,perfect,depth,ordered,paper,random,clipped,carlasimu"
"""The baseline first, then those that matter most. `auto` is left out: where instance
images tell the truth, its labels are those of `perfect`."""
TOWNS = [style.name for style in STYLES]
FILES = ("image", "segmentation", "instances", "depth", "lidar")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--small", action="store_true")
    parser.add_argument(
        "--python", default=sys.executable, help="of an environment with torch"
    )
    parser.add_argument("--parallel", default="2", help="trials at the same time")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", default="450")
    parser.add_argument("--width", default="320")
    parser.add_argument("--picture", type=Path, help="an SVG of mAP50 by arm")
    options = parser.parse_args()
    if options.small:
        options.seeds, options.steps = 1, "40"
    streets, frames = (1, 12) if options.small else (STREETS_COUNT, FRAMES)
    for seed in range(FIRST_SEED, FIRST_SEED + streets):
        street = options.folder / "streets" / str(seed)
        if not (street / MANIFEST_NAME).exists():
            print(f"rendering street {seed}", file=sys.stderr)
            scene = StreetScene(seed, actors=AS_RECORDINGS, flat=False)
            write_street(street, frames, scene)
    trainer = (
        f"{options.python} -m unghost.experiment {{data}} {{seed}} {{output}} "
        f"--batch 4 --steps {options.steps} --width {options.width}"
    )
    tests = TOWNS[-1:] if options.small else TOWNS
    arms = "raw,perfect" if options.small else ARMS
    # Seed after seed, so that there are soon results of every town.
    for seed, test in itertools.product(range(options.seeds), tests):
        manifest = options.folder / f"manifest-{test}.jsonl"
        manifest.write_text("".join(manifest_lines(options.folder, test)), "utf-8")
        others = [options.folder / one for one in tests if one != test]
        subprocess.run(
            [
                *(sys.executable, "-m", "unghost.cli", "worth-it", manifest),
                *(f"--arms={arms}", f"--seeds={seed}-{seed}"),
                *(f"--trainer={trainer}", f"--parallel={options.parallel}"),
                f"--output={options.folder / test}",
                *(f"--join={one}" for one in others if (one / "trials").exists()),
            ],
            check=True,
        )
    report = json.loads((options.folder / tests[-1] / "report.json").read_text("utf-8"))
    print(tables(report))
    if options.picture is not None:
        scores = [(name, arm["map50"]) for name, arm in report["arms"].items()]
        label = "mAP50 of detectors by the labels that they were trained on"
        options.picture.write_text(interval_plot(label, scores, 0.02), "utf-8")


def tables(report: ComparisonObject) -> str:
    """The rows of docs/experiment.md: the detectors of each arm, and differences."""
    lines = [report["verdict"], ""]
    for one in score_tables(report):
        lines += [
            f"| {' | '.join(map(str, one.columns))} |",
            f"{'|---' * len(one.columns)}|",
        ]
        lines += [f"| {' | '.join(map(str, row))} |" for row in one.rows]
        lines += [""]
    return "\n".join(lines)


def manifest_lines(folder: Path, test: str) -> Iterator[str]:
    """The frames of all streets: one town is for validation, the others to train."""
    for street in sorted((folder / "streets").iterdir()):
        for line in (street / MANIFEST_NAME).read_text("utf-8").splitlines():
            frame = json.loads(line)
            place = street.relative_to(folder).as_posix()
            files = {name: f"{place}/{frame[name]}" for name in FILES}
            town = frame["map"]
            part = {
                "key": f"{street.name}/{frame['key']}",
                "sequence": f"{street.name}/{town}",
                "split": "val" if town == test else "train",
            }
            yield json.dumps({**frame, **files, **part}) + "\n"


if __name__ == "__main__":
    main()
