"""Boxes of what the map brings: parked vehicles and traffic lights, asked for once."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from filter_core.geometry.pose import Triple
from unghost.capture.box_checks import checked_light, checked_parked
from unghost.capture.objects import Named, SeenObject, local_box
from unghost.capture.scenario import Scenario
from unghost.capture.simulator import Actor, Carla, World

_LABELS: Final = {
    "Car": "car",
    "Truck": "truck",
    "Bus": "bus",
    "Motorcycle": "motorcycle",
    "Bicycle": "bicycle",
}
SAME_M: Final = 0.5
"""Two boxes of one kind whose centres are this close are one object."""


def map_boxes(
    carla: Carla, world: World, scenario: Scenario, left_out: Counter[str]
) -> list[SeenObject]:
    """Everything of the map that has a box, in the world's frame, each thing once."""
    found: list[SeenObject] = []
    # Where their layer is taken away, their boxes may still be told.
    layers = scenario.map_layers
    there = layers.get("ParkedVehicles", layers.get("All", True))
    if scenario.boxes.parked_vehicles and there:
        found += _unique(_parked(carla, world, left_out), left_out)
    if scenario.boxes.traffic_lights:
        found += _unique(_lights(carla, world, left_out), left_out)
    return found


def without_duplicates(
    objects: Sequence[SeenObject],
    centres: Sequence[Triple],
    taken: Sequence[Triple],
    left_out: Counter[str],
) -> list[SeenObject]:
    """Objects of the map that are none of the actors, whose centres are `taken`."""
    kept = []
    for one, centre in zip(objects, centres, strict=True):
        if any(math.dist(centre, other) <= SAME_M for other in taken):
            left_out["duplicate"] += 1
        else:
            kept.append(one)
    return kept


def _unique(objects: Iterable[SeenObject], left_out: Counter[str]) -> list[SeenObject]:
    kept: list[SeenObject] = []
    for one in objects:
        taken = [other.box.location for other in kept]
        centre = one.box.location
        kept += without_duplicates([one], [centre], taken, left_out)
    return kept


def _parked(carla: Carla, world: World, left_out: Counter[str]) -> Iterator[SeenObject]:
    for label, class_name in _LABELS.items():
        if not hasattr(carla.CityObjectLabel, label):
            continue  # a library from before 0.9.14 has vehicles in one
        objects = world.get_environment_objects(getattr(carla.CityObjectLabel, label))
        for thing in objects:
            # The box is in the world's frame: the object's transform is not for it.
            box = checked_parked(local_box(thing.bounding_box), class_name)
            if box is None:
                left_out["impossible_box"] += 1
                continue
            named = Named(
                id=f"env-{thing.id}",
                source="environment",
                class_name=class_name,
                more={"name": str(thing.name)},
            )
            yield SeenObject(named, box)


def _lights(carla: Carla, world: World, left_out: Counter[str]) -> Iterator[SeenObject]:
    heads: list[tuple[str, str, object]] = []
    for light in world.get_actors().filter("traffic.traffic_light*"):
        if getattr(light, "is_dormant", False):
            left_out["dormant"] += 1
            continue
        try:
            heads += _heads(light)
        except RuntimeError:
            # Some maps do not know their own lights; the level still has their boxes.
            boxes = world.get_level_bbs(carla.CityObjectLabel.TrafficLight)
            heads = [(f"level-{i}", "level", box) for i, box in enumerate(boxes)]
            break
    for name, source, raw in heads:
        box = checked_light(local_box(raw))
        if box is None:
            left_out["impossible_box"] += 1
            continue
        # The simulator's tags of lights are stale in 0.9.16, so none are stored.
        yield SeenObject(Named(name, source, "traffic_light"), box)


def _heads(light: Actor) -> list[tuple[str, str, object]]:
    # Not light.bounding_box: that is the volume on the road where cars obey it.
    boxes = light.get_light_boxes()
    return [(f"light-{light.id}-{i}", "light", box) for i, box in enumerate(boxes)]
