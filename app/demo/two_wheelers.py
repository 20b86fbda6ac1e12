"""Bicycles and motorcycles with their riders."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from app.demo.mesh import Mesh, join
from app.demo.paint import (
    BLACK,
    CHROME,
    DARK_STEEL,
    RED_LAMP,
    RUBBER,
    STEEL,
    WHITE_LAMP,
    Paint,
    Tag,
)
from app.demo.people import Dress, Figure, Pose
from app.demo.solids import ball, block, tube, wheel_ring

RGB = tuple[float, float, float]

_CYCLIST: Final = Pose(
    hips=(-0.22, 0.0, 0.98), shoulders=(0.13, 0.0, 1.40), head=(0.26, 0.0, 1.60),
    knees=((0.16, 0.11, 0.72), (0.10, -0.11, 0.58)),
    feet=((0.02, 0.11, 0.42), (-0.06, -0.11, 0.20)),
    elbows=((0.26, 0.27, 1.17), (0.26, -0.27, 1.17)),
    hands=((0.46, 0.25, 1.05), (0.46, -0.25, 1.05)),
)  # fmt: skip
_BIKER: Final = Pose(
    hips=(-0.28, 0.0, 0.90), shoulders=(-0.02, 0.0, 1.36), head=(0.08, 0.0, 1.58),
    knees=((0.16, 0.20, 0.76), (0.16, -0.20, 0.76)),
    feet=((-0.06, 0.20, 0.38), (-0.06, -0.20, 0.38)),
    elbows=((0.18, 0.32, 1.12), (0.18, -0.32, 1.12)),
    hands=((0.44, 0.30, 1.03), (0.44, -0.30, 1.03)),
)  # fmt: skip


def bicycle(rgb: RGB, dress: Dress) -> Mesh:
    """A bicycle heading along x, its rider included."""
    tag = Tag.BICYCLE
    frame = Paint(rgb, gloss=0.05)
    hub_f, hub_r, crank = (0.54, 0, 0.35), (-0.52, 0, 0.35), (-0.06, 0, 0.30)
    head, seat = (0.40, 0, 0.86), (-0.20, 0, 0.90)
    bars = [
        (hub_f, head, 0.020), (head, crank, 0.022), (crank, seat, 0.020),
        (seat, (0.36, 0, 0.74), 0.020), (hub_r, crank, 0.016), (hub_r, seat, 0.014),
    ]  # fmt: skip
    parts = [tube(a, b, thick, (frame, tag), 6) for a, b, thick in bars]
    parts += [wheel_ring(hub, 0.35, 0.024, (RUBBER, tag)) for hub in (hub_f, hub_r)]
    parts += [_spokes(hub, tag) for hub in (hub_f, hub_r)]
    parts += [
        tube((0.44, -0.27, 1.02), (0.44, 0.27, 1.02), 0.016, (BLACK, tag), 6),
        tube(head, (0.44, 0, 1.02), 0.018, (CHROME, tag), 6),
        ball((-0.23, 0, 0.93), (0.13, 0.07, 0.035), (BLACK, tag), 8),
        tube((0.02, 0.11, 0.38), (-0.06, -0.11, 0.18), 0.014, (DARK_STEEL, tag), 6),
    ]
    return join(
        [*parts, dress.on(Figure(_CYCLIST, Tag.RIDER).mesh()), _helmet(_CYCLIST, rgb)]
    )


def motorcycle(rgb: RGB, dress: Dress) -> Mesh:
    """A motorcycle heading along x, its rider included."""
    tag = Tag.MOTORCYCLE
    body = Paint(rgb, gloss=0.07)
    parts = [_motor_wheel((x, 0.0, 0.31), tag) for x in (0.72, -0.68)]
    parts += [
        ball((0.10, 0, 0.82), (0.28, 0.14, 0.13), (body, tag)),
        ball((-0.30, 0, 0.80), (0.34, 0.13, 0.07), (BLACK, tag)),
        ball((-0.66, 0, 0.82), (0.18, 0.09, 0.07), (body, tag)),
        ball((0.45, 0, 0.88), (0.14, 0.15, 0.17), (body, tag)),
        ball((0.57, 0, 0.90), (0.05, 0.09, 0.08), (WHITE_LAMP, tag), 8),
        ball((-0.84, 0, 0.80), (0.04, 0.08, 0.04), (RED_LAMP, tag), 8),
        block((-0.22, -0.16, 0.26), (0.28, 0.16, 0.66), DARK_STEEL, tag),
        tube((-0.72, 0.17, 0.34), (0.05, 0.15, 0.30), 0.05, (CHROME, tag), 8),
        tube((0.42, -0.34, 1.02), (0.42, 0.34, 1.02), 0.020, (BLACK, tag), 6),
        ball((0.74, 0, 0.58), (0.26, 0.07, 0.09), (body, tag)),
    ]
    fork = tube((0.72, 0.09, 0.31), (0.46, 0.09, 0.98), 0.03, (CHROME, tag), 6)
    swing = tube((-0.68, 0.09, 0.31), (-0.10, 0.09, 0.42), 0.03, (STEEL, tag), 6)
    rider = replace(dress, hair=rgb)
    parts += [
        fork.both_sides(),
        swing.both_sides(),
        rider.on(Figure(_BIKER, Tag.RIDER).mesh()),
    ]
    return join([*parts, _helmet(_BIKER, rgb, full=True)])


def _motor_wheel(hub: tuple[float, float, float], tag: int) -> Mesh:
    x, y, z = hub
    disc = tube((x, y - 0.03, z), (x, y + 0.03, z), 0.19, (STEEL, tag), 14)
    return join([wheel_ring(hub, 0.31, 0.065, (RUBBER, tag)), disc])


def _spokes(hub: tuple[float, float, float], tag: int) -> Mesh:
    x, y, z = hub
    ends = [(0.33 * np.cos(a), 0.33 * np.sin(a)) for a in np.pi * np.arange(4) / 4]
    return join(
        tube((x - dx, y, z - dz), (x + dx, y, z + dz), 0.004, (STEEL, tag), 3)
        for dx, dz in ends
    )


def _helmet(pose: Pose, rgb: RGB, *, full: bool = False) -> Mesh:
    x, y, z = pose.head
    if full:
        return ball(
            (x, y, z + 0.01), (0.145, 0.125, 0.145), (Paint(rgb, 0.08), Tag.RIDER), 12
        )
    return ball(
        (x - 0.01, y, z + 0.06), (0.13, 0.10, 0.085), (Paint(rgb, 0.05), Tag.RIDER)
    )
