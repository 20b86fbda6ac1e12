"""Shapes of vehicles from a few measures: cars, vans, buses, trucks, two-wheelers.

All are centred at the origin, stand on the ground and head along x; metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from filter_core.arrays import FloatArray
from unghost.street.mesh import (
    Mesh,
    ball,
    block,
    blocks,
    join,
    loft,
    mirrored_columns,
    section,
    sheet,
    tube,
    wheel_ring,
)
from unghost.street.paint import (
    AMBER_LAMP,
    BLACK,
    CHROME,
    DARK_STEEL,
    GLASS,
    PLATE,
    RED_LAMP,
    RGB,
    RUBBER,
    STEEL,
    WHITE_LAMP,
    Paint,
    Tag,
)
from unghost.street.people import BodyPose, Clothes, Figure

_GROUND_CLEARANCE: Final = 0.19
_LAMP_HEIGHT: Final = 0.82


@dataclass(frozen=True)
class CarShape:
    """Measures of a car in metres.

    Attributes
    ----------
    length, width, height : overall
    belt : height of the window sills
    nose, tail : height of the bonnet's front edge and of the boot's rear edge
    bonnet, boot : how long they are
    windscreen, rear_glass : how far they lean, along the car
    wheel : radius
    """

    length: float
    width: float
    height: float
    belt: float
    nose: float
    tail: float
    bonnet: float
    boot: float
    windscreen: float
    rear_glass: float
    wheel: float = 0.33


SALOON: Final = CarShape(4.75, 1.84, 1.45, 0.95, 0.70, 0.90, 1.35, 0.75, 0.85, 0.75)
HATCH: Final = CarShape(4.05, 1.76, 1.47, 0.95, 0.70, 0.92, 1.05, 0.16, 0.80, 0.42)
MINI: Final = CarShape(3.80, 1.74, 1.42, 0.93, 0.74, 0.90, 1.05, 0.12, 0.55, 0.36)
COUPE: Final = CarShape(4.65, 1.90, 1.34, 0.92, 0.70, 0.92, 1.55, 0.55, 0.85, 0.95)
OFF_ROAD: Final = CarShape(
    4.55, 1.92, 1.82, 1.12, 0.98, 1.10, 1.25, 0.10, 0.42, 0.24, 0.39
)
ESTATE: Final = CarShape(
    4.70, 1.86, 1.58, 1.00, 0.76, 0.98, 1.20, 0.14, 0.78, 0.55, 0.35
)
SHAPES: Final[dict[str, CarShape]] = {
    "vehicle.audi.a2": HATCH,
    "vehicle.audi.etron": ESTATE,
    "vehicle.audi.tt": COUPE,
    "vehicle.citroen.c3": HATCH,
    "vehicle.dodge.charger_2020": SALOON,
    "vehicle.ford.mustang": COUPE,
    "vehicle.jeep.wrangler_rubicon": OFF_ROAD,
    "vehicle.lincoln.mkz_2020": SALOON,
    "vehicle.mercedes.coupe_2020": COUPE,
    "vehicle.mini.cooper_s_2021": MINI,
    "vehicle.nissan.micra": HATCH,
    "vehicle.nissan.patrol_2021": OFF_ROAD,
    "vehicle.seat.leon": HATCH,
    "vehicle.tesla.model3": SALOON,
    "vehicle.toyota.prius": ESTATE,
}


def car(shape: CarShape, rgb: tuple[float, float, float]) -> Mesh:
    """A car on the ground, centred at the origin, heading along x."""
    return _undyed(shape).dyed({1: rgb})


def far_car(shape: CarShape, rgb: tuple[float, float, float]) -> Mesh:
    """The same car without parts that are too small to be seen from afar."""
    return _undyed(shape, fine=False).dyed({1: rgb})


@lru_cache(maxsize=32)
def _undyed(shape: CarShape, *, fine: bool = True) -> Mesh:
    body = Paint.dye(1, gloss=0.055)
    axle = shape.length * 0.29
    running = Wheels(axle, -axle, shape.width / 2, shape.wheel, Tag.CAR)
    parts = [
        _lower_body(shape, body),
        _cabin(shape, body),
        _car_lamps(shape).both_sides(),
        running.mesh(fine=fine),
    ]
    if fine:
        parts += [
            _pillars(shape, body).both_sides(),
            _trim(shape, body).both_sides(),
            _ends(shape),
        ]
    return join(parts)


def _lower_body(shape: CarShape, body: Paint) -> Mesh:
    front, back, low = shape.length / 2, -shape.length / 2, _GROUND_CLEARANCE
    nose, tail, belt = shape.nose, shape.tail, shape.belt
    rise = belt - nose
    stations = [
        (front, 0.78, low + 0.16, nose * 0.80),
        (front - 0.05, 0.86, low + 0.06, nose * 0.92),
        (front - 0.16, 0.93, low, nose * 0.98),
        (front - 0.42, 0.98, low, nose + 0.25 * rise),
        (front - 0.9, 1.0, low, nose + 0.62 * rise),
        (front - shape.bonnet, 1.0, low - 0.02, belt),
        (0.0, 1.0, low - 0.02, belt + 0.01),
        (back + max(shape.boot, 0.35), 1.0, low, belt + 0.02),
        (back + 0.20, 0.97, low, tail + 0.02),
        (back + 0.06, 0.91, low + 0.06, tail - 0.01),
        (back, 0.84, low + 0.16, tail * 0.88),
    ]
    half_width = shape.width / 2
    rings = np.array(
        [section(x, _body_half(w * half_width, lo, hi)) for x, w, lo, hi in stations]
    )
    strips = mirrored_columns([BLACK, BLACK, body, body, body, body, body])
    return loft(rings, [strips], Tag.CAR)


def _body_half(width: float, low: float, high: float) -> FloatArray:
    tall = high - low
    return np.array(
        [
            (0.0, low),
            (0.80 * width, low),
            (0.955 * width, low + 0.10),
            (1.0 * width, low + 0.45 * tall),
            (0.985 * width, low + 0.72 * tall),
            (0.93 * width, high - 0.02),
            (0.70 * width, high + 0.015),
            (0.0, high + 0.03),
        ]
    )


def _cabin_stations(shape: CarShape) -> tuple[float, float, float, float]:
    base = shape.length / 2 - shape.bonnet
    rear = -shape.length / 2 + shape.boot
    return base, base - shape.windscreen, rear + shape.rear_glass, rear


def _cabin(shape: CarShape, body: Paint) -> Mesh:
    base, top, roof_end, rear = _cabin_stations(shape)
    wide, belt = shape.width / 2, shape.belt
    middle = (top + roof_end) / 2
    stations = [
        (base, belt),
        (top, shape.height - 0.045),
        (middle, shape.height - 0.03),
        (roof_end, shape.height - 0.06),
        (rear, belt + 0.01),
    ]
    rings = np.array(
        [section(x, _cabin_half(wide, belt, roof)) for x, roof in stations]
    )
    side = mirrored_columns([BLACK, GLASS, body, body])
    screen = mirrored_columns([BLACK, GLASS, GLASS, GLASS])
    return loft(rings, [screen, side, side, screen], Tag.CAR, caps=False)


def _cabin_half(wide: float, belt: float, roof: float) -> FloatArray:
    tall = roof - belt
    return np.array(
        [
            (0.0, belt - 0.06),
            (0.925 * wide, belt - 0.03),
            ((0.90 - 0.29 * tall) * wide, roof - 0.05 * (tall > 0.1)),
            ((0.80 - 0.29 * tall) * wide, roof),
            (0.0, roof + 0.05 * min(1.0, 4 * tall)),
        ]
    )


def _pillars(shape: CarShape, body: Paint) -> Mesh:
    base, top, roof_end, rear = _cabin_stations(shape)
    wide, belt, roof = shape.width / 2, shape.belt, shape.height - 0.06
    tall = roof - belt
    low_y, high_y = 0.905 * wide, (0.885 - 0.29 * tall) * wide
    middle = (base + rear) / 2 - 0.12
    bars = [
        ((base, low_y, belt), (top, high_y, roof), 0.035, body),
        ((top, high_y, roof), (roof_end, high_y, roof - 0.01), 0.035, body),
        ((roof_end, high_y, roof - 0.01), (rear, low_y, belt), 0.055, body),
        ((middle, low_y + 0.02, belt), (middle - 0.1, high_y, roof), 0.04, BLACK),
    ]
    return join(tube(a, b, radius, (paint, Tag.CAR), 6) for a, b, radius, paint in bars)


def _car_lamps(shape: CarShape) -> Mesh:
    wide, half = shape.width / 2, shape.length / 2
    head = ball(
        (half - 0.17, wide * 0.72, shape.nose * 0.86),
        (0.15, 0.21, 0.075),
        (WHITE_LAMP, Tag.CAR),
    )
    tail = ball(
        (-half + 0.09, wide * 0.78, shape.tail * 0.82),
        (0.12, 0.17, 0.085),
        (RED_LAMP, Tag.CAR),
    )
    return join([head, tail])


def _trim(shape: CarShape, body: Paint) -> Mesh:
    base, _, _, rear = _cabin_stations(shape)
    wide, belt, sill = shape.width / 2, shape.belt, 0.24 * shape.length
    middle, y = (base + rear) / 2 - 0.12, wide * 0.992
    mirror = (base - 0.22, wide + 0.07, belt + 0.06)
    seams = (base - 0.12, middle, max(rear + 0.15, middle - 0.95))
    handles = (middle + 0.08, middle - 0.72)
    high, low = belt - 0.17, belt - 0.20
    rows = [
        *(((x, y - 0.03, 0.34), (x + 0.014, y + 0.007, belt - 0.12), BLACK)
          for x in seams),
        *(((x, y - 0.03, low), (x + 0.2, y + 0.02, high), CHROME) for x in handles),
        ((-sill, y - 0.08, 0.20), (sill, y + 0.002, 0.27), DARK_STEEL),
    ]  # fmt: skip
    ears = ball(mirror, (0.08, 0.10, 0.075), (body, Tag.CAR), 8)
    return join([ears, blocks(rows, Tag.CAR)])


def _ends(shape: CarShape) -> Mesh:
    """Grille, air intake, number plates and rear bumper."""
    half, wide = shape.length / 2, shape.width / 2
    low, nose = _GROUND_CLEARANCE, shape.nose
    grille, intake, bumper = 0.45 * wide, 0.62 * wide, 0.66 * wide
    rows = [
        (
            (half - 0.2, -grille, nose * 0.62),
            (half + 0.008, grille, nose * 0.76),
            BLACK,
        ),
        ((half - 0.2, -intake, low + 0.12), (half - 0.005, intake, low + 0.24), BLACK),
        ((half, -0.26, nose * 0.47), (half + 0.016, 0.26, nose * 0.60), PLATE),
        ((-half - 0.016, -0.26, 0.58), (-half + 0.02, 0.26, 0.69), PLATE),
        ((-half - 0.01, -bumper, low + 0.10), (-half + 0.2, bumper, low + 0.24), BLACK),
    ]
    return blocks(rows, Tag.CAR)


@dataclass(frozen=True)
class Shell:
    """A big body with upright sides, in metres: from `back` to `front` along x.

    `sill` is the height of the windows' lower edge.
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
    band = Paint(stripe or (40, 42, 46), gloss=0.05)
    high = 1.00 if stripe else 0.84
    parts = [
        _bonneted(shell, body, tag),
        Wheels(1.85, -1.85, 0.99, 0.36, tag).mesh(),
        _corner_lamps(shell, tag),
        block((-2.8, 0.99, 0.78), (1.9, 1.006, high), band, tag).both_sides(),
    ]
    if stripe is not None:
        badge = block((-1.9, 1.0, 1.25), (-1.2, 1.012, 1.45), band, tag)
        parts.append(block((0.75, -0.7, 2.54), (1.05, 0.7, 2.70), RED_LAMP, tag))
        parts.append(badge.both_sides())
    return join([*parts, _mirrors(shell, tag)])


