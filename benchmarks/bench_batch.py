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

import hashlib
import json
import re
import shutil
import socket
import statistics
import tarfile
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from os import cpu_count
from pathlib import Path
from urllib.parse import urlsplit

from benchmarks.measuring import (
    AIM_MEMORY_RATIO,
    DATA,
    cpu_seconds,
    create_dataset,
    decode_seconds,
    opened,
    parser_of,
    peak_mib,
    served,
    show,
    store_million,
)
from benchmarks.opencv_decoding import decoding_by_opencv
from benchmarks.street import AS_RECORDINGS, photograph, street
from filter_core.annotation.parsing import parse_annotation
from filter_core.config.filter import FilterConfig
from filter_core.pipeline import FrameOptions, measure_frame
from filter_core.segmentation.reading import read_segmentation
from tests.support.large_datasets import NAME as MILLION
from tests.support.servers import RunningServer
from unghost.street.street import StreetScene

BLOCK = 512
WARM_UP = 40
FEW, MANY = 1_000, 10_000
ROUNDS = 3
AIM_RATE_PERCENT = 50
AIM_RATE_WITHOUT_IMAGE_PERCENT = 60
AIM_CPU_RATIO = 1.8
AIM_FULL_PERCENT = 90


@dataclass(frozen=True)
class Scene:
    """What every frame of the archive has; `others` are PNGs by their kind."""

    segmentation: bytes
    image: bytes
    annotation: Mapping[str, object]
    others: Mapping[str, bytes] = field(default_factory=dict)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--frames", type=int, default=FEW)
    for name in ("without-image", "carla", "memory", "filled", "rendered"):
        parser.add_argument(f"--{name}", action="store_true")
    options = parser.parse_args()
    image = b"" if options.without_image else photograph()
    frame = street(as_carla_writes=options.carla)
    scene = Scene(frame.png, image, frame.annotation)
    if options.rendered:
        figures = by_evidence(options.frames)
    elif options.memory:
        figures = memory(scene)
    elif options.filled:
        figures = filled(scene, options.frames)
    else:
        figures = speed(scene, options.frames)
    show(figures, as_json=options.json)


def speed(scene: Scene, frames: int) -> dict[str, float]:
    """Rates and processor time, compared with decoding and measuring alone."""
    by_opencv: list[float] = []
    by_zlib_ng: list[float] = []
    decodes: list[float] = []
    sent: list[tuple[float, float]] = []
    with served() as server:
        create_dataset(server, "bench")
        for number in range(ROUNDS + 1):
            # The first archive warms up the server.
            count = frames // ROUNDS if number else WARM_UP
            sent.append(send(server, scene, count, f"round-{number}"))
            with decoding_by_opencv():
                by_opencv.append(measured_rate(scene))
            by_zlib_ng.append(measured_rate(scene))
            decodes.append(decode_seconds(scene.segmentation))
    rate, cpu = (statistics.median(each) for each in zip(*sent[1:], strict=True))
    alone, in_use = statistics.median(by_opencv), statistics.median(by_zlib_ng)
    decode = statistics.median(decodes)
    # Four times as much where a processor has no instruction for SHA.
    content, begun = scene.image + scene.segmentation, time.process_time()
    for _ in range(20):
        hashlib.sha256(content).digest()
    hashed = (time.process_time() - begun) / 20
    figures = {
        "bytes per frame": len(scene.image) + len(scene.segmentation),
        "decoded by OpenCV and measured only [frames/s]": alone,
        "decoded by zlib-ng and measured only [frames/s]": in_use,
        "sent, stored, decided, answered [frames/s]": rate,
        "the same in percent of zlib-ng's": 100 * rate / in_use,
        "the same in percent of OpenCV's: measured": 100 * rate / alone,
        "the same in percent of OpenCV's: aim, at least": (
            AIM_RATE_PERCENT if scene.image else AIM_RATE_WITHOUT_IMAGE_PERCENT
        ),
        "decoding the segmentation by OpenCV [ms]": 1000 * decode,
        "SHA-256 of the files / decode": hashed / decode,
        "server CPU per frame [ms]": 1000 * cpu,
        "server CPU / decode: measured": cpu / decode,
    }
    if scene.image:
        figures["server CPU / decode: aim, at most"] = AIM_CPU_RATIO
    return figures


