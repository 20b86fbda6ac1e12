"""The three towns of the demo: their styles, and all objects that do not move.

Along the streets stand houses in two rows, sidewalks, open lots, trees and lamps.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from filter_core.geometry.pose import Transform
from unghost.street import furniture
from unghost.street.buildings import (
    BRICK,
    FACADE_STYLES,
    FLATS,
    HOUSE,
    OFFICE,
    STONE,
    TOWN_HOUSE,
    Plot,
    building,
    height_of,
)
from unghost.street.furniture import LINDEN, MAPLE, PLANE_TREE, POPLAR
from unghost.street.ground import SIDEWALK_HEIGHT, RoadPlan
from unghost.street.light import Daylight
from unghost.street.mesh import block, join, sheet
from unghost.street.paint import RGB, Paint, SurfaceKind, Tag
from unghost.street.town import (
    BACK_ROW,
    HOUSE_TYPE,
    SCENERY,
    SIDE_END,
    TOWN_END,
    Thing,
    Town,
    TownBuilder,
    TownStyle,
)
from unghost.street.traffic import (
    park_along_kerbs,
    park_behind_houses,
    park_in_lot,
    run_traffic,
)

_PAVING: Final = Paint((158, 152, 142), kind=SurfaceKind.PAVING)
_KERB: Final = Paint((172, 168, 160))
_LAWN: Final = Paint((90, 110, 50), kind=SurfaceKind.GRASS)
_WALL_COLORS: Final = ((168, 150, 126), (150, 92, 74), (186, 178, 164))
SIDES: Final = (1, -1)


def build_town(style: TownStyle, seed: int, actors: float = 1.0) -> Town:
    """The town of a style; another seed is another town of the same style.

    `actors` is the share of vehicles, people and lights that are there, 0 to 1.
    """
    builder = TownBuilder(style, seed)
    build_blocks(builder)
    park_along_kerbs(builder)
    park_behind_houses(builder)
    run_traffic(builder)
    if actors < 1:
        builder.thin_out(actors)
    return builder.town


def build_blocks(builder: TownBuilder) -> None:
    """Builds all objects that do not move."""
    for start, end in builder.stretches():
        for side in SIDES:
            _pave(builder, start, end, side)
            _front_row(builder, start, end, side)
            _back_row(builder, start, end, side)
            _sidewalk_furniture(builder, start, end, side)
    _close_views(builder)


def _pave(builder: TownBuilder, start: float, end: float, side: int) -> None:
    plan = builder.plan
    inner, kerb = side * plan.half_width, side * (plan.half_width + 0.16)
    low, high = sorted((kerb, side * SIDE_END))
    slab = block(
        (start + 0.16, low, 0),
        (end - 0.16, high, SIDEWALK_HEIGHT),
        _PAVING,
        Tag.SIDEWALK,
    )
    low, high = sorted((inner, side * SIDE_END))
    edge = block(
        (start, low, 0), (end, high, SIDEWALK_HEIGHT - 0.004), _KERB, Tag.SIDEWALK
    )
    lawn_y = sorted((side * (plan.frontage + 0.1), side * (SIDE_END - 1)))
    x0, x1 = start + plan.sidewalk, end - plan.sidewalk
    z = SIDEWALK_HEIGHT + 0.02
    corners = [
        (x0, lawn_y[0], z),
        (x1, lawn_y[0], z),
        (x1, lawn_y[1], z),
        (x0, lawn_y[1], z),
    ]
    lawn = sheet(corners, (0, 0, 1), _LAWN, Tag.TERRAIN)
    for mesh in (slab, edge, lawn):
        builder.scenery(mesh, 0, 0, z=0.0)


def _front_row(builder: TownBuilder, start: float, end: float, side: int) -> None:
    rng, style = builder.rng, builder.style
    x, last = start + builder.plan.sidewalk, end - builder.plan.sidewalk
    after_gap = True
    while last - x > 9.0:
        if not after_gap and last - x > 30 and rng.random() < style.gap_chance:
            width = float(rng.uniform(11, 16))
            _gap(builder, x, x + width, side)
            x, after_gap = x + width, True
            continue
        kind = builder.pick(style.houses)
        bay = FACADE_STYLES[kind].bay
        bays = int(rng.integers(4, 6 if kind == HOUSE else 9))
        width = bay * min(bays, int((last - x) / bay))
        _house(builder, x, x + width, side, kind)
        x, after_gap = x + width, False
        if kind == HOUSE:  # a garden
            front = side * (builder.plan.frontage + 0.5)
            bush = furniture.bush(float(rng.uniform(0.7, 1.1)), rng)
            builder.scenery(furniture.fence(4.0, 1.1), x + 2.0, front)
            builder.scenery(bush, x + 2.0, front + side * 1.4)
            x += 4.0
    if last - x > 1.5:
        wall = furniture.wall(last - x, 2.6, builder.pick(_WALL_COLORS))
        builder.scenery(wall, (x + last) / 2, side * (builder.plan.frontage + 0.3))


def _house(builder: TownBuilder, x0: float, x1: float, side: int, kind: int) -> None:
    rng = builder.rng
    low, high = builder.style.storeys
    storeys = (
        2 if kind == HOUSE else int(rng.integers(low, high + 1)) + (kind == OFFICE) * 3
    )
    back = 1.5 if kind == HOUSE else 0.0
    front_y = builder.plan.frontage + back
    y0, y1 = sorted((side * front_y, side * (front_y + float(rng.uniform(10, 14)))))
    plot = Plot(x0, x1, y0, y1, height_of(kind, storeys), kind, side)
    _add_building(builder, plot)


def _add_building(builder: TownBuilder, plot: Plot) -> None:
    """Facades know where their house is, so it is built in place."""
    mesh = building(plot, builder.rng)
    builder.put(Thing(0, SCENERY, HOUSE_TYPE, "", (mesh,), Transform()))


def _gap(builder: TownBuilder, x0: float, x1: float, side: int) -> None:
    """An open lot: what closes it towards the street, and what is parked behind."""
    front = side * (builder.plan.frontage + 0.3)
    middle, length = (x0 + x1) / 2, x1 - x0
    closing = builder.pick(("wall", "hedge", "fence"))
    if closing == "wall":
        height = builder.style.camera_height + 0.25
        builder.scenery(
            furniture.wall(length, height, builder.pick(_WALL_COLORS)), middle, front
        )
    elif closing == "hedge":
        height = builder.style.camera_height + 0.1
        builder.scenery(
            furniture.hedge(length, 1.1, height, builder.rng), middle, front
        )
    else:
        builder.scenery(furniture.fence(length), middle, front)
    park_in_lot(
        builder, (x0 + 0.6, x1 - 0.6), side, rows=3 if closing == "fence" else 2
    )
    tree = furniture.tree(builder.pick(builder.style.trees), builder.rng, 0.4)
    builder.scenery(tree, middle, side * (builder.plan.frontage + 19))


def _back_row(builder: TownBuilder, start: float, end: float, side: int) -> None:
    """A second row of houses that closes what the first leaves open."""
    rng = builder.rng
    x, last = start + builder.plan.sidewalk, end - builder.plan.sidewalk
    while last - x > 6.0:
        kind = builder.pick(builder.style.houses)
        bay = FACADE_STYLES[kind].bay
        bays = min(int(rng.integers(5, 9)), max(1, int((last - x) / bay)))
        front = builder.plan.frontage + BACK_ROW
        y0, y1 = sorted((side * front, side * (front + 12)))
        storeys = (
            2 if kind == HOUSE else builder.style.storeys[0] + int(rng.integers(0, 2))
        )
        plot = Plot(x, x + bays * bay, y0, y1, height_of(kind, storeys), kind, side)
        _add_building(builder, plot)
        x += bays * bay


def _sidewalk_furniture(
    builder: TownBuilder, start: float, end: float, side: int
) -> None:
    rng, plan = builder.rng, builder.plan
    y = side * (plan.half_width + 0.9)
    lamp_yaw = 0.0 if side > 0 else 180.0
    for number, x in enumerate(np.arange(start + 9.0, end - 8.0, 9.5)):
        at = float(x + rng.uniform(-0.8, 0.8))
        if number % 3 == 1:
            builder.scenery(furniture.street_lamp(), at, y, lamp_yaw)
        else:
            kind, yaw = builder.pick(builder.style.trees), float(rng.uniform(0, 360))
            near, far = builder.prototype(kind)
            place = Transform((at, y, SIDEWALK_HEIGHT), (0.0, yaw, 0.0))
            tree = Thing(
                0, SCENERY, "static.vegetation", "", (near,), place, far_shapes=(far,)
            )
            builder.put(tree)
        _extras(builder, at + 3.0, side)
    sign_x = end - 9.0 if side > 0 else start + 9.0
    builder.scenery(
        furniture.sign(int(rng.integers(3))), sign_x, y, 0.0 if side > 0 else 180.0
    )


def _extras(builder: TownBuilder, x: float, side: int) -> None:
    rng, plan = builder.rng, builder.plan
    dice = rng.random()
    kerb_side = side * (plan.half_width + 0.9)
    yaw = 0.0 if side > 0 else 180.0
    if dice < 0.14:
        builder.scenery(furniture.bench(), x, kerb_side, yaw)
    elif dice < 0.28:
        builder.scenery(furniture.litter_bin(), x, kerb_side)
    elif dice < 0.36:
        builder.scenery(furniture.bus_stop(), x, side * (plan.frontage - 1.2), yaw)
    elif dice < 0.55:
        plant = furniture.bush(0.55, rng).moved(z=0.5)
        builder.scenery(
            join([furniture.planter(rng), plant]), x, side * (plan.frontage - 0.9)
        )


def _close_views(builder: TownBuilder) -> None:
    """Houses across the ends of all streets."""
    plan, kinds = builder.plan, builder.style.houses
    for middle in plan.crossings:
        for side in SIDES:
            kind = builder.pick(kinds)
            half = FACADE_STYLES[kind].bay * 5
            y0, y1 = sorted((side * (SIDE_END + 8), side * (SIDE_END + 20)))
            plot = Plot(
                middle - half, middle + half, y0, y1, height_of(kind, 4), kind, side
            )
            _add_building(builder, plot)
    kind = builder.pick(kinds)
    for side in (-1, 0, 1):
        wide = FACADE_STYLES[kind].bay * 8
        y0 = side * wide - wide / 2
        plot = Plot(
            TOWN_END + 12,
            TOWN_END + 26,
            y0,
            y0 + wide,
            height_of(kind, 5 - side),
            kind,
            1,
        )
        _add_building(builder, plot)
    end = block(
        (TOWN_END, -40, 0), (TOWN_END + 12, 40, SIDEWALK_HEIGHT), _PAVING, Tag.SIDEWALK
    )
    builder.scenery(end, 0, 0, z=0.0)


def _towards(azimuth: float, height: float) -> RGB:
    """The direction of a sun at an azimuth (from x to y) and height, in degrees."""
    turn, up = np.radians(azimuth), np.radians(height)
    flat = float(np.cos(up))
    return (flat * float(np.cos(turn)), flat * float(np.sin(turn)), float(np.sin(up)))


_AFTERNOON: Final = Daylight(
    sun=_towards(212, 41),
    sunlight=(3.5, 3.0, 2.35),
    zenith=(0.20, 0.40, 0.84),
    horizon=(0.78, 0.90, 1.06),
    bounce=(0.30, 0.27, 0.23),
    haze=0.0026,
    clouds=0.46,
    exposure=0.62,
)
_MORNING: Final = Daylight(
    sun=_towards(38, 30),
    sunlight=(3.5, 2.75, 1.95),
    zenith=(0.26, 0.43, 0.78),
    horizon=(1.02, 0.96, 0.90),
    bounce=(0.30, 0.27, 0.24),
    haze=0.0042,
    clouds=0.36,
    exposure=0.62,
)
_OVERCAST: Final = Daylight(
    sun=_towards(150, 52),
    sunlight=(1.35, 1.30, 1.22),
    zenith=(0.62, 0.70, 0.82),
    horizon=(0.98, 1.00, 1.02),
    bounce=(0.36, 0.35, 0.34),
    haze=0.0046,
    clouds=0.86,
    exposure=0.66,
)
STYLES: Final = (
    TownStyle(
        name="town-a",
        seed=101,
        plan=RoadPlan(2, (58.0, 176.0, 290.0), 6.0, 4.6),
        daylight=_AFTERNOON,
        weather={"cloudiness": 30.0, "fog_density": 2.0, "sun_altitude_angle": 41.0},
        houses=(TOWN_HOUSE, TOWN_HOUSE, STONE, BRICK, OFFICE),
        storeys=(3, 5),
        trees=(PLANE_TREE, LINDEN),
        camera_height=1.8,
        gap_chance=0.22,
        parked=0.72,
    ),
    TownStyle(
        name="town-b",
        seed=202,
        plan=RoadPlan(1, (40.0, 128.0, 236.0), 5.0, 3.6),
        daylight=_MORNING,
        weather={"cloudiness": 20.0, "fog_density": 4.0, "sun_altitude_angle": 30.0},
        houses=(HOUSE, HOUSE, HOUSE, FLATS, BRICK),
        storeys=(2, 3),
        trees=(MAPLE, LINDEN, MAPLE),
        camera_height=1.65,
        gap_chance=0.42,
        parked=0.62,
    ),
    TownStyle(
        name="town-c",
        seed=303,
        plan=RoadPlan(3, (70.0, 200.0, 318.0), 7.0, 5.4),
        daylight=_OVERCAST,
        weather={"cloudiness": 85.0, "fog_density": 8.0, "sun_altitude_angle": 52.0},
        houses=(OFFICE, OFFICE, FLATS, BRICK, STONE),
        storeys=(4, 7),
        trees=(POPLAR, PLANE_TREE),
        camera_height=2.3,
        gap_chance=0.26,
        parked=0.55,
    ),
)
