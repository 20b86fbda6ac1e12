"""What benchmarks share: options, figures, servers, stored boxes, time and memory."""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import cv2
import httpx
import numpy as np

from app.catalog.datasets import DatasetRepository
from app.context import ServiceContext
from benchmarks.street import crowd, soft_photograph, street
from tests.support.large_datasets import NAME, fill, open_context
from tests.support.servers import RunningServer, running_server

DATA = Path("benchmarks/.data")
MIB = 1 << 20
AIM_MEMORY_RATIO = 1.1
"""How much more memory may be needed for ten times as many frames or more."""


def parser_of(description: str | None) -> argparse.ArgumentParser:
    """The options that every benchmark has."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead")
    return parser


def show(figures: Mapping[str, float], *, as_json: bool) -> None:
    """Print figures by their names, which say the units."""
    if as_json:
        print(json.dumps(figures, indent=1))
    else:
        for name, value in figures.items():
            print(f"{name:64} {value:14,.2f}")


def in_a_process(module: str, *words: object) -> dict[str, float]:
    """The figures that another call of a benchmark prints, in a process of its own."""
    command = [sys.executable, "-m", module, *map(str, words)]
    printed = subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout
    figures: dict[str, float] = json.loads(printed)
    return figures


@contextmanager
def served(data: Path | None = None) -> Iterator[RunningServer]:
    """A server of a data folder, else of a new one."""
    with tempfile.TemporaryDirectory() as folder:
        data = data or Path(folder) / "data"
        quiet = {"UNGHOST_LOG_LEVEL": "warning"}
        with running_server(data.resolve(), quiet, anew=True) as server:
            yield server


def client_of(server: RunningServer) -> httpx.Client:
    """A client of the API that may do everything."""
    url = f"{server.url}/api/v1"
    return httpx.Client(base_url=url, headers=server.headers, timeout=600)


def create_dataset(server: RunningServer, name: str) -> None:
    """Create an empty dataset."""
    with client_of(server) as client:
        client.post("/datasets", json={"name": name}).raise_for_status()


def store_pictures(
    server: RunningServer, dataset: str, boxes: Sequence[int]
) -> list[int]:
    """Store frames with different images and so many boxes; their ids."""
    create_dataset(server, dataset)
    ids = []
    with client_of(server) as client:
        for number, count in enumerate(boxes):
            files: dict[str, tuple[str, bytes | str]] = {
                "image": ("image.png", soft_photograph(number)),
                "segmentation": ("seg.png", street().png),
                "annotation": ("a.json", json.dumps(crowd(1000 + number, count))),
            }
            path = f"/datasets/{dataset}/frames/{number:06d}"
            response = client.put(path, files=files)
            ids.append(response.raise_for_status().json()["frame"]["id"])
    return ids


@contextmanager
def opened(folder: Path) -> Iterator[ServiceContext]:
    """A data folder, without a server."""
    context = open_context(folder)
    try:
        yield context
    finally:
        context.close()
        context.database.close()


def store_million(context: ServiceContext, boxes: int) -> None:
    """Store the dataset of a million boxes, or of as many, unless it exists."""
    with context.database.read() as session:
        datasets = DatasetRepository(session).page(after="", limit=10)
    if all(dataset.name != NAME for dataset in datasets):
        fill(context, boxes, progress)
        sys.stderr.write("\n")


def progress(boxes: int) -> None:
    """Show how many boxes are stored."""
    sys.stderr.write(f"\rstored {boxes:,} boxes")


def seconds_of(action: Callable[[], object]) -> float:
    """How long one call takes."""
    begun = time.perf_counter()
    action()
    return time.perf_counter() - begun


def quantile(times: Sequence[float], share: float) -> float:
    """The time below which this share of all times is."""
    return sorted(times)[min(len(times) - 1, int(share * len(times)))]


@contextmanager
def sampled(read: Callable[[], float], every_s: float) -> Iterator[list[float]]:
    """What `read` returns: at once, and then again and again until the block ends."""
    over, samples = threading.Event(), [read()]

    def sample() -> None:
        while not over.wait(every_s):
            samples.append(read())

    sampler = threading.Thread(target=sample)
    sampler.start()
    try:
        yield samples
    finally:
        over.set()
        sampler.join()


def decode_seconds(png: bytes, repeats: int = 60) -> float:
    """Processor time of one decode by OpenCV."""
    data = np.frombuffer(png, np.uint8)
    cv2.setNumThreads(1)
    cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    begun = time.process_time()
    for _ in range(repeats):
        cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    return (time.process_time() - begun) / repeats


def cpu_seconds(pid: int) -> float:
    """User and system time of a process and of those that it has started."""
    tasks = Path(f"/proc/{pid}/task")
    children = [
        int(child)
        for task in tasks.iterdir()
        for child in (task / "children").read_text().split()
    ]
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    own = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return own + sum(map(cpu_seconds, children))


def peak_mib(pid: int | str = "self") -> float:
    """Peak memory of a process until now; 0 when it has ended.

    Not `ru_maxrss`: that of a child begins with what its parent had.
    """
    peak = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    return int(peak[1]) / 1024 if peak else 0.0
