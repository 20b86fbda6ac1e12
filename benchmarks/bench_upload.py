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

import json
import time
from collections.abc import Mapping
from typing import Any

from benchmarks.measuring import (
    client_of,
    cpu_seconds,
    create_dataset,
    decode_seconds,
    parser_of,
    served,
    show,
)
from benchmarks.street import AS_RECORDINGS, photograph, street
from tests.support.servers import RunningServer
from unghost.street.street import StreetScene

WARM_UP = 20


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--without-image", action="store_true")
    parser.add_argument("--rgba", action="store_true")
    parser.add_argument("--rendered", nargs="*", choices=("instances", "depth"))
    options = parser.parse_args()
    annotation: Mapping[str, Any]
    if options.rendered is None:
        scene = street(as_carla_writes=options.rgba)
        annotation, files = scene.annotation, {"segmentation": scene.png}
        if not options.without_image:
            files["image"] = photograph()
    else:
        frame = next(StreetScene(seed=0, actors=AS_RECORDINGS).frames(1))
        annotation = frame.annotation
        files = {"image": frame.image_png, "segmentation": frame.segmentation_png}
        files |= {name: getattr(frame, f"{name}_png") for name in options.rendered}
    before = decode_seconds(files["segmentation"])
    with served() as server:
        cpu, wall = upload(server, files, annotation, options.frames)
    decode = (before + decode_seconds(files["segmentation"])) / 2
    boxes: Any = annotation["boxes"]
    figures = {
        "boxes per frame": len(boxes),
        "bytes per frame": sum(map(len, files.values())),
        "decode of the segmentation [ms]": 1000 * decode,
        "server CPU per upload [ms]": 1000 * cpu,
        "server CPU / decode": cpu / decode,
        "wall per upload, one client [ms]": 1000 * wall,
    }
    show(figures, as_json=options.json)


def upload(
    server: RunningServer,
    files: dict[str, bytes],
    annotation: Mapping[str, Any],
    frames: int,
) -> tuple[float, float]:
    """Seconds of the server's processor, and of waiting, per frame."""
    create_dataset(server, "bench")
    client = client_of(server)
    form = {"annotation": json.dumps(annotation)}

    def put(key: str, parts: Mapping[str, bytes]) -> None:
        path = f"/datasets/bench/frames/{key}"
        client.put(path, files=parts, data=form).raise_for_status()

    for number in range(WARM_UP):
        put(f"warm/{number}", files)
    cpu, begun = cpu_seconds(server.process.pid), time.perf_counter()
    for number in range(frames):
        # The image differs each time: the same one would be stored already.
        changed = dict(files)
        if "image" in files:
            changed["image"] += number.to_bytes(4, "big")
        put(f"frame/{number:06d}", changed)
    wall = time.perf_counter() - begun
    return (cpu_seconds(server.process.pid) - cpu) / frames, wall / frames


if __name__ == "__main__":
    main()