def bus(rgb: RGB) -> Mesh:
    """A city bus with a band of windows."""
    body, tag = Paint(rgb, gloss=0.05), Tag.BUS
    shell = Shell(5.1, -5.1, 1.25, 0.34, 3.05, 1.25, 0.25)
    cells = np.linspace(shell.back + 0.15, shell.front - 1.15, 7)
    half = _shell_half(shell, shell.roof)
    stations = [shell.back, *cells, shell.front - 0.45, shell.front]
    rings = np.array([section(x, half) for x in stations])
    rings[-1, :, 1] *= 0.97
    glazed = mirrored_columns([BLACK, body, GLASS, body, body, body])
    closed = mirrored_columns([BLACK, body, body, body, body, body])
    posts = [
        block((x - 0.05, 1.2, shell.sill), (x + 0.05, 1.256, 2.45), BLACK, tag)
        for x in cells
    ]
    windows = [
        ((5.05, -1.12, 1.15), (5.112, 1.12, 2.55), GLASS),
        ((5.05, -0.8, 2.62), (5.118, 0.8, 2.90), AMBER_LAMP),
        ((-5.112, -0.9, 1.6), (-5.05, 0.9, 2.4), GLASS),
        ((3.75, 1.24, 0.42), (4.75, 1.262, 2.45), GLASS),
    ]
    skirt = block((-4.9, 1.245, 0.34), (4.9, 1.26, 0.58), Paint((60, 62, 66)), tag)
    return join(
        [
            loft(rings, [closed, *[glazed] * (len(stations) - 3), closed], tag),
            *(post.both_sides() for post in posts),
            blocks(windows, tag),
            skirt.both_sides(),
            block((-2.6, -0.8, 3.04), (-0.6, 0.8, 3.24), Paint((210, 210, 206)), tag),
            Wheels(3.0, -2.7, 1.25, 0.47, tag).mesh(),
            _corner_lamps(shell, tag),
            _mirrors(shell, tag),
        ]
    )


