"""How much memory and processor time per frame does `unghost push` need?

    python -m benchmarks.bench_push [--frames 1000 10000] [--json] [--check]

Frames that share a few files, but have keys and boxes of their own, are pushed to a
real server by a real `unghost push`. Its peak memory and processor time come from the
system. Then the same frames are pushed again: all are stored, and none is sent.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.bench_local import annotation
from benchmarks.bench_upload import photograph
from benchmarks.street import street
from tests.support import frames as tiny
from tests.support.servers import RunningServer, running_server

AIM_MEMORY_RATIO = 1.1
SAMPLE_EVERY_S = 0.02


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, nargs="+", default=[1000, 10_000])
    parser.add_argument("--small", action="store_true", help="tiny images: quicker")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--check", action="store_true", help="fail if memory grows")
    options = parser.parse_args()
    results = [measured(count, small=options.small) for count in options.frames]
    first, last = results[0], results[-1]
    growth = last["peak [MB]"] / first["peak [MB]"]
    if options.json:
        print(json.dumps({"growth": growth, "pushes": results}, indent=1))
    else:
        for name in results[0]:
            values = "".join(f"{result[name]:12.2f}" for result in results)
            print(f"{name:36}{values}")
        print(f"{'memory, last against first':36}{growth:12.2f}")
    return int(options.check and growth > AIM_MEMORY_RATIO)


def measured(frames: int, *, small: bool) -> dict[str, float]:
    """One push of so many frames to a new server, and a second one."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        size = write_frames(folder / "frames", frames, small=small)
        with running_server(
            folder / "data", {"UNGHOST_LOG_LEVEL": "warning"}
        ) as server:
            first = push(server, folder / "frames")
            again = push(server, folder / "frames")
    return {
        "frames": frames,
        "bytes per frame": size,
        "peak [MB]": max(first[0], again[0]),
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
    """Peak memory (MB), processor seconds and seconds of one `unghost push`."""
    words = ["push", str(folder), "--dataset", "bench", "--server", server.url]
    command = [sys.executable, "-m", "unghost.cli", *words, "--token", server.token]
    begun, peak = time.perf_counter(), 0.0
    with subprocess.Popen(command) as child:
        # Not ru_maxrss: that of a child begins with what its parent had.
        while not (ended := os.wait4(child.pid, os.WNOHANG))[0]:
            peak = max(peak, high_water_mb(child.pid))
            time.sleep(SAMPLE_EVERY_S)
        _, status, used = ended
        child.returncode = os.waitstatus_to_exitcode(status)
    assert child.returncode == 0
    return peak, used.ru_utime + used.ru_stime, time.perf_counter() - begun


def high_water_mb(pid: int) -> float:
    """Peak memory of a process until now, as Linux reports it."""
    status = Path(f"/proc/{pid}/status").read_text()
    return next(
        (int(line.split()[1]) / 1e3 for line in status.splitlines() if "VmHWM" in line),
        0.0,
    )


if __name__ == "__main__":
    sys.exit(main())
