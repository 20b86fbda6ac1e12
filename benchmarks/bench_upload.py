"""What does an upload cost the server, against decoding its segmentation?

    python -m benchmarks.bench_upload [--frames 200] [--rgba] [--json]
    python -m benchmarks.bench_upload --rendered [instances] [depth]

A real server on a port takes frames of a 1.3 MB image, a segmentation and 30 boxes, one
after the other, durably. Its processor time comes from the operating system. That of
decoding is measured in this process before and after. `--rgba` sends the segmentation
as CARLA's own save_to_disk writes it: with alpha, and with a filter chosen for each
row. `--rendered` sends a frame of a rendered street instead, as crowded as recordings
are, with 3D boxes and with these images besides the segmentation: the server then
measures every kind of evidence that they allow.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path

import cv2
import httpx
import numpy as np

from benchmarks.street import HEIGHT, WIDTH, street
from tests.support.servers import RunningServer, running_server
from unghost.street.street import StreetScene

IMAGE_BYTES = 1_300_000
WARM_UP = 20
AS_RECORDINGS = 1 / 7


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--without-image", action="store_true")
    parser.add_argument("--rgba", action="store_true")
    parser.add_argument("--rendered", nargs="*", choices=("instances", "depth"))
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.rendered is None:
        scene = street()
        png = as_carla_saves(scene.png) if options.rgba else scene.png
        files = {"segmentation": png}
        if not options.without_image:
            files["image"] = photograph()
        boxes = [
            {"class": name, "xyxy": [round(value, 3) for value in xyxy]}
            for name, xyxy in zip(scene.classes, scene.xyxy.tolist(), strict=True)
        ]
        annotation: dict = {"carla_version": "0.9.15", "boxes": boxes}
    else:
        frame = next(StreetScene(seed=0, actors=AS_RECORDINGS).frames(1))
        png, annotation = frame.segmentation_png, frame.annotation
        files = {"image": frame.image_png, "segmentation": png}
        files |= {name: getattr(frame, f"{name}_png") for name in options.rendered}
    before = decode_seconds(png)
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        with running_server(
            data, {"UNGHOST_LOG_LEVEL": "warning"}, anew=True
        ) as server:
            cpu, wall = upload(server, files, annotation, options.frames)
    decode = (before + decode_seconds(png)) / 2
    figures = {
        "boxes per frame": len(annotation["boxes"]),
        "bytes per frame": sum(map(len, files.values())),
        "decode of the segmentation [ms]": 1000 * decode,
        "server CPU per upload [ms]": 1000 * cpu,
        "server CPU / decode": cpu / decode,
        "wall per upload, one client [ms]": 1000 * wall,
    }
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        for name, value in figures.items():
            print(f"{name:40} {value:12.2f}")
    return 0


def photograph() -> bytes:
    """A PNG of about the size that a camera's image has."""
    rng = np.random.default_rng(3)
    rows = np.linspace(60, 190, HEIGHT)[:, None, None]
    smooth = np.broadcast_to(rows, (HEIGHT, WIDTH, 3))
    for spread in np.linspace(0.5, 6.0, 40):
        noisy = smooth + rng.normal(0, spread, smooth.shape)
        content = cv2.imencode(".png", noisy.clip(0, 255).astype(np.uint8))[1]
        if content.nbytes >= IMAGE_BYTES:
            break
    return content.tobytes()


def as_carla_saves(png: bytes) -> bytes:
    """The same pixels in four channels, all filters allowed, compressed by level 6."""
    rgb = np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR))
    options = (
        *(cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_ALL_FILTERS),
        *(cv2.IMWRITE_PNG_COMPRESSION, 6),
    )
    rgba = cv2.cvtColor(rgb, cv2.COLOR_BGR2BGRA)
    return cv2.imencode(".png", rgba, options)[1].tobytes()


def decode_seconds(png: bytes, repeats: int = 60) -> float:
    """Processor time of one decode."""
    data = np.frombuffer(png, np.uint8)
    cv2.setNumThreads(1)
    cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    begun = time.process_time()
    for _ in range(repeats):
        cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    return (time.process_time() - begun) / repeats


def upload(
    server: RunningServer, files: dict[str, bytes], annotation: dict, frames: int
) -> tuple[float, float]:
    """Seconds of the server's processor, and of waiting, per frame."""
    client = httpx.Client(
        base_url=f"{server.url}/api/v1", headers=server.headers, timeout=60
    )
    client.post("/datasets", json={"name": "bench"}).raise_for_status()
    parts = {name: (f"{name}.png", content) for name, content in files.items()}
    for number in range(WARM_UP):
        put(client, f"warm/{number}", parts, annotation)
    cpu, begun = cpu_seconds(server.process.pid), time.perf_counter()
    for number in range(frames):
        # The image differs each time: the same one would be stored already.
        changed = dict(parts)
        if "image" in parts:
            changed["image"] = ("i.png", files["image"] + number.to_bytes(4, "big"))
        put(client, f"frame/{number:06d}", changed, annotation)
    wall = time.perf_counter() - begun
    return (cpu_seconds(server.process.pid) - cpu) / frames, wall / frames


def put(client: httpx.Client, key: str, parts: dict, annotation: dict) -> None:
    answer = client.put(
        f"/datasets/bench/frames/{key}",
        files=parts,
        data={"annotation": json.dumps(annotation)},
    )
    assert answer.status_code == 201, answer.text


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


if __name__ == "__main__":
    sys.exit(main())
