"""Cars and people who stay where they are, many of them out of sight."""

from __future__ import annotations

import itertools

import numpy as np

from app.demo.fleet import new_car, new_heavy, new_walker
from app.demo.ground import PARKING, SIDEWALK_HEIGHT
from app.demo.town import BACK_ROW, TownBuilder
from filter_core.geometry.pose import Transform


def park_in_lot(
    builder: TownBuilder, x_range: tuple[float, float], side: int, rows: int
) -> None:
    """Rows of cars in an open lot, nose to the street, and someone between them."""
    rng = builder.rng
    for row in range(rows):
        y = side * (builder.plan.frontage + 4.6 + 6.0 * row)
        for x in np.arange(x_range[0] + 1.4, x_range[1] - 1.2, 2.9):
            if rng.random() < 0.28:
                continue
            yaw = (
                side * 90.0
                + (180.0 if rng.random() < 0.5 else 0.0)
                + float(rng.normal(0, 1.5))
            )
            start = Transform((float(x), y, SIDEWALK_HEIGHT), (0.0, yaw, 0.0))
            builder.put(new_car(rng, start))
    x = float(rng.uniform(x_range[0] + 1, x_range[1] - 1))
    _stand(builder, x, side * (builder.plan.frontage + 1.9))


def park_along_kerbs(builder: TownBuilder) -> None:
    """Parked cars and a few vans, heading with their side's traffic."""
    rng, plan = builder.rng, builder.plan
    for start, end in builder.stretches():
        for side in (1, -1):
            y = side * (plan.lanes_edge + PARKING / 2 - 0.05)
            for x in np.arange(start + 12.0, end - 11.0, 6.4):
                if rng.random() > builder.style.parked:
                    continue
                yaw = (0.0 if side > 0 else 180.0) + float(rng.normal(0, 1.0))
                at = Transform(
                    (float(x + rng.uniform(-0.4, 0.4)), y, 0.0), (0.0, yaw, 0.0)
                )
                dice = rng.random()
                if dice < 0.10:
                    builder.put(new_heavy("sprinter", rng, at))
                else:
                    builder.put(new_car(rng, at))


def park_behind_houses(builder: TownBuilder) -> None:
    """Cars, vans and people behind the first row of houses, where nobody sees them."""
    rng, plan = builder.rng, builder.plan
    heavy = itertools.cycle(("bus", "sprinter", "truck"))
    for start, end in builder.stretches():
        for side in (1, -1):
            y = side * (plan.frontage + BACK_ROW - 8)
            for x in np.arange(start + 14.0, end - 14.0, 21.0):
                at = (float(x + rng.uniform(-4, 4)), y, SIDEWALK_HEIGHT)
                start_at = Transform(at, (0.0, float(rng.choice([0.0, 180.0])), 0.0))
                dice = rng.random()
                if dice < 0.62:
                    builder.put(new_car(rng, start_at))
                elif dice < 0.85:
                    builder.put(new_heavy(next(heavy), rng, start_at))
                else:
                    _stand(builder, at[0], y + 2.0)


def _stand(builder: TownBuilder, x: float, y: float) -> None:
    yaw = float(builder.rng.uniform(0, 360))
    builder.put(
        new_walker(builder.rng, Transform((x, y, SIDEWALK_HEIGHT), (0.0, yaw, 0.0)))
    )
