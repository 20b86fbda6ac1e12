"""LiDAR and radar as binary PLY files, column by column as CARLA measures them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from unghost.capture.simulator import Measurement

Table = NDArray[np.void]

LIDAR: Final = np.dtype([(name, "<f4") for name in ("x", "y", "z", "intensity")])
SEMANTIC_LIDAR: Final = np.dtype(
    [
        ("x", "<f4"), ("y", "<f4"), ("z", "<f4"),
        ("CosAngle", "<f4"), ("ObjIdx", "<u4"), ("ObjTag", "<u4"),
    ]
)  # fmt: skip
RADAR: Final = np.dtype(
    [
        (name, "<f4")
        for name in ("x", "y", "z", "velocity", "azimuth", "altitude", "depth")
    ]
)
_PLY_NAMES: Final = {"f": "float", "u": "uint"}


def ply(table: Table) -> bytes:
    """A structured array as PLY 1.0, little-endian."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    header += [
        f"property {_PLY_NAMES[table.dtype[name].kind]} {name}"
        for name in table.dtype.names or ()
    ]
    return "\n".join([*header, "end_header", ""]).encode("ascii") + table.tobytes()


def lidar_points(measurement: Measurement) -> Table:
    """x, y, z in the sensor's axes, metres, and the intensity."""
    return np.frombuffer(measurement.raw_data, LIDAR)


def semantic_lidar_points(measurement: Measurement) -> Table:
    """x, y, z, the cosine of the incident angle, the object and its tag."""
    return np.frombuffer(measurement.raw_data, SEMANTIC_LIDAR)


def radar_points(measurement: Measurement) -> Table:
    """What the radar measured, and x, y, z computed from it, in the sensor's axes.

    The detections are asked for by name: descriptions of their order in memory
    disagree with each other.
    """
    measured = np.array(
        [(d.velocity, d.azimuth, d.altitude, d.depth) for d in measurement],
        dtype=np.float64,
    ).reshape(-1, 4)
    velocity, azimuth, altitude, depth = measured.T
    table = np.empty(len(measured), RADAR)
    table["x"] = depth * np.cos(altitude) * np.cos(azimuth)
    table["y"] = depth * np.cos(altitude) * np.sin(azimuth)
    table["z"] = depth * np.sin(altitude)
    columns = {"velocity": velocity, "azimuth": azimuth}
    for name, column in {**columns, "altitude": altitude, "depth": depth}.items():
        table[name] = column
    return table


POINTS: Final[Mapping[str, Callable[[Measurement], Table]]] = {
    "lidar": lidar_points,
    "semantic_lidar": semantic_lidar_points,
    "radar": radar_points,
}
