"""Vehicles, people and traffic lights: their kinds, places and movements.

Vehicles drive in their lanes, people walk on sidewalks and crossings; others are parked
or stand, many of them out of sight. Names are those of CARLA's blueprints.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final, TypeVar

import numpy as np

from filter_core.geometry.pose import Transform
from unghost.street.furniture import AMBER, GREEN, RED, traffic_light
from unghost.street.ground import PARKING, SIDEWALK_HEIGHT
from unghost.street.mesh import Mesh
from unghost.street.paint import RGB
from unghost.street.people import WALK_PHASES, Clothes, walker
from unghost.street.town import (
    BACK_ROW,
    DRIVE_LENGTH,
    DRIVE_SPEED,
    SCENERY,
    STEP_S,
    TOWN_END,
    TOWN_START,
    Route,
    Thing,
    TownBuilder,
    convoy,
)
from unghost.street.vehicles import (
    SHAPES,
    bicycle,
    bus,
    car,
    far_car,
    motorcycle,
    truck,
    van,
)

T = TypeVar("T")

_WALK_SPEED: Final = 1.35
"""Metres per second."""
_Place = tuple[Transform, Route]
_CLEAR_M: Final = 7.0
"""People on crossings keep so far from the camera, if they can."""
_LIGHT_S: Final = 4.0
"""Seconds of each state in the cycle of the lights."""
_CYCLE: Final = (GREEN, GREEN, AMBER, RED, RED, RED)
"""Along the main street."""
_CYCLE_ACROSS: Final = (RED, RED, RED, GREEN, GREEN, AMBER)
"""Along the side streets, at the same times."""
CAR_COLORS: Final[tuple[RGB, ...]] = (
    (168, 172, 176),
    (58, 62, 68),
    (226, 226, 222),
    (128, 24, 26),
    (34, 54, 92),
    (24, 26, 30),
    (92, 102, 108),
    (146, 134, 116),
    (44, 82, 84),
    (196, 190, 178),
    (150, 62, 30),
    (70, 88, 62),
)
_VAN_COLORS: Final[tuple[RGB, ...]] = (
    (228, 228, 224),
    (206, 208, 210),
    (60, 84, 120),
    (196, 172, 60),
)
_BUS_COLORS: Final[tuple[RGB, ...]] = ((168, 38, 36), (40, 88, 122), (206, 162, 48))
_CARGO: Final[tuple[RGB, ...]] = ((222, 220, 212), (168, 40, 38), (60, 96, 84))
HEAVY: Final[dict[str, tuple[str, str, Callable[[np.random.Generator], Mesh]]]] = {
    "ambulance": (
        "van",
        "vehicle.ford.ambulance",
        lambda _: van((232, 230, 224), stripe=(206, 70, 30)),
    ),
    "sprinter": (
        "van",
        "vehicle.mercedes.sprinter",
        lambda rng: van(_any_of(_VAN_COLORS, rng)),
    ),
    "bus": (
        "bus",
        "vehicle.mitsubishi.fusorosa",
        lambda rng: bus(_any_of(_BUS_COLORS, rng)),
    ),
    "truck": (
        "truck",
        "vehicle.carlamotors.european_hgv",
        lambda rng: truck(_any_of(_VAN_COLORS[:3], rng), _any_of(_CARGO, rng)),
    ),
    "carlacola": (
        "truck",
        "vehicle.carlamotors.carlacola",
        lambda _: truck((150, 26, 28), (172, 30, 32)),
    ),
}
"""The class, the blueprint and the building function of each vehicle."""
_TWO_WHEELERS: Final[
    dict[str, tuple[Callable[[RGB, Clothes], Mesh], tuple[str, ...]]]
] = {
    "motorcycle": (
        motorcycle,
        (
            "vehicle.yamaha.yzf",
            "vehicle.kawasaki.ninja",
            "vehicle.harley-davidson.low_rider",
        ),
    ),
    "bicycle": (
        bicycle,
        (
            "vehicle.bh.crossbike",
            "vehicle.diamondback.century",
            "vehicle.gazelle.omafiets",
        ),
    ),
}
"""The building function and the blueprints of each class."""
_STANDING: Final = Route()


def new_car(
    rng: np.random.Generator, start: Transform, route: Route = _STANDING
) -> Thing:
    """Any car in any colour."""
    type_id = _any_of(list(SHAPES), rng)
    shape, color = SHAPES[type_id], _any_of(CAR_COLORS, rng)
    near, far = car(shape, color), far_car(shape, color)
    return Thing(0, "car", type_id, "car", (near,), start, route, far_shapes=(far,))


def new_heavy(
    name: str, rng: np.random.Generator, start: Transform, route: Route = _STANDING
) -> Thing:
    """A van, bus or truck: one of `HEAVY`."""
    class_name, type_id, build = HEAVY[name]
    return Thing(0, class_name, type_id, class_name, (build(rng),), start, route)


def _any_of(choices: Sequence[T], rng: np.random.Generator) -> T:
    return choices[int(rng.integers(len(choices)))]


def new_two_wheeler(
    class_name: str,
    rng: np.random.Generator,
    start: Transform,
    route: Route = _STANDING,
) -> Thing:
    """A motorcycle or a bicycle with its rider."""
    build, type_ids = _TWO_WHEELERS[class_name]
    color = _any_of(CAR_COLORS[3:], rng)
    mesh = build(color, Clothes.random(rng))
    return Thing(
        0, class_name, _any_of(type_ids, rng), class_name, (mesh,), start, route
    )


def new_walker(
    rng: np.random.Generator, start: Transform, route: Route = _STANDING
) -> Thing:
    """Someone on foot: walking if there is a route, else standing."""
    clothes = Clothes.random(rng)
    scale = float(rng.uniform(0.93, 1.06)) if rng.random() > 0.1 else 0.72
    phases = range(WALK_PHASES) if route.length else (1,)
    near, far = (
        tuple(walker(clothes, phase, scale, fine=fine) for phase in phases)
        for fine in (True, False)
    )
    number = int(rng.integers(1, 49))
    return Thing(
        0,
        "walker",
        f"walker.pedestrian.{number:04d}",
        "",
        near,
        start,
        route,
        far_shapes=far,
        shape_s=0.27,
        shape_offset=int(rng.integers(WALK_PHASES)),
    )


def run_traffic(builder: TownBuilder) -> None:
    """Adds all moving objects and the traffic lights."""
    _with_the_camera(builder)
    _oncoming(builder)
    _on_foot(builder)
    _on_crossings(builder)
    _lights(builder)
    _in_side_streets(builder)


def _with_the_camera(builder: TownBuilder) -> None:
    """Vehicles that keep their distance, so that every frame has something near."""
    rng, plan = builder.rng, builder.plan
    own, other = plan.lane_middle(0), plan.lane_middle(plan.lanes - 1)
    aside, edge = float(rng.choice([-0.9, 0.7])), plan.lanes_edge - 0.3

    def ahead(low: float, high: float, y: float, sway: float = 0.0) -> _Place:
        return convoy(float(rng.uniform(low, high)), y, sway)

    for gap in (21.0, 36.0, 59.0, 93.0):
        builder.put(new_car(rng, *ahead(gap - 2, gap + 2, own, 1.5)))
    for gap in (-9.0, -23.0, -40.0):
        builder.put(new_car(rng, *convoy(gap, own)))
    builder.put(new_two_wheeler("motorcycle", rng, *ahead(9, 12, own + aside, 3.8)))
    for low, high in ((12, 15), (-17, -16), (68, 84)):
        builder.put(new_two_wheeler("bicycle", rng, *ahead(low, high, edge, -3.0)))
    if plan.lanes > 1:
        builder.put(new_heavy("bus", rng, *ahead(23, 28, other, -5.0)))
        builder.put(new_car(rng, *ahead(40, 43, other)))
        # Next to the camera: half behind it, and outside its view.
        builder.put(new_car(rng, *convoy(-0.4, other)))
        builder.put(new_car(rng, *ahead(60, 66, other, 3.0)))


def _oncoming(builder: TownBuilder) -> None:
    rng, plan = builder.rng, builder.plan
    length = TOWN_END - TOWN_START
    # In turns, so that a short drive meets every kind.
    heavy = itertools.cycle(HEAVY)
    for lane in range(plan.lanes):
        speed = float(rng.uniform(7.5, 10.5))
        ahead = float(rng.uniform(0, 25))
        while ahead < length - 16:
            start = Transform(
                (TOWN_END, -plan.lane_middle(lane), 0.0), (0.0, 180.0, 0.0)
            )
            route = Route(speed, length, ahead)
            dice = rng.random()
            if dice < 0.62:
                builder.put(new_car(rng, start, route))
            elif dice < 0.88:
                builder.put(new_heavy(next(heavy), rng, start, route))
            else:
                kind = "motorcycle" if dice < 0.95 else "bicycle"
                builder.put(new_two_wheeler(kind, rng, start, route))
            ahead += float(rng.uniform(20, 58))


def _on_foot(builder: TownBuilder) -> None:
    rng, plan = builder.rng, builder.plan
    for start, end in builder.stretches():
        for side in (1, -1):
            for _ in range(int((end - start) / 13)):
                y = side * float(
                    rng.uniform(plan.half_width + 1.7, plan.frontage - 1.0)
                )
                onward = rng.random() < 0.5
                at = start + 3.0 if onward else end - 3.0
                place = Transform(
                    (at, y, SIDEWALK_HEIGHT), (0.0, 0.0 if onward else 180.0, 0.0)
                )
                length = end - start - 6.0
                speed = _WALK_SPEED * float(rng.uniform(0.8, 1.15))
                route = Route(speed, length, float(rng.uniform(0, length)))
                builder.put(new_walker(rng, place, route))


def _on_crossings(builder: TownBuilder) -> None:
    rng, plan = builder.rng, builder.plan
    for middle in plan.crossings:
        for sign in (-1, 1):
            x = middle + sign * (plan.side_half_width + 2.2)
            for number in range(2):
                down = (number + sign) % 2 == 0
                y = plan.half_width + 1.0
                at = (x + float(rng.uniform(-0.9, 0.9)), -y if down else y, 0.0)
                place = Transform(at, (0.0, 90.0 if down else -90.0, 0.0))
                route = _clear_route(builder, place, 2 * y)
                builder.put(new_walker(rng, place, route))


def _clear_route(builder: TownBuilder, start: Transform, length: float) -> Route:
    """Across a street without walking into the camera, if there is such a moment."""
    steps = range(int(DRIVE_LENGTH / (DRIVE_SPEED * STEP_S)))
    eyes = np.array([builder.town.camera(step).location for step in steps])
    routes = [
        Route(_WALK_SPEED, length, float(ahead))
        for ahead in builder.rng.uniform(0, length, 24)
    ]

    def clearance(route: Route) -> float:
        probe = Thing(0, SCENERY, "", "", (), start, route)
        places = np.array([probe.pose(step * STEP_S).location for step in steps])
        return float(np.linalg.norm((places - eyes)[:, :2], axis=1).min())

    return max(routes, key=lambda route: min(clearance(route), _CLEAR_M))


def _lights(builder: TownBuilder) -> None:
    plan = builder.plan
    shapes = tuple(traffic_light(state) for state in _CYCLE)
    across = tuple(traffic_light(state) for state in _CYCLE_ACROSS)
    x_out, y_out = plan.side_half_width + 0.8, plan.half_width + 0.7
    for number, middle in enumerate(plan.crossings):
        # The far side of the crossing, on the right of whom they concern.
        corners = (
            (middle + x_out, y_out, 0.0, shapes),
            (middle - x_out, -y_out, 180.0, shapes),
            (middle - x_out, y_out, 90.0, across),
            (middle + x_out, -y_out, -90.0, across),
        )
        for x, y, yaw, looks in corners:
            start = Transform((x, y, SIDEWALK_HEIGHT), (0.0, yaw, 0.0))
            light = Thing(
                0, "traffic_light", "traffic.traffic_light", "", looks, start,
                shape_s=_LIGHT_S, shape_offset=number * 2,
            )  # fmt: skip
            builder.put(light)


def _in_side_streets(builder: TownBuilder) -> None:
    """Vehicles that wait or go across, at both ends of every side street."""
    rng, plan = builder.rng, builder.plan
    for middle in plan.crossings:
        for side in (1, -1):
            lane = -side * plan.side_half_width / 2
            waiting = Transform(
                (middle - lane, side * (plan.half_width + 9), 0.0),
                (0.0, -90.0 * side, 0.0),
            )
            builder.put(new_car(rng, waiting))
            behind = replace(
                waiting, location=(middle - lane, side * (plan.half_width + 16), 0.0)
            )
            builder.put(
                new_heavy("sprinter", rng, behind) if side > 0 else new_car(rng, behind)
            )
            leaving = Transform(
                (middle + lane, side * (plan.half_width + 30), 0.0),
                (0.0, 90.0 * side, 0.0),
            )
            builder.put(new_car(rng, leaving))


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
