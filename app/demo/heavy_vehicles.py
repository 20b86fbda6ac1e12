"""Vans, buses and trucks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from app.demo.mesh import Mesh, join
from app.demo.paint import (
    AMBER_LAMP,
    BLACK,
    CHROME,
    DARK_STEEL,
    GLASS,
    PLATE,
    RED_LAMP,
    STEEL,
    WHITE_LAMP,
    Paint,
    Tag,
)
from app.demo.skins import mirrored_columns, section
from app.demo.solids import ball, block, loft, tube
from app.demo.wheels import Wheels
from filter_core.types import FloatArray

RGB = tuple[float, float, float]


@dataclass(frozen=True)
class Shell:
    """A big body with upright sides.

    Attributes
    ----------
    front, back : where it begins and ends along x, metres
    half_width, low, roof : metres
    sill : height of the windows' lower edge
    """

    front: float
    back: float
    half_width: float
    low: float
    roof: float
    sill: float
    slope: float
    """How far the windscreen leans back."""


def van(rgb: RGB, *, stripe: RGB | None = None) -> Mesh:
    """A high panel van, with a coloured stripe if it is an ambulance."""
    body, tag = Paint(rgb, gloss=0.05), Tag.TRUCK
    shell = Shell(2.95, -2.95, 1.0, 0.32, 2.55, 1.35, 0.95)
    parts = [
        _bonneted(shell, body, tag),
        Wheels(1.85, -1.85, 0.99, 0.36, tag).mesh(),
        _lamps(shell, tag),
    ]
    band = Paint(stripe or (40, 42, 46), gloss=0.05)
    parts.append(
        block(
            (-2.8, 0.99, 0.78), (1.9, 1.006, 1.00 if stripe else 0.84), band, tag
        ).both_sides()
    )
    if stripe is not None:
        parts.append(block((0.75, -0.7, 2.54), (1.05, 0.7, 2.70), RED_LAMP, tag))
        parts.append(
            block((-1.9, 1.0, 1.25), (-1.2, 1.012, 1.45), band, tag).both_sides()
        )
    return join([*parts, *_mirrors(shell, tag)])


def bus(rgb: RGB) -> Mesh:
    """A city bus with a band of windows."""
    body, tag = Paint(rgb, gloss=0.05), Tag.BUS
    shell = Shell(5.1, -5.1, 1.25, 0.34, 3.05, 1.25, 0.25)
    cells = np.linspace(shell.back + 0.15, shell.front - 1.15, 7)
    half = [_shell_half(shell, shell.roof)]
    stations = [shell.back, *cells, shell.front - 0.45, shell.front]
    rings = np.array([section(x, half[0]) for x in stations])
    rings[-1, :, 1] *= 0.97
    glazed = mirrored_columns([BLACK, body, GLASS, body, body, body])
    closed = mirrored_columns([BLACK, body, body, body, body, body])
    skin = loft(rings, [closed, *[glazed] * (len(stations) - 3), closed], tag)
    posts = [
        block(
            (x - 0.05, 1.2, shell.sill), (x + 0.05, 1.256, 2.45), BLACK, tag
        ).both_sides()
        for x in cells
    ]
    front = block((5.05, -1.12, 1.15), (5.112, 1.12, 2.55), GLASS, tag)
    sign = block((5.05, -0.8, 2.62), (5.118, 0.8, 2.90), AMBER_LAMP, tag)
    rear = block((-5.112, -0.9, 1.6), (-5.05, 0.9, 2.4), GLASS, tag)
    door = block((3.75, 1.24, 0.42), (4.75, 1.262, 2.45), GLASS, tag)
    skirt = block(
        (-4.9, 1.245, 0.34), (4.9, 1.26, 0.58), Paint((60, 62, 66)), tag
    ).both_sides()
    units = block((-2.6, -0.8, 3.04), (-0.6, 0.8, 3.24), Paint((210, 210, 206)), tag)
    wheel = Wheels(3.0, -2.7, 1.25, 0.47, tag).mesh()
    parts = [
        skin,
        *posts,
        front,
        sign,
        rear,
        door,
        skirt,
        units,
        wheel,
        _lamps(shell, tag),
    ]
    return join([*parts, *_mirrors(shell, tag)])


def truck(rgb: RGB, cargo: RGB) -> Mesh:
    """A rigid truck: a cab, a chassis and a box."""
    body, tag = Paint(rgb, gloss=0.05), Tag.TRUCK
    cab = Shell(3.9, 1.75, 1.2, 0.55, 2.75, 1.55, 0.22)
    load = Paint(cargo, gloss=0.03)
    parts = [
        _cab(cab, body, tag),
        block((-3.9, -1.24, 1.08), (1.55, 1.24, 3.45), load, tag),
        block((-3.92, -1.26, 3.38), (1.57, 1.26, 3.48), STEEL, tag),
        block((-3.92, -1.26, 1.02), (1.57, 1.26, 1.14), DARK_STEEL, tag),
        block((-3.8, -0.45, 0.62), (3.5, 0.45, 1.02), DARK_STEEL, tag),
        block((-3.95, -1.1, 0.55), (-3.8, 1.1, 0.72), BLACK, tag),
        block((-3.97, -1.15, 0.74), (-3.9, -0.75, 0.9), RED_LAMP, tag).both_sides(),
        block((-3.93, -0.02, 1.15), (-3.91, 0.02, 3.38), STEEL, tag),
        tube(
            (0.9, 0.75, 0.78), (0.0, 0.75, 0.78), 0.28, (CHROME, tag), 10
        ).both_sides(),
        Wheels(2.85, -2.2, 1.2, 0.5, tag).mesh(),
    ]
    return join([*parts, _lamps(cab, tag), *_mirrors(cab, tag)])


def _shell_half(shell: Shell, roof: float) -> FloatArray:
    wide, low, sill = shell.half_width, shell.low, shell.sill
    top = max(roof - 0.55, sill + 0.02)
    return np.array(
        [
            (0.0, low), (0.97 * wide, low), (wide, sill), (0.985 * wide, top),
            (0.95 * wide, roof - 0.12), (0.80 * wide, roof - 0.015), (0.0, roof + 0.02),
        ]
    )  # fmt: skip


def _bonneted(shell: Shell, body: Paint, tag: int) -> Mesh:
    """A van's skin: a short bonnet, a leaning windscreen, a long box."""
    cowl = shell.front - 0.85
    stations = [
        (shell.front, 1.02),
        (shell.front - 0.10, 1.12),
        (cowl, 1.36),
        (cowl - shell.slope * 0.85, 2.42),
        (cowl - 1.35, shell.roof),
        (cowl - 2.0, shell.roof),
        (shell.back + 0.08, shell.roof),
        (shell.back, shell.roof - 0.06),
    ]
    rings = []
    for x, roof in stations:
        half = _shell_half(shell, roof)
        half[2:, 1] = np.minimum(half[2:, 1], roof)
        rings.append(
            section(x, half * ([0.92, 1.0] if x == shell.front else [1.0, 1.0]))
        )
    plain = mirrored_columns([BLACK, body, body, body, body, body])
    screen = mirrored_columns([BLACK, body, body, GLASS, GLASS, GLASS])
    skin = loft(
        np.array(rings), [plain, plain, screen, plain, plain, plain, plain], tag
    )
    window = block((0.35, 0.98, 1.42), (1.35, 1.004, 2.02), GLASS, tag).both_sides()
    rear = block(
        (shell.back - 0.01, 0.1, 1.5), (shell.back + 0.1, 0.8, 2.1), GLASS, tag
    )
    return join([skin, window, rear.both_sides()])


