"""The folder of a capture: writes its files and its manifest, and continues it.

Images are stored as PNG files without loss, points of LiDAR and radar as binary PLY
files. A frame is added to the manifest when all its files are complete and durable, so
an interrupted capture continues where it stopped.
"""

from __future__ import annotations

import json
import os
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final, TypedDict

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.formats.files import whole_file
from filter_core.formats.manifest import SEMANTIC_LIDAR_POINT
from filter_core.formats.reading import MANIFEST_NAME
from unghost.capture.simulator import (
    CaptureError,
    Image,
    Measurement,
    PointCloud,
    RadarScan,
    as_image,
)

CAPTURE_NAME: Final = "capture.json"
_SAME: Final = ("scenario_digest", "carla_version", "map")
MANIFEST_KEYS: Final[Mapping[str, str]] = {
    "rgb": "image",
    "segmentation": "segmentation",
    "instances": "instances",
    "depth": "depth",
    "semantic_lidar": "lidar",
    "lidar": "lidar_intensity",
    "radar": "radar",
}
"""The key of each sensor's file in a manifest; the folder is named after the sensor."""
_RED = 2
"""In memory a pixel is blue, green, red, alpha."""
_APPEND: Final = (
    os.O_WRONLY
    | os.O_APPEND
    | os.O_CREAT
    | getattr(os, "O_NOFOLLOW", 0)
    | getattr(os, "O_BINARY", 0)
)
"""How a file is opened to append to it, unless it is a link to another one."""
Table = NDArray[np.void]
"""A structured array, one row per point."""
LIDAR: Final = np.dtype([(name, "<f4") for name in ("x", "y", "z", "intensity")])
RADAR: Final = np.dtype(
    [
        (name, "<f4")
        for name in ("x", "y", "z", "velocity", "azimuth", "altitude", "depth")
    ]
)
_PLY_NAMES: Final = {"f": "float", "u": "uint"}


class FrameRecord(TypedDict):
    """A line of the manifest without the key and the files of the frame.

    `filter_core.annotation.parsing` reads it; ``extra`` holds data that is only stored.
    """

    carla_version: str
    map: str
    weather: Mapping[str, float | str]
    camera: Mapping[str, object]
    sensors: Mapping[str, object]
    boxes: Sequence[Mapping[str, object]]
    extra: dict[str, object]
    captured_at: str


class CaptureFolder:
    """Frames on the disk; `keys` are in the manifest's order."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.keys: list[str] = []

    def open(self, about: Mapping[str, object]) -> None:
        """Begin a capture in this folder, or continue the one that it holds.

        `CaptureError` if it holds something else, or frames of another capture.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        for sensor in MANIFEST_KEYS:
            _refuse_link(self.path / sensor)
        capture = self._read_about()
        if capture is None and any(self.path.iterdir()):
            raise CaptureError(
                f"{self.path} is not empty and contains no capture: choose another "
                "--output"
            )
        self.keys = self._read_keys()
        if capture is not None and self.keys:
            for name in _SAME:
                if capture.get(name) != about.get(name):
                    what = "scenario" if name == "scenario_digest" else name
                    raise CaptureError(
                        f"{self.path} contains a capture with another {what}: choose "
                        "another --output, or use the same one again"
                    )
        else:
            # Without any frame, a changed scenario cannot contradict recorded frames.
            self.describe(about)

    def count_of(self, map_name: str) -> int:
        """The recorded frames of a map."""
        return sum(key.startswith(f"{map_name}/") for key in self.keys)

    def tally(self) -> dict[str, dict[str, dict[str, int]]]:
        """Frames and boxes by map, weather, class and distance band.

        A preset's name is that of the weather, which is ``other`` without one; a band
        is called by its upper end, metres.
        """
        counts: dict[str, dict[str, Counter[str]]] = {
            name: defaultdict(Counter) for name in ("map", "weather", "class", "band")
        }
        path = self.path / MANIFEST_NAME
        with path.open("rb") as file:
            for line in map(json.loads, file):
                boxes = line["boxes"]
                weather = line["weather"].get("preset", "other")
                for what, name in (("map", line["map"]), ("weather", weather)):
                    counts[what][name].update(frames=1, boxes=len(boxes))
                said = {
                    "class": Counter(str(box.get("class", "unknown")) for box in boxes),
                    "band": Counter(
                        f"{band:g}" if isinstance(band, float | int) else "beyond"
                        for band in (box.get("extra", {}).get("band") for box in boxes)
                    ),
                }
                for what, in_frame in said.items():
                    for name, count in in_frame.items():
                        counts[what][name].update(frames=1, boxes=count)
        return {
            what: {name: dict(there[name]) for name in sorted(there)}
            for what, there in counts.items()
        }

    def describe(self, about: Mapping[str, object]) -> None:
        """Write the description of the capture, whole or not at all."""
        content = json.dumps(about, indent=2, ensure_ascii=False) + "\n"
        _write_whole(self.path / CAPTURE_NAME, content.encode())

    def add(
        self, key: str, files: Mapping[str, tuple[str, bytes]], frame: FrameRecord
    ) -> dict[str, Path]:
        """Store a frame: its files, then its line; returns the paths of the files.

        `files` are suffix and content by the sensor's name, as `encode` gives them.
        """
        stem = f"{len(self.keys):06d}"
        paths = {}
        for sensor, (suffix, content) in files.items():
            name = f"{sensor}/{stem}{suffix}"
            target = self.path / name
            _refuse_link(target.parent)
            target.parent.mkdir(exist_ok=True)
            _write_whole(target, content)
            paths[MANIFEST_KEYS[sensor]] = name
        # The manifest has one key for points, which is for points with tags.
        more = paths.pop("lidar_intensity", None)
        if more is not None:
            frame["extra"]["files"] = {"lidar_intensity": more}
        self._append({"key": key, **paths, **frame})
        self.keys.append(key)
        return {kind: self.path / name for kind, name in paths.items()}

    def _append(self, line: Mapping[str, object]) -> None:
        text = json.dumps(line, ensure_ascii=False, allow_nan=False) + "\n"
        descriptor = os.open(self.path / MANIFEST_NAME, _APPEND, 0o666)
        with os.fdopen(descriptor, "ab") as file:
            file.write(text.encode())
            file.flush()
            os.fsync(file.fileno())

    def _read_about(self) -> dict[str, object] | None:
        path = self.path / CAPTURE_NAME
        if not path.exists():
            return None
        try:
            about = json.loads(path.read_bytes())
        except ValueError as error:
            raise CaptureError(f"{path} cannot be read as JSON: {error}") from error
        is_ours = isinstance(about, dict) and set(_SAME) <= set(about)
        return about if is_ours else None

    def _read_keys(self) -> list[str]:
        path = self.path / MANIFEST_NAME
        _refuse_link(path)
        if not path.exists():
            return []
        content = path.read_bytes()
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            # The line that was being written when the machine stopped.
            os.truncate(path, whole)
        lines = content[:whole].splitlines()
        try:
            return [str(json.loads(line)["key"]) for line in lines]
        except (ValueError, LookupError, TypeError) as error:
            raise CaptureError(
                f"{path} is damaged, the capture cannot continue: {error}"
            ) from error


