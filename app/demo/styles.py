"""The three towns of the demo."""

from __future__ import annotations

from typing import Final

import numpy as np

from app.demo.blocks import build_blocks
from app.demo.buildings import BRICK, FLATS, HOUSE, OFFICE, STONE, TOWN_HOUSE
from app.demo.ground import RoadPlan
from app.demo.parking import park_along_kerbs, park_behind_houses
from app.demo.sky import RGB, Hour
from app.demo.town import Town, TownBuilder, TownStyle
from app.demo.traffic import run_traffic
from app.demo.trees import LINDEN, MAPLE, PLANE_TREE, POPLAR


def _towards(azimuth: float, height: float) -> RGB:
    """The direction of a sun at an azimuth (from x to y) and height, in degrees."""
    turn, up = np.radians(azimuth), np.radians(height)
    flat = float(np.cos(up))
    return (flat * float(np.cos(turn)), flat * float(np.sin(turn)), float(np.sin(up)))


_AFTERNOON: Final = Hour(
    sun=_towards(212, 41),
    sunlight=(3.5, 3.0, 2.35),
    zenith=(0.20, 0.40, 0.84),
    horizon=(0.78, 0.90, 1.06),
    bounce=(0.30, 0.27, 0.23),
    haze=0.0026,
    clouds=0.46,
    exposure=0.62,
)
_MORNING: Final = Hour(
    sun=_towards(38, 30),
    sunlight=(3.5, 2.75, 1.95),
    zenith=(0.26, 0.43, 0.78),
    horizon=(1.02, 0.96, 0.90),
    bounce=(0.30, 0.27, 0.24),
    haze=0.0042,
    clouds=0.36,
    exposure=0.62,
)
_OVERCAST: Final = Hour(
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
        hour=_AFTERNOON,
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
        hour=_MORNING,
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
        hour=_OVERCAST,
        weather={"cloudiness": 85.0, "fog_density": 8.0, "sun_altitude_angle": 52.0},
        houses=(OFFICE, OFFICE, FLATS, BRICK, STONE),
        storeys=(4, 7),
        trees=(POPLAR, PLANE_TREE),
        camera_height=2.3,
        gap_chance=0.26,
        parked=0.55,
    ),
)


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