def _cab(shell: Shell, body: Paint, tag: int) -> Mesh:
    half = _shell_half(shell, shell.roof)
    stations = [shell.back, shell.front - 0.35, shell.front]
    rings = np.array([section(x, half) for x in stations])
    rings[-1, 5:8, 0] -= shell.slope
    skin = loft(rings, [mirrored_columns([BLACK, body, body, body, body, body])], tag)
    front = shell.front
    return join(
        [
            skin,
            block((front - 0.3, -1.08, 1.6), (front + 0.012, 1.08, 2.4), GLASS, tag),
            block((front - 0.3, -0.8, 0.95), (front + 0.015, 0.8, 1.35), BLACK, tag),
            block((2.2, 1.15, 1.6), (3.3, 1.204, 2.3), GLASS, tag).both_sides(),
            block(
                (front - 0.2, -1.15, 0.5), (front + 0.06, 1.15, 0.78), DARK_STEEL, tag
            ),
            block((1.7, -1.0, 2.7), (2.6, 1.0, 3.25), body, tag),
        ]
    )


_LAMP_HEIGHT: Final = 0.82


def _lamps(shell: Shell, tag: int) -> Mesh:
    wide, z = shell.half_width, _LAMP_HEIGHT
    head = ball(
        (shell.front - 0.06, wide * 0.74, z), (0.10, 0.20, 0.12), (WHITE_LAMP, tag), 8
    )
    tail = block(
        (shell.back - 0.015, wide * 0.82, z),
        (shell.back + 0.1, wide * 0.97, z + 0.45),
        RED_LAMP,
        tag,
    )
    plate = block(
        (shell.front, -0.26, 0.5), (shell.front + 0.02, 0.26, 0.61), PLATE, tag
    )
    return join([head.both_sides(), tail.both_sides(), plate])


def _mirrors(shell: Shell, tag: int) -> list[Mesh]:
    x, y, z = (
        shell.front - 1.0 * (shell.slope > 0.5) - 0.15,
        shell.half_width + 0.16,
        shell.sill + 0.35,
    )
    glass = block(
        (x - 0.06, y - 0.1, z - 0.18), (x + 0.06, y + 0.08, z + 0.18), BLACK, tag
    )
    return [glass.both_sides()]