def truck(rgb: RGB, cargo: RGB) -> Mesh:
    """A rigid truck: a cab, a chassis and a box."""
    body, tag = Paint(rgb, gloss=0.05), Tag.TRUCK
    cab = Shell(3.9, 1.75, 1.2, 0.55, 2.75, 1.55, 0.22)
    box = [
        ((-3.9, -1.24, 1.08), (1.55, 1.24, 3.45), Paint(cargo, gloss=0.03)),
        ((-3.92, -1.26, 3.38), (1.57, 1.26, 3.48), STEEL),
        ((-3.92, -1.26, 1.02), (1.57, 1.26, 1.14), DARK_STEEL),
        ((-3.8, -0.45, 0.62), (3.5, 0.45, 1.02), DARK_STEEL),
        ((-3.95, -1.1, 0.55), (-3.8, 1.1, 0.72), BLACK),
    ]
    lamp = block((-3.97, -1.15, 0.74), (-3.9, -0.75, 0.9), RED_LAMP, tag)
    tank = tube((0.9, 0.75, 0.78), (0.0, 0.75, 0.78), 0.28, (CHROME, tag), 10)
    return join(
        [
            _cab(cab, body, tag),
            blocks(box, tag),
            lamp.both_sides(),
            block((-3.93, -0.02, 1.15), (-3.91, 0.02, 3.38), STEEL, tag),
            tank.both_sides(),
            Wheels(2.85, -2.2, 1.2, 0.5, tag).mesh(),
            _corner_lamps(cab, tag),
            _mirrors(cab, tag),
        ]
    )


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
    """The skin of a van: a short bonnet, a leaning windscreen, a long box."""
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
    half, front = _shell_half(shell, shell.roof), shell.front
    rings = np.array([section(x, half) for x in (shell.back, front - 0.35, front)])
    rings[-1, 5:8, 0] -= shell.slope
    skin = loft(rings, [mirrored_columns([BLACK, body, body, body, body, body])], tag)
    windscreen_and_grille = [
        ((front - 0.3, -1.08, 1.6), (front + 0.012, 1.08, 2.4), GLASS),
        ((front - 0.3, -0.8, 0.95), (front + 0.015, 0.8, 1.35), BLACK),
    ]
    window = block((2.2, 1.15, 1.6), (3.3, 1.204, 2.3), GLASS, tag)
    bumper_and_spoiler = [
        ((front - 0.2, -1.15, 0.5), (front + 0.06, 1.15, 0.78), DARK_STEEL),
        ((1.7, -1.0, 2.7), (2.6, 1.0, 3.25), body),
    ]
    return join(
        [
            skin,
            blocks(windscreen_and_grille, tag),
            window.both_sides(),
            blocks(bumper_and_spoiler, tag),
        ]
    )


