"""What does a batch of frames cost, against decoding and measuring alone?

    python -m benchmarks.bench_batch [--frames 1000] [--without-image] [--carla]
    python -m benchmarks.bench_batch --memory    peaks at 1,000 and 10,000 frames
    python -m benchmarks.bench_batch --filled    the rate with a million boxes stored
    python -m benchmarks.bench_batch --rendered  with and without instances and depth

A real server on a port takes one archive of frames: a 1.3 MB image of their own, a
segmentation and 30 boxes each. The client packs and sends from this process, on the
same cores. Rates are compared with the rate at which one thread per core only decodes
and measures the same segmentations, alternately in the same run: decoded by OpenCV, and
as the product does (`benchmarks/opencv_decoding.py`). Segmentations are written by
OpenCV, or with `--carla` as CARLA's `save_to_disk` writes them.

`--rendered` sends the frame of a rendered street with the images that each kind of
evidence needs, in turn, and compares their costs with those of the frame without them.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import shutil
import socket
import statistics
import sys
import tarfile
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from os import cpu_count
from pathlib import Path
from urllib.parse import urlsplit

import httpx

from app.process.lifespan import running
from app.settings import Settings
from benchmarks.bench_upload import (
    AS_RECORDINGS,
    cpu_seconds,
    decode_seconds,
    photograph,
)
from benchmarks.opencv_decoding import decoding_by_opencv
from benchmarks.street import Street, street
from filter_core.annotation.parsing import parse_annotation
from filter_core.config.filter import FilterConfig
from filter_core.pipeline import FrameOptions, measure_frame
from filter_core.segmentation.reading import read_segmentation
from tests.support.large_datasets import NAME as MILLION
from tests.support.large_datasets import fill
from tests.support.servers import RunningServer, running_server
from unghost.street.street import StreetScene

BLOCK = 512
DATA = Path("benchmarks/.data")
WARM_UP = 40
FEW, MANY = 1_000, 10_000
ROUNDS = 3
AIM_RATE_PERCENT = 50
AIM_RATE_WITHOUT_IMAGE_PERCENT = 60
AIM_CPU_RATIO = 1.8
AIM_MEMORY_RATIO = 1.1
AIM_FULL_PERCENT = 90


@dataclass(frozen=True)
class Scene:
    """What every frame of the archive has; `others` are PNGs by their kind."""

    segmentation: bytes
    image: bytes
    annotation: Mapping[str, object]
    others: Mapping[str, bytes] = field(default_factory=dict)

    @classmethod
    def of(cls, street: Street, image: bytes) -> Scene:
        rows = zip(street.classes, street.xyxy.tolist(), strict=True)
        boxes = [
            {"class": name, "xyxy": [round(value, 3) for value in xyxy]}
            for name, xyxy in rows
        ]
        return cls(street.png, image, {"carla_version": "0.9.15", "boxes": boxes})


@dataclass(frozen=True)
class SentArchive:
    """How many frames were sent, seconds until the response, and processor seconds."""

    frames: int
    wall: float
    cpu: float


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=FEW)
    parser.add_argument("--without-image", action="store_true")
    parser.add_argument("--carla", action="store_true")
    parser.add_argument("--memory", action="store_true")
    parser.add_argument("--filled", action="store_true")
    parser.add_argument("--rendered", action="store_true")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    image = b"" if options.without_image else photograph()
    scene = Scene.of(street(as_carla_writes=options.carla), image)
    if options.rendered:
        figures = by_evidence(options.frames)
    elif options.memory:
        figures = memory(scene)
    elif options.filled:
        figures = filled(scene, options.frames)
    else:
        figures = speed(scene, options.frames)
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        for name, value in figures.items():
            print(f"{name:52} {value:10.2f}")
    return 0


def speed(scene: Scene, frames: int) -> dict[str, float]:
    """Rates and processor time, compared with decoding and measuring alone."""
    pixels, decode = [rate_by_opencv(scene)], [decode_seconds(scene.segmentation)]
    in_use, sent = [measured_rate(scene)], []
    with serving() as server:
        send(server, scene, WARM_UP, "warm")
        for number in range(ROUNDS):
            sent.append(send(server, scene, frames // ROUNDS, f"round-{number}"))
            pixels.append(rate_by_opencv(scene))
            in_use.append(measured_rate(scene))
            decode.append(decode_seconds(scene.segmentation))
    rate = statistics.median(one.frames / one.wall for one in sent)
    cpu = statistics.median(one.cpu / one.frames for one in sent)
    once = statistics.median(decode)
    hashed = hash_seconds(scene.image + scene.segmentation)
    alone, by_zlib_ng = statistics.median(pixels), statistics.median(in_use)
    figures = {
        "bytes per frame": len(scene.image) + len(scene.segmentation),
        "decoded by OpenCV and measured only [frames/s]": alone,
        "decoded by zlib-ng and measured only [frames/s]": by_zlib_ng,
        "sent, stored, decided, answered [frames/s]": rate,
        "the same in percent of zlib-ng's": 100 * rate / by_zlib_ng,
        "the same in percent of OpenCV's: measured": 100 * rate / alone,
        "the same in percent of OpenCV's: aim, at least": (
            AIM_RATE_PERCENT if scene.image else AIM_RATE_WITHOUT_IMAGE_PERCENT
        ),
        "decoding the segmentation by OpenCV [ms]": 1000 * once,
        "SHA-256 of the files / decode": hashed / once,
        "server CPU per frame [ms]": 1000 * cpu,
        "server CPU / decode: measured": cpu / once,
    }
    if scene.image:
        figures["server CPU / decode: aim, at most"] = AIM_CPU_RATIO
    return figures


def hash_seconds(data: bytes, repeats: int = 20) -> float:
    """Processor time of one digest: four times as much where a CPU has no SHA."""
    begun = time.process_time()
    for _ in range(repeats):
        hashlib.sha256(data).digest()
    return (time.process_time() - begun) / repeats


def memory(scene: Scene) -> dict[str, float]:
    """Peak memory of the server, in a new process for each number of frames."""
    peaks = {}
    for frames in (FEW, MANY):
        with serving() as server:
            send(server, scene, frames, "all")
            peaks[frames] = peak_mib(server.process.pid)
    figures = {f"peak of {count} frames [MiB]": peak for count, peak in peaks.items()}
    return figures | {
        "the larger / the smaller: measured": peaks[MANY] / peaks[FEW],
        "the larger / the smaller: aim, at most": AIM_MEMORY_RATIO,
    }


def filled(scene: Scene, frames: int) -> dict[str, float]:
    """The rates of an empty server and of one with a million boxes, alternately."""
    rates: dict[str, list[float]] = {"empty": [], "a million boxes": []}
    with serving() as empty, serving(with_a_million=True) as full:
        servers = {"empty": (empty, "bench"), "a million boxes": (full, MILLION)}
        for server, dataset in servers.values():
            send(server, scene, WARM_UP, "warm", dataset)
        for number in range(ROUNDS):
            for name, (server, dataset) in servers.items():
                sent = send(server, scene, frames // ROUNDS, f"{number}", dataset)
                rates[name].append(sent.frames / sent.wall)
    medians = {name: statistics.median(each) for name, each in rates.items()}
    figures = {f"{name} [frames/s]": rate for name, rate in medians.items()}
    return figures | {
        "full / empty [percent]: measured": 100
        * medians["a million boxes"]
        / medians["empty"],
        "full / empty [percent]: aim, at least": AIM_FULL_PERCENT,
    }


def by_evidence(frames: int) -> dict[str, float]:
    """Processor and wall time of each set of images against those of none, in turn."""
    frame = next(StreetScene(seed=0, actors=AS_RECORDINGS).frames(1))
    plain = Scene(frame.segmentation_png, frame.image_png, frame.annotation)
    pngs = {"instances": frame.instances_png, "depth": frame.depth_png}
    sets: list[dict[str, bytes]] = [{}, *({name: png} for name, png in pngs.items())]
    sets.append(pngs)
    costs: dict[str, list[SentArchive]] = {}
    with serving() as server:
        for number in range(ROUNDS + 1):
            for others in sets:
                name = " and ".join(others) or "none"
                count = frames // ROUNDS if number else WARM_UP
                scene = replace(plain, others=others)
                sent = send(server, scene, count, f"{name}-{number}")
                if number:
                    costs.setdefault(name, []).append(sent)
    cpu, wall = (
        {
            name: statistics.median(getattr(one, of) / one.frames for one in each)
            for name, each in costs.items()
        }
        for of in ("cpu", "wall")
    )
    figures: dict[str, float] = {}
    for name in costs:
        figures[f"{name}: server CPU per frame [ms]"] = 1000 * cpu[name]
        figures[f"{name}: server CPU / that of none"] = cpu[name] / cpu["none"]
        figures[f"{name}: time / that of none"] = wall[name] / wall["none"]
    return figures


@contextmanager
def serving(*, with_a_million: bool = False) -> Iterator[RunningServer]:
    """A server with its own data, with or without the million boxes."""
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        if with_a_million:
            a_million(data)
        with running_server(
            data, {"UNGHOST_LOG_LEVEL": "warning"}, anew=True
        ) as server:
            url = f"{server.url}/api/v1/datasets"
            made = httpx.post(url, json={"name": "bench"}, headers=server.headers)
            made.raise_for_status()
            yield server


def a_million(data: Path) -> None:
    """A data folder with a million boxes: that of `bench_runs`, or a new one."""
    if (DATA / "unghost.db").exists():
        data.mkdir()
        shutil.copy(DATA / "unghost.db", data)
        return
    with running(Settings(data=data)) as context:
        fill(context, 1_000_000, lambda _: None)


def measured_rate(scene: Scene, seconds: float = 2.0) -> float:
    """Frames per second that all cores only decode and measure."""
    annotation = parse_annotation(scene.annotation)
    config = FilterConfig().measuring()
    wh = (1280, 720)

    def measure_once(_: int) -> None:
        segmentation = read_segmentation(scene.segmentation, expected_wh=wh)
        measure_frame(annotation, segmentation, config, FrameOptions(image_wh=wh))

    measure_once(0)
    threads = cpu_count() or 1
    done, begun = 0, time.perf_counter()
    with ThreadPoolExecutor(threads) as pool:
        while time.perf_counter() - begun < seconds:
            done += len(list(pool.map(measure_once, range(16 * threads))))
    return done / (time.perf_counter() - begun)


def rate_by_opencv(scene: Scene) -> float:
    """The same without zlib-ng."""
    with decoding_by_opencv():
        return measured_rate(scene)


def send(
    server: RunningServer, scene: Scene, frames: int, run: str, dataset: str = "bench"
) -> SentArchive:
    """Send an archive from one thread and read its answer in this one."""
    place = urlsplit(server.url)
    cpu, begun = cpu_seconds(server.process.pid), time.perf_counter()
    with socket.create_connection((place.hostname, place.port or 80)) as connection:
        head = (
            f"POST /api/v1/datasets/{dataset}/batches HTTP/1.1\r\n"
            f"Host: {place.netloc}\r\nAuthorization: Bearer {server.token}\r\n"
            "Content-Type: application/x-tar\r\nTransfer-Encoding: chunked\r\n"
            "Connection: close\r\n\r\n"
        )
        connection.sendall(head.encode())
        pieces = archive(scene, frames, run)
        sender = threading.Thread(target=write, args=(connection, pieces))
        sender.start()
        answer = b"".join(iter(lambda: connection.recv(1 << 16), b""))
        sender.join()
    wall = time.perf_counter() - begun
    end = json.loads(re.findall(rb'{"end".*}', answer)[0])
    assert end["stored"] == frames, answer[-2000:]
    return SentArchive(frames, wall, cpu_seconds(server.process.pid) - cpu)


def write(connection: socket.socket, pieces: Iterator[bytes]) -> None:
    for piece in pieces:
        connection.sendall(b"%x\r\n" % len(piece))
        connection.sendall(piece)
        connection.sendall(b"\r\n")
    connection.sendall(b"0\r\n\r\n")


def archive(scene: Scene, frames: int, run: str) -> Iterator[bytes]:
    """The pieces of the tar; every image differs, or it would be stored already."""
    for number in range(frames):
        name = f"{number:06d}"
        annotation = {"key": f"{run}/{name}", **scene.annotation}
        yield member(f"{name}.json", json.dumps(annotation).encode())
        yield member(f"{name}.segmentation.png", scene.segmentation)
        for kind, png in scene.others.items():
            yield member(f"{name}.{kind}.png", png)
        if scene.image:
            own = f"{run}/{name}".encode()
            yield member(f"{name}.image.png", scene.image + own)
    yield bytes(2 * BLOCK)


def member(name: str, content: bytes) -> bytes:
    header = tarfile.TarInfo(name)
    header.size = len(content)
    padding = bytes(-len(content) % BLOCK)
    return b"".join((header.tobuf(tarfile.USTAR_FORMAT), content, padding))


def peak_mib(pid: int | str) -> float:
    """Peak memory of a process, as Linux reports it."""
    text = Path(f"/proc/{pid}/status").read_text()
    return int(re.findall(r"VmHWM:\s+(\d+) kB", text)[0]) / 1024


if __name__ == "__main__":
    sys.exit(main())