def _refuse_link(path: Path) -> None:
    # Somebody else may have laid it: to a private file, which would be cut and written
    # to, or to another capture, whose files have the same names.
    if path.is_symlink():
        raise CaptureError(f"{path} is a link, the capture cannot continue")


def _write_whole(target: Path, content: bytes) -> None:
    with whole_file(target) as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def encode(sensor: str, measured: Measurement) -> tuple[str, bytes]:
    """The measurement of a sensor as a file: its suffix and its content."""
    to_points = POINTS.get(sensor)
    if to_points is None:
        return ".png", png(sensor, as_image(measured))
    return ".ply", ply(to_points(measured))


def png(name: str, image: Image) -> bytes:
    """The image of the camera `name` as a PNG file.

    The segmentation's tags are its red channel alone, written as one grey channel; the
    others are written in true RGB order: depth and instance ids are three bytes.
    """
    pixels = pixels_of(image)
    plane = pixels[..., _RED] if name == "segmentation" else pixels[..., :3]
    done, encoded = cv2.imencode(".png", np.ascontiguousarray(plane))
    if not done:
        raise CaptureError(f"{name}: the image could not be written as PNG")
    return encoded.tobytes()


def pixels_of(image: Image) -> NDArray[np.uint8]:
    """(H, W, 4): blue, green, red and alpha, in the image's own memory."""
    flat = np.frombuffer(image.raw_data, np.uint8)
    return flat.reshape(image.height, image.width, 4)


def ply(table: Table) -> bytes:
    """A structured array as PLY 1.0, little-endian."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    header += [
        f"property {_PLY_NAMES[table.dtype[name].kind]} {name}"
        for name in table.dtype.names or ()
    ]
    return "\n".join([*header, "end_header", ""]).encode("ascii") + table.tobytes()


def radar_points(measurement: Measurement) -> Table:
    """The radar's measurements, and x, y, z computed from them, in the sensor's axes.

    Fields of detections are read by name, because descriptions of their order in memory
    contradict each other.
    """
    if not isinstance(measurement, RadarScan):
        raise CaptureError("CARLA's library sent data that is not a radar scan")
    measured = np.array(
        [(d.velocity, d.azimuth, d.altitude, d.depth) for d in measurement],
        dtype=np.float64,
    ).reshape(-1, 4)
    velocity, azimuth, altitude, depth = measured.T
    table = np.empty(len(measured), RADAR)
    table["x"] = depth * np.cos(altitude) * np.cos(azimuth)
    table["y"] = depth * np.cos(altitude) * np.sin(azimuth)
    table["z"] = depth * np.sin(altitude)
    table["velocity"], table["azimuth"] = velocity, azimuth
    table["altitude"], table["depth"] = altitude, depth
    return table


def lidar_points(measurement: Measurement, row: np.dtype[np.void] = LIDAR) -> Table:
    """x, y, z in the sensor's axes, metres, and what else a `row` has.

    By default that is the intensity.
    """
    if not isinstance(measurement, PointCloud):
        raise CaptureError("CARLA's library sent data that is not a point cloud")
    return np.frombuffer(measurement.raw_data, row)


POINTS: Final[Mapping[str, Callable[[Measurement], Table]]] = {
    "lidar": lidar_points,
    "semantic_lidar": partial(lidar_points, row=SEMANTIC_LIDAR_POINT),
    "radar": radar_points,
}
"""How the sensors without images become tables."""