def _corner_lamps(shell: Shell, tag: int) -> Mesh:
    front, back, wide, z = shell.front, shell.back, shell.half_width, _LAMP_HEIGHT
    head = ball(
        (front - 0.06, wide * 0.74, z), (0.10, 0.20, 0.12), (WHITE_LAMP, tag), 8
    )
    low, high = (back - 0.015, wide * 0.82, z), (back + 0.1, wide * 0.97, z + 0.45)
    tail = block(low, high, RED_LAMP, tag)
    plate = block((front, -0.26, 0.5), (front + 0.02, 0.26, 0.61), PLATE, tag)
    return join([head.both_sides(), tail.both_sides(), plate])


def _mirrors(shell: Shell, tag: int) -> Mesh:
    x = shell.front - 1.0 * (shell.slope > 0.5) - 0.15
    y, z = shell.half_width + 0.16, shell.sill + 0.35
    low, high = (x - 0.06, y - 0.1, z - 0.18), (x + 0.06, y + 0.08, z + 0.18)
    return block(low, high, BLACK, tag).both_sides()


@dataclass(frozen=True)
class Wheels:
    """Four wheels; metres.

    Attributes
    ----------
    front, rear : x of the axles
    half_width : y of the wheels' outer sides
    radius : of the tyres
    tag : of the vehicle
    """

    front: float
    rear: float
    half_width: float
    radius: float
    tag: int

    def mesh(self, *, fine: bool = True) -> Mesh:
        """The wheels in their dark arches; from afar, without hubs and spokes."""
        build = _wheel if fine else _far_wheel
        right = [build(self, x) for x in (self.front, self.rear)]
        return join(right).both_sides()


