"""How long does inspecting a folder take, and does its memory grow with the files?

    python -m benchmarks.bench_inspect [--files 10000,100000] [--json] [--check]
    python -m benchmarks.bench_inspect --dropped [--files 10000] [--json]

A YOLO folder of tiny pictures and label files, half of each, with two boxes a frame. It
is made and inspected by `inspect_recording`, as `unghost inspect` does, in a process of
its own for each number of files. With `--dropped` it is sent to a real server as the
page does, with as many segmentations as pictures: of these, 12 frames have pictures and
segmentations of 1280 x 720 px, all others none. The time is from request to response;
the first is the child's that is started for it.
"""

from __future__ import annotations

import io
import json
import sys
import tarfile
import tempfile
import time
from argparse import SUPPRESS
from pathlib import Path

import cv2
import numpy as np

from benchmarks.measuring import (
    MIB,
    client_of,
    cpu_seconds,
    in_a_process,
    parser_of,
    peak_mib,
    served,
    show,
)
from benchmarks.street import HEIGHT, WIDTH, street

PER_FOLDER = 10_000
LABEL = "0 0.5 0.5 0.1 0.2\n1 0.3 0.5 0.1 0.2\n"
AIM_BYTES_PER_FILE = 400
LOOKED_AT = 12
REPEATS = 4


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--files", default="10000,100000")
    parser.add_argument("--check", action="store_true", help="fail if it grows more")
    parser.add_argument("--dropped", action="store_true")
    parser.add_argument("--folder", type=Path, help=SUPPRESS)
    options = parser.parse_args()
    if options.folder:
        print(json.dumps(inspected(options.folder)))
        return 0
    counts = [int(word) for word in options.files.split(",")]
    figures: dict[str, float] = {}
    if options.dropped:
        figures = dropped(counts[0])
        show(figures, as_json=options.json)
        return 0
    peaks = []
    for count in counts:
        with tempfile.TemporaryDirectory() as folder:
            write_files(Path(folder), count // 2)
            folder_figures = in_a_process(
                "benchmarks.bench_inspect", "--folder", folder
            )
        peaks.append(folder_figures["peak_mib"])
        for name, value in folder_figures.items():
            figures[f"{count} files, {name}"] = value
    grown = (peaks[-1] - peaks[0]) * MIB / max(1, counts[-1] - counts[0])
    figures["bytes of memory for each further file: measured"] = grown
    figures["bytes of memory for each further file: aim, at most"] = AIM_BYTES_PER_FILE
    show(figures, as_json=options.json)
    return int(options.check and grown > AIM_BYTES_PER_FILE)


def write_files(folder: Path, frames: int) -> None:
    """Pictures and labels in folders of ten thousand frames."""
    (folder / "data.yaml").write_text("names: [car, walker]\n")
    _, content = cv2.imencode(".png", np.zeros((60, 80, 3), np.uint8))
    picture = content.tobytes()
    for number in range(frames):
        place = f"run{number // PER_FOLDER}"
        if number % PER_FOLDER == 0:
            for kind in ("images", "labels"):
                (folder / place / kind).mkdir(parents=True)
        (folder / place / f"images/{number:06}.png").write_bytes(picture)
        (folder / place / f"labels/{number:06}.txt").write_text(LABEL)


def dropped(files: int) -> dict[str, float]:
    """Send a folder to a server several times; the seconds of each response."""
    body = archive(files // 3)
    figures = {"MiB sent": len(body) / MIB}
    headers = {"Content-Type": "application/x-tar"}
    with served() as server, client_of(server) as client:
        for number in range(REPEATS):
            cpu, started = cpu_seconds(server.process.pid), time.perf_counter()
            response = client.post("/folders", content=body, headers=headers)
            seconds = time.perf_counter() - started
            cpu = cpu_seconds(server.process.pid) - cpu
            figures[f"seconds, response {number + 1}"] = seconds
            figures[f"seconds of processor time, response {number + 1}"] = cpu
            response.raise_for_status()
            figures["MiB received"] = len(response.content) / MIB
    return figures


def archive(frames: int) -> bytes:
    """The tar that the page would send of a folder."""
    segmentation = street().png
    noise = np.random.default_rng(1).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
    picture = cv2.imencode(".jpg", cv2.GaussianBlur(noise, (0, 0), 4))[1].tobytes()
    whole = {number * frames // LOOKED_AT for number in range(LOOKED_AT)}
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w") as packing:

        def add(name: str, content: bytes) -> None:
            member = tarfile.TarInfo(f"town/{name}")
            member.size = len(content)
            packing.addfile(member, io.BytesIO(content))

        add("data.yaml", b"names: [car, walker]\n")
        for number in range(frames):
            is_whole = number in whole
            add(f"images/{number:06}.jpg", picture if is_whole else b"")
            add(f"seg/{number:06}.png", segmentation if is_whole else b"")
            add(f"labels/{number:06}.txt", LABEL.encode())
    return out.getvalue()


def inspected(folder: Path) -> dict[str, float]:
    """Inspect a folder; the figures of this process."""
    from filter_core.inspection.recording import inspect_recording

    started, spent = time.perf_counter(), time.process_time()
    inspect_recording(folder)
    return {
        "seconds": time.perf_counter() - started,
        "seconds of processor time": time.process_time() - spent,
        "peak_mib": peak_mib(),
    }


if __name__ == "__main__":
    sys.exit(main())
