"""Passenger cars, each shaped by a few measures of its blueprint."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from app.demo.mesh import Mesh, join
from app.demo.paint import (
    BLACK,
    CHROME,
    DARK_STEEL,
    GLASS,
    PLATE,
    RED_LAMP,
    WHITE_LAMP,
    Paint,
    Tag,
)
from app.demo.skins import mirrored_columns, section
from app.demo.solids import ball, block, loft, tube
from app.demo.wheels import Wheels
from filter_core.types import FloatArray


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

_GROUND_CLEARANCE: Final = 0.19


def car(shape: CarShape, rgb: tuple[float, float, float]) -> Mesh:
    """A car on the ground, centred at the origin, heading along x."""
    return _undyed(shape).dyed({1: rgb})


def far_car(shape: CarShape, rgb: tuple[float, float, float]) -> Mesh:
    """The same car without what is too small to be seen from afar."""
    return _undyed(shape, fine=False).dyed({1: rgb})


@lru_cache(maxsize=32)
def _undyed(shape: CarShape, *, fine: bool = True) -> Mesh:
    body = Paint.dye(1, gloss=0.055)
    axle = shape.length * 0.29
    running = Wheels(axle, -axle, shape.width / 2, shape.wheel, Tag.CAR)
    parts = [
        _lower_body(shape, body),
        _cabin(shape, body),
        _lamps(shape).both_sides(),
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


def _lamps(shape: CarShape) -> Mesh:
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
    wide, belt = shape.width / 2, shape.belt
    middle, y = (base + rear) / 2 - 0.12, wide * 0.992
    mirror = ball(
        (base - 0.22, wide + 0.07, belt + 0.06), (0.08, 0.10, 0.075), (body, Tag.CAR), 8
    )
    seams = [
        block((x, y - 0.03, 0.34), (x + 0.014, y + 0.007, belt - 0.12), BLACK, Tag.CAR)
        for x in (base - 0.12, middle, max(rear + 0.15, middle - 0.95))
    ]
    handles = [
        block(
            (x, y - 0.03, belt - 0.20),
            (x + 0.2, y + 0.02, belt - 0.17),
            CHROME,
            Tag.CAR,
        )
        for x in (middle + 0.08, middle - 0.72)
    ]
    sill = block(
        (-0.24 * shape.length, y - 0.08, 0.20),
        (0.24 * shape.length, y + 0.002, 0.27),
        DARK_STEEL,
        Tag.CAR,
    )
    return join([mirror, *seams, *handles, sill])


def _ends(shape: CarShape) -> Mesh:
    half, wide = shape.length / 2, shape.width / 2
    low, nose = _GROUND_CLEARANCE, shape.nose
    grille = block(
        (half - 0.2, -0.45 * wide, nose * 0.62),
        (half + 0.008, 0.45 * wide, nose * 0.76),
        BLACK,
        Tag.CAR,
    )
    intake = block(
        (half - 0.2, -0.62 * wide, low + 0.12),
        (half - 0.005, 0.62 * wide, low + 0.24),
        BLACK,
        Tag.CAR,
    )
    front = block(
        (half, -0.26, nose * 0.47), (half + 0.016, 0.26, nose * 0.60), PLATE, Tag.CAR
    )
    rear = block(
        (-half - 0.016, -0.26, 0.58), (-half + 0.02, 0.26, 0.69), PLATE, Tag.CAR
    )
    bumper = block(
        (-half - 0.01, -0.66 * wide, low + 0.10),
        (-half + 0.2, 0.66 * wide, low + 0.24),
        BLACK,
        Tag.CAR,
    )
    return join([grille, intake, front, rear, bumper])
