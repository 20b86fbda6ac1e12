"""Every format that labels are written in: time per box, memory for 300,000 boxes.

    python -m benchmarks.bench_formats [--json]

Each format is written twice, 30,000 boxes and ten times as many, each in a process of
its own, into nothing: what is measured is the writing and not the disk.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator

from filter_core.formats.export import ExportBox, ExportFrame, ExportHead, ExportOptions
from filter_core.formats.registry import EXPORT_FORMATS, FORMATS, write_export

FEW, MANY = 1_000, 10_000
BOXES = 30
CLASSES = ("car", "van", "walker")
MIB = 1024
MOST_MEMORY = 1.1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--format", help=argparse.SUPPRESS)
    parser.add_argument("--frames", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.frames:
        print(json.dumps(written(options.format, options.frames)))
        return
    figures = {}
    for name in EXPORT_FORMATS:
        few, many = (in_a_process(name, frames) for frames in (FEW, MANY))
        figures[f"{name}, us per box"] = many["us_per_box"]
        figures[f"{name}, peak of 300,000 boxes, MiB"] = many["peak_mib"]
        figures[f"{name}, peak against a tenth of them: measured"] = (
            many["peak_mib"] / few["peak_mib"]
        )
    figures["the same for each format: asked, at most"] = MOST_MEMORY
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        for label, value in figures.items():
            print(f"{label:58} {value:10.2f}")


def in_a_process(name: str, frames: int) -> dict[str, float]:
    command = [sys.executable, "-m", "benchmarks.bench_formats", "--format", name]
    done = subprocess.run(
        [*command, "--frames", str(frames)],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    found: dict[str, float] = json.loads(done.stdout)
    return found


def written(name: str, frames: int) -> dict[str, float]:
    """One export into nothing; the figures of this process."""
    images = {"images": "none"} if "images" in FORMATS[name].options else {}
    head = ExportHead(CLASSES, expected_boxes=frames * BOXES)
    options = ExportOptions.from_mapping(images)
    started = time.process_time()
    write_export(name, street(frames), swallow, head, options)
    spent = time.process_time() - started
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {"us_per_box": spent * 1e6 / (frames * BOXES), "peak_mib": peak / MIB}


def swallow(_file: str, pieces: Iterable[bytes]) -> None:
    for _ in pieces:
        pass


def street(frames: int) -> Iterator[ExportFrame]:
    """A third of the boxes is rejected, so that the books grow as well."""
    for number in range(frames):
        boxes = [box(number, each) for each in range(BOXES)]
        yield ExportFrame(f"town/{number:06}", (1280, 720), boxes, map="Town10HD")


def box(frame: int, number: int) -> ExportBox:
    low = float((frame * 7 + number * 31) % 1200), float((number * 53) % 600)
    xyxy = [*low, low[0] + 64.5, low[1] + 120.25]
    rejected = number % 3 == 0
    decision = {
        "id": str(number),
        "class": CLASSES[number % len(CLASSES)],
        "verdict": "rejected" if rejected else "kept",
        "reason": "below_threshold" if rejected else "visible",
        "match_percent": 50.0,
        "distance": number * 4.0,
        "xyxy": xyxy,
    }
    return ExportBox(decision, given_xyxy=xyxy, given={"xyxy": xyxy})


if __name__ == "__main__":
    main()
