"""How long does inspecting a folder take, and does its memory grow with the files?

    python -m benchmarks.bench_inspect [--files 10000,100000] [--json] [--check]
    python -m benchmarks.bench_inspect --dropped [--files 10000] [--json]

A YOLO folder of tiny pictures and label files, half of each, with two boxes a frame. It
is made and inspected by `inspect_recording`, as `unghost inspect` does, in a process of
its own for each number of files.

With `--dropped` such a folder, with pictures, segmentations and labels in equal parts,
of 1280 x 720 px, is dropped on the page of a real server in a real Chromium. One time
is from the drop until the page shows what was understood, the other that of the
server's response.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from argparse import SUPPRESS
from pathlib import Path
from typing import cast

import cv2
import numpy as np
from playwright.sync_api import StorageState

from benchmarks.measuring import (
    MIB,
    cpu_seconds,
    in_a_process,
    parser_of,
    peak_mib,
    served,
    show,
)
from benchmarks.street import HEIGHT, WIDTH, street
from tests.support.page.windows import launched

PER_FOLDER = 10_000
LABEL = "0 0.5 0.5 0.1 0.2\n1 0.3 0.5 0.1 0.2\n"
AIM_BYTES_PER_FILE = 400
REPEATS = 4
WATCH = """() => {
  window.times = {};
  addEventListener("drop", () => (window.times = { dropped: performance.now() }), true);
  new MutationObserver(() => {
    if (document.querySelector(".understood"))
      requestAnimationFrame(() => (times.understood ??= performance.now()));
  }).observe(document.body, { subtree: true, childList: true });
}"""
TIMES = """() => {
  const isFolder = ({ name }) => name.endsWith("/api/v1/folders?layout=auto");
  const entry = performance.getEntriesByType("resource").filter(isFolder).at(-1);
  return { whole: (times.understood - times.dropped) / 1000,
    response: (entry.responseEnd - entry.requestStart) / 1000 };
}"""


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
    """Drop a folder on the page several times; the seconds until it is understood."""
    figures: dict[str, float] = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        served() as server,
        launched() as browser,
    ):
        root = Path(folder) / "town"
        write_recording(root, files // 3)
        state = cast("StorageState", server.signed_in())
        page = browser.new_context(storage_state=state).new_page()
        page.goto(f"{server.url}/#/datasets")
        page.get_by_label("Upload a folder").last.wait_for(state="attached")
        page.evaluate(WATCH)
        page.wait_for_timeout(3000)  # a process is started for the pictures of the page
        events = page.context.new_cdp_session(page)
        data = {"items": [], "files": [str(root)], "dragOperationsMask": 1}
        for number in range(1, REPEATS + 1):
            cpu = cpu_seconds(server.process.pid)
            for kind in ("dragEnter", "dragOver", "drop"):
                event = {"type": kind, "x": 640, "y": 400, "data": data}
                events.send("Input.dispatchDragEvent", event)
            page.wait_for_function("() => times.understood")
            times = page.evaluate(TIMES)
            cpu = cpu_seconds(server.process.pid) - cpu
            figures[f"seconds from drop to understanding {number}"] = times["whole"]
            figures[f"seconds, response {number}"] = times["response"]
            figures[f"seconds of the server's processor time {number}"] = cpu
            page.get_by_role("button", name="Cancel").last.click()
            page.wait_for_timeout(1000)
    return figures


def write_recording(root: Path, frames: int) -> None:
    """Frames of one picture and one segmentation, to which all others are links."""
    noise = np.random.default_rng(1).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
    picture = cv2.imencode(".jpg", cv2.GaussianBlur(noise, (0, 0), 4))[1].tobytes()
    contents = {
        "images": (".jpg", picture),
        "seg": (".png", street().png),
        "labels": (".txt", LABEL.encode()),
    }
    for kind, (suffix, content) in contents.items():
        (root / kind).mkdir(parents=True)
        first = root / kind / f"{0:06}{suffix}"
        first.write_bytes(content)
        for number in range(1, frames):
            (root / kind / f"{number:06}{suffix}").hardlink_to(first)
    (root / "data.yaml").write_text("names: [car, walker]\n")


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
