"""Vehicles and people ready to be put into a town, as CARLA's blueprints name them."""

from __future__ import annotations

from typing import Final

import numpy as np

from app.demo.cars import SHAPES, car, far_car
from app.demo.heavy_vehicles import bus, truck, van
from app.demo.mesh import Mesh
from app.demo.people import WALK_PHASES, Dress, walker
from app.demo.things import Route, Thing
from app.demo.two_wheelers import bicycle, motorcycle
from filter_core.geometry.pose import Transform

RGB = tuple[float, float, float]

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
_STANDING: Final = Route()

HEAVY: Final[dict[str, tuple[str, str]]] = {
    "ambulance": ("van", "vehicle.ford.ambulance"),
    "sprinter": ("van", "vehicle.mercedes.sprinter"),
    "bus": ("bus", "vehicle.mitsubishi.fusorosa"),
    "truck": ("truck", "vehicle.carlamotors.european_hgv"),
    "carlacola": ("truck", "vehicle.carlamotors.carlacola"),
}
_MOTORCYCLES: Final = (
    "vehicle.yamaha.yzf",
    "vehicle.kawasaki.ninja",
    "vehicle.harley-davidson.low_rider",
)
_BICYCLES: Final = (
    "vehicle.bh.crossbike",
    "vehicle.diamondback.century",
    "vehicle.gazelle.omafiets",
)


def new_car(
    rng: np.random.Generator, start: Transform, route: Route = _STANDING
) -> Thing:
    """Any car in any colour."""
    type_id = list(SHAPES)[rng.integers(len(SHAPES))]
    shape, color = SHAPES[type_id], CAR_COLORS[rng.integers(len(CAR_COLORS))]
    near, far = car(shape, color), far_car(shape, color)
    return Thing(0, "car", type_id, "car", (near,), start, route, far_shapes=(far,))


def new_heavy(
    name: str, rng: np.random.Generator, start: Transform, route: Route = _STANDING
) -> Thing:
    """One of `HEAVY`."""
    class_name, type_id = HEAVY[name]
    mesh = _heavy_mesh(name, rng)
    return Thing(0, class_name, type_id, class_name, (mesh,), start, route)


def _heavy_mesh(name: str, rng: np.random.Generator) -> Mesh:
    if name == "ambulance":
        return van((232, 230, 224), stripe=(206, 70, 30))
    if name == "sprinter":
        return van(_VAN_COLORS[rng.integers(len(_VAN_COLORS))])
    if name == "bus":
        return bus(_BUS_COLORS[rng.integers(len(_BUS_COLORS))])
    if name == "carlacola":
        return truck((150, 26, 28), (172, 30, 32))
    return truck(_VAN_COLORS[rng.integers(3)], _CARGO[rng.integers(len(_CARGO))])


def new_two_wheeler(
    class_name: str,
    rng: np.random.Generator,
    start: Transform,
    route: Route = _STANDING,
) -> Thing:
    """A motorcycle or a bicycle with its rider."""
    color = CAR_COLORS[3 + rng.integers(len(CAR_COLORS) - 3)]
    dress = Dress.random(rng)
    if class_name == "motorcycle":
        mesh, names = motorcycle(color, dress), _MOTORCYCLES
    else:
        mesh, names = bicycle(color, dress), _BICYCLES
    type_id = names[rng.integers(len(names))]
    return Thing(0, class_name, type_id, class_name, (mesh,), start, route)


def new_walker(
    rng: np.random.Generator, start: Transform, route: Route = _STANDING
) -> Thing:
    """Someone on foot: walking if there is a route, else standing."""
    dress = Dress.random(rng)
    scale = float(rng.uniform(0.93, 1.06)) if rng.random() > 0.1 else 0.72
    phases = range(WALK_PHASES) if route.length else (1,)
    near, far = (
        tuple(walker(dress, phase, scale, fine=fine) for phase in phases)
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
