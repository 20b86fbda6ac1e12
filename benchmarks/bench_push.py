"""How much memory and processor time per frame does `unghost push` need?

    python -m benchmarks.bench_push [--frames 1000 10000] [--json] [--check]

Frames that share a few files, but have keys and boxes of their own, are pushed to a
real server by a real `unghost push`. Its peak memory and processor time come from the
system. Then the same frames are pushed again: all are stored, and none is sent.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.bench_local import annotation
from benchmarks.measuring import AIM_MEMORY_RATIO, parser_of, peak_mib, served, show
from benchmarks.street import photograph, street
from tests.support import frames as tiny
from tests.support.servers import RunningServer

SAMPLE_EVERY_S = 0.02


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--frames", type=int, nargs="+", default=[1000, 10_000])
    parser.add_argument("--small", action="store_true", help="tiny images: quicker")
    parser.add_argument("--check", action="store_true", help="fail if memory grows")
    options = parser.parse_args()
    figures, peaks = {}, []
    for count in options.frames:
        push_figures = measured(count, small=options.small)
        peaks.append(push_figures["peak [MiB]"])
        for name, value in push_figures.items():
            figures[f"{count} frames: {name}"] = value
    growth = figures["memory, last against first: measured"] = peaks[-1] / peaks[0]
    figures["memory, last against first: aim, at most"] = AIM_MEMORY_RATIO
    show(figures, as_json=options.json)
    return int(options.check and growth > AIM_MEMORY_RATIO)


def measured(frames: int, *, small: bool) -> dict[str, float]:
    """One push of so many frames to a new server, and a second one."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "frames"
        size = write_frames(folder, frames, small=small)
        with served() as server:
            first, again = push(server, folder), push(server, folder)
    return {
        "bytes per frame": size,
        "peak [MiB]": max(first[0], again[0]),
        "client CPU per frame [ms]": 1000 * first[1] / frames,
        "frames/s": frames / first[2],
        "repeated: client CPU per frame [ms]": 1000 * again[1] / frames,
        "repeated: frames/s": frames / again[2],
    }


def write_frames(folder: Path, count: int, *, small: bool) -> int:
    """A manifest whose frames differ in key and boxes; bytes of a frame's files."""
    folder.mkdir()
    scene = street()
    image = tiny.image() if small else photograph()
    segmentation = tiny.segmentation() if small else scene.png
    (folder / "rgb.png").write_bytes(image)
    (folder / "seg.png").write_bytes(segmentation)
    files = {"image": "rgb.png", "segmentation": "seg.png"}
    with (folder / "manifest.jsonl").open("w") as lines:
        for number in range(count):
            frame = {**annotation(scene, number), **files}
            if small:
                del frame["camera"]
            lines.write(json.dumps(frame) + "\n")
    return len(image) + len(segmentation)


def push(server: RunningServer, folder: Path) -> tuple[float, float, float]:
    """Peak memory (MiB), processor seconds and seconds of one `unghost push`."""
    words = ["push", str(folder), "--dataset", "bench", "--server", server.url]
    command = [sys.executable, "-m", "unghost.cli", *words, "--token", server.token]
    begun, peak = time.perf_counter(), 0.0
    with subprocess.Popen(command) as child:
        while not (ended := os.wait4(child.pid, os.WNOHANG))[0]:
            peak = max(peak, peak_mib(child.pid))
            time.sleep(SAMPLE_EVERY_S)
        _, status, used = ended
        child.returncode = os.waitstatus_to_exitcode(status)
    assert child.returncode == 0
    return peak, used.ru_utime + used.ru_stime, time.perf_counter() - begun


if __name__ == "__main__":
    sys.exit(main())