def _far_wheel(wheels: Wheels, x: float) -> Mesh:
    y, z, tag = wheels.half_width, wheels.radius, wheels.tag
    inner = (x, y - 0.2, z)
    tyre = tube(inner, (x, y + 0.012, z), wheels.radius, (RUBBER, tag), sides=10)
    rim = tube(inner, (x, y + 0.016, z), wheels.radius * 0.66, (STEEL, tag), sides=6)
    return join([tyre, rim])


def _wheel(wheels: Wheels, x: float) -> Mesh:
    y, radius, tag = wheels.half_width, wheels.radius, wheels.tag
    z = radius
    arch = tube(
        (x, y - 0.25, z), (x, y + 0.004, z), radius * 1.15, (BLACK, tag), sides=20
    )
    tyre = tube((x, y - 0.22, z), (x, y + 0.012, z), radius, (RUBBER, tag), sides=20)
    rim = tube((x, y, z), (x, y + 0.016, z), radius * 0.68, (STEEL, tag), sides=14)
    hub = tube((x, y, z), (x, y + 0.024, z), radius * 0.16, (CHROME, tag), sides=8)
    reach, centre = radius * np.array([0.60, 0.22, 0.22, 0.60]), (x, y + 0.020, z)
    gaps = []
    for turn in range(5):
        angles = 2 * np.pi * turn / 5 + 0.3 + np.array([-0.38, -0.24, 0.24, 0.38])
        flat = [np.cos(angles) * reach, np.zeros(4), np.sin(angles) * reach]
        corners = np.stack(flat, axis=1) + np.array(centre)
        gaps.append(sheet(corners, (0, 1, 0), BLACK, tag))
    return join([arch, tyre, rim, hub, *gaps])