def memory(scene: Scene) -> dict[str, float]:
    """Peak memory of the server, in a new process for each number of frames."""
    peaks = {}
    for frames in (FEW, MANY):
        with served() as server:
            create_dataset(server, "bench")
            send(server, scene, frames, "all")
            peaks[frames] = peak_mib(server.process.pid)
    figures = {f"peak of {count} frames [MiB]": peak for count, peak in peaks.items()}
    return figures | {
        "the larger / the smaller: measured": peaks[MANY] / peaks[FEW],
        "the larger / the smaller: aim, at most": AIM_MEMORY_RATIO,
    }


def filled(scene: Scene, frames: int) -> dict[str, float]:
    """The rates of an empty server and of one with a million boxes, alternately."""
    names = ("empty", "a million boxes")
    rates: dict[str, list[float]] = {name: [] for name in names}
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        data = Path(folder) / "data"
        data.mkdir()
        if (DATA / "unghost.db").exists():
            shutil.copy(DATA / "unghost.db", data)
        with opened(data) as context:
            store_million(context, 1_000_000)
        empty, full = (stack.enter_context(served(each)) for each in (None, data))
        create_dataset(empty, "bench")
        targets = dict(zip(names, ((empty, "bench"), (full, MILLION)), strict=True))
        for number in range(ROUNDS + 1):
            count = frames // ROUNDS if number else WARM_UP
            for name, (server, dataset) in targets.items():
                rate, _ = send(server, scene, count, f"{number}", dataset)
                rates[name].append(rate)
    without, with_many = (statistics.median(each[1:]) for each in rates.values())
    return {
        "empty [frames/s]": without,
        "a million boxes [frames/s]": with_many,
        "full / empty [percent]: measured": 100 * with_many / without,
        "full / empty [percent]: aim, at least": AIM_FULL_PERCENT,
    }


def by_evidence(frames: int) -> dict[str, float]:
    """Processor and wall time of each set of images against those of none, in turn."""
    frame = next(StreetScene(seed=0, actors=AS_RECORDINGS).frames(1))
    plain = Scene(frame.segmentation_png, frame.image_png, frame.annotation)
    pngs = {"instances": frame.instances_png, "depth": frame.depth_png}
    sets: list[dict[str, bytes]] = [{}, *({name: png} for name, png in pngs.items())]
    sets.append(pngs)
    sent: dict[str, list[tuple[float, float]]] = {}
    with served() as server:
        create_dataset(server, "bench")
        for number in range(ROUNDS + 1):
            for others in sets:
                name = " and ".join(others) or "none"
                count = frames // ROUNDS if number else WARM_UP
                scene = replace(plain, others=others)
                figures = send(server, scene, count, f"{name}-{number}")
                sent.setdefault(name, []).append(figures)
    rates, costs = (
        {name: statistics.median(row[at] for row in sent[name][1:]) for name in sent}
        for at in (0, 1)
    )
    table: dict[str, float] = {}
    for name in sent:
        table[f"{name}: server CPU per frame [ms]"] = 1000 * costs[name]
        table[f"{name}: server CPU / that of none"] = costs[name] / costs["none"]
        table[f"{name}: time / that of none"] = rates["none"] / rates[name]
    return table


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


def send(
    server: RunningServer, scene: Scene, frames: int, run: str, dataset: str = "bench"
) -> tuple[float, float]:
    """Send an archive; frames per second, and the server's processor seconds of one."""
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

        def write() -> None:
            for piece in archive(scene, frames, run):
                for part in (b"%x\r\n" % len(piece), piece, b"\r\n"):
                    connection.sendall(part)
            connection.sendall(b"0\r\n\r\n")

        sender = threading.Thread(target=write)
        sender.start()
        response = b"".join(iter(lambda: connection.recv(1 << 16), b""))
        sender.join()
    wall = time.perf_counter() - begun
    end = json.loads(re.findall(rb'{"end".*}', response)[0])
    assert end["stored"] == frames, response[-2000:]
    return frames / wall, (cpu_seconds(server.process.pid) - cpu) / frames


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


if __name__ == "__main__":
    main()
