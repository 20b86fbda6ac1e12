"""What moves: vehicles in their lanes, people on sidewalks and crossings, lights."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Final

import numpy as np

from app.demo.fleet import HEAVY, new_car, new_heavy, new_two_wheeler, new_walker
from app.demo.furniture import AMBER, GREEN, RED, traffic_light
from app.demo.ground import SIDEWALK_HEIGHT
from app.demo.things import SCENERY, Route, Thing
from app.demo.town import (
    DRIVE_LENGTH,
    DRIVE_SPEED,
    STEP_S,
    TOWN_END,
    TOWN_START,
    TownBuilder,
    convoy,
)
from filter_core.geometry.pose import Transform

_WALK_SPEED: Final = 1.35
_Place = tuple[Transform, Route]
_CLEAR_M: Final = 7.0
_LIGHT_S: Final = 4.0
_CYCLE: Final = (GREEN, GREEN, AMBER, RED, RED, RED)


def run_traffic(builder: TownBuilder) -> None:
    """All that moves."""
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
        # Beside the camera: half behind it, and outside its view.
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
    across = tuple(
        traffic_light((RED, RED, RED, GREEN, GREEN, AMBER)[i]) for i in range(6)
    )
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