_CYCLIST: Final = BodyPose(
    hips=(-0.22, 0.0, 0.98), shoulders=(0.13, 0.0, 1.40), head=(0.26, 0.0, 1.60),
    knees=((0.16, 0.11, 0.72), (0.10, -0.11, 0.58)),
    feet=((0.02, 0.11, 0.42), (-0.06, -0.11, 0.20)),
    elbows=((0.26, 0.27, 1.17), (0.26, -0.27, 1.17)),
    hands=((0.46, 0.25, 1.05), (0.46, -0.25, 1.05)),
)  # fmt: skip
_BIKER: Final = BodyPose(
    hips=(-0.28, 0.0, 0.90), shoulders=(-0.02, 0.0, 1.36), head=(0.08, 0.0, 1.58),
    knees=((0.16, 0.20, 0.76), (0.16, -0.20, 0.76)),
    feet=((-0.06, 0.20, 0.38), (-0.06, -0.20, 0.38)),
    elbows=((0.18, 0.32, 1.12), (0.18, -0.32, 1.12)),
    hands=((0.44, 0.30, 1.03), (0.44, -0.30, 1.03)),
)  # fmt: skip


def bicycle(rgb: RGB, clothes: Clothes) -> Mesh:
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
        [*parts, clothes.on(Figure(_CYCLIST, Tag.RIDER).mesh()), _helmet(_CYCLIST, rgb)]
    )


def motorcycle(rgb: RGB, clothes: Clothes) -> Mesh:
    """A motorcycle heading along x, its rider included."""
    tag = Tag.MOTORCYCLE
    body = Paint(rgb, gloss=0.07)
    rounded = [
        ((0.10, 0, 0.82), (0.28, 0.14, 0.13), body, 10),
        ((-0.30, 0, 0.80), (0.34, 0.13, 0.07), BLACK, 10),
        ((-0.66, 0, 0.82), (0.18, 0.09, 0.07), body, 10),
        ((0.45, 0, 0.88), (0.14, 0.15, 0.17), body, 10),
        ((0.57, 0, 0.90), (0.05, 0.09, 0.08), WHITE_LAMP, 8),
        ((-0.84, 0, 0.80), (0.04, 0.08, 0.04), RED_LAMP, 8),
    ]
    fork = tube((0.72, 0.09, 0.31), (0.46, 0.09, 0.98), 0.03, (CHROME, tag), 6)
    swing = tube((-0.68, 0.09, 0.31), (-0.10, 0.09, 0.42), 0.03, (STEEL, tag), 6)
    rider = replace(clothes, hair=rgb)
    return join(
        [
            *(
                wheel
                for x in (0.72, -0.68)
                for wheel in (
                    wheel_ring((x, 0.0, 0.31), 0.31, 0.065, (RUBBER, tag)),
                    tube((x, -0.03, 0.31), (x, 0.03, 0.31), 0.19, (STEEL, tag), 14),
                )
            ),
            *(ball(at, radii, (paint, tag), n) for at, radii, paint, n in rounded),
            block((-0.22, -0.16, 0.26), (0.28, 0.16, 0.66), DARK_STEEL, tag),
            tube((-0.72, 0.17, 0.34), (0.05, 0.15, 0.30), 0.05, (CHROME, tag), 8),
            tube((0.42, -0.34, 1.02), (0.42, 0.34, 1.02), 0.020, (BLACK, tag), 6),
            ball((0.74, 0, 0.58), (0.26, 0.07, 0.09), (body, tag)),
            fork.both_sides(),
            swing.both_sides(),
            rider.on(Figure(_BIKER, Tag.RIDER).mesh()),
            _helmet(_BIKER, rgb, full=True),
        ]
    )


def _spokes(hub: tuple[float, float, float], tag: int) -> Mesh:
    x, y, z = hub
    ends = [(0.33 * np.cos(a), 0.33 * np.sin(a)) for a in np.pi * np.arange(4) / 4]
    return join(
        tube((x - dx, y, z - dz), (x + dx, y, z + dz), 0.004, (STEEL, tag), 3)
        for dx, dz in ends
    )


def _helmet(pose: BodyPose, rgb: RGB, *, full: bool = False) -> Mesh:
    x, y, z = pose.head
    if full:
        return ball(
            (x, y, z + 0.01), (0.145, 0.125, 0.145), (Paint(rgb, 0.08), Tag.RIDER), 12
        )
    return ball(
        (x - 0.01, y, z + 0.06), (0.13, 0.10, 0.085), (Paint(rgb, 0.05), Tag.RIDER)
    )
