"""The boxes of a world: those of its actors, and those of the map's own objects.

This module calls the simulator; `objects` checks the results. Actors (vehicles,
walkers, parked cars that are props) move, so their poses come from the snapshot of each
tick; all other data of an actor is requested once. Parked vehicles and traffic lights
of the map stand still and are requested once, in the world's frame.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Final, TypeAlias

from filter_core.class_names import class_of
from filter_core.geometry.pose import Triple
from unghost.capture.objects import (
    LocalBox,
    ObjectIdentity,
    SeenObject,
    checked_light,
    checked_parked,
    checked_prop,
    checked_vehicle,
    checked_walker,
    local_box,
)
from unghost.capture.scenario import Scenario
from unghost.capture.simulator import (
    Actor,
    Box,
    CaptureError,
    Carla,
    TrafficLight,
    World,
    WorldSnapshot,
    as_transform,
    is_dormant,
    version_numbers,
)

_PARKED_MESHES: Final = "/ParkedVehicles/"
"""Props with this in their mesh's path are parked cars of large maps."""
_HAS_ACTOR_INSTANCES: Final = (0, 9, 16)
"""The version from which on the instance camera shows 16 bits of actors' ids."""
_PARKED: Final = {
    "Car": "car",
    "Truck": "truck",
    "Bus": "bus",
    "Motorcycle": "motorcycle",
    "Bicycle": "bicycle",
}
"""The class of each label of `carla.CityObjectLabel`."""
SAME_M: Final = 0.5
"""Two boxes of one kind whose centres are this close are one object."""
_Known: TypeAlias = tuple[ObjectIdentity, LocalBox | None]
"""The constant data of an actor; None for its box if that is meaningless."""


class ActorBoxes:
    """Boxes of actors; the data of each actor is requested only once."""

    def __init__(self, world: World, scenario: Scenario, version: str) -> None:
        self._world, self._scenario = world, scenario
        self._with_instances = version_numbers(version) >= _HAS_ACTOR_INSTANCES
        self._known: dict[int, _Known] = {}
        """The constant data of actors by their ids."""

    @property
    def known_ids(self) -> frozenset[int]:
        """The ids of all actors whose data was requested."""
        return frozenset(self._known)

    def seen(
        self, snapshot: WorldSnapshot, ego_id: int, left_out: Counter[str]
    ) -> list[SeenObject]:
        """The actors of a tick that have a box; the others are counted by reason."""
        others = (actor for actor in self._actors() if actor.id != ego_id)
        seen = (self._seen(actor, snapshot, left_out) for actor in others)
        return [actor for actor in seen if actor is not None]

    def _actors(self) -> Iterator[Actor]:
        actors, rules = self._world.get_actors(), self._scenario.boxes
        if rules.vehicles:
            yield from actors.filter("vehicle.*")
        if rules.walkers:
            yield from actors.filter("walker.pedestrian.*")
        if rules.parked_vehicles:
            for prop in actors.filter("static.prop.mesh"):
                if _PARKED_MESHES in dict(prop.attributes).get("mesh_path", ""):
                    yield prop

    def _seen(
        self, actor: Actor, snapshot: WorldSnapshot, left_out: Counter[str]
    ) -> SeenObject | None:
        moment = snapshot.find(actor.id)
        if moment is None:
            left_out["not_in_snapshot"] += 1
            return None
        if is_dormant(actor):
            left_out["dormant"] += 1
            return None
        answer = self._known.get(actor.id)
        if answer is None:
            answer = self._look_at(actor)
            if answer is None:
                left_out["no_answer"] += 1
                return None
            self._known[actor.id] = answer
        named, box = answer
        if box is None:
            left_out["impossible_box"] += 1
            return None
        return SeenObject(named, box, as_transform(moment.get_transform()))

    def _look_at(self, actor: Actor) -> _Known | None:
        try:
            # From 0.9.16 on this calls the simulator, and fails if the actor is gone.
            box = local_box(actor.bounding_box)
            tags = tuple(int(tag) for tag in actor.semantic_tags)
            attributes = dict(actor.attributes)
        except RuntimeError:
            return None
        type_id, number = actor.type_id, actor.id
        base_type = attributes.get("base_type") or None
        is_prop = type_id.startswith("static.")
        class_name: str | None = "car"
        if not is_prop:
            named_class = self._scenario.classes.get(type_id)
            class_name = named_class or class_of(type_id, base_type)
        named = ObjectIdentity(
            id=str(number),
            source="actor",
            class_name=class_name,
            type_id=type_id,
            base_type=base_type,
            semantic_tags=tags,
            instance_id=number & 0xFFFF if self._with_instances else None,
            more={"mesh_path": attributes["mesh_path"]} if is_prop else {},
        )
        return named, self._checked(box, named)

    def _checked(self, box: LocalBox, named: ObjectIdentity) -> LocalBox | None:
        rules, type_id = self._scenario.boxes, named.type_id or ""
        if type_id.startswith("static."):
            return checked_prop(box)
        if type_id.startswith("walker."):
            return checked_walker(box, rules.widen_walkers_m)
        kind = named.class_name or named.base_type or ""
        return checked_vehicle(box, kind, repair=rules.repair_two_wheelers)


def map_boxes(
    carla: Carla, world: World, scenario: Scenario, left_out: Counter[str]
) -> list[SeenObject]:
    """Every object of the map that has a box, once, in world coordinates."""
    objects: list[SeenObject] = []
    # The simulator may still return boxes of layers that were unloaded.
    layers = scenario.map_layers
    there = layers.get("ParkedVehicles", layers.get("All", True))
    if scenario.boxes.parked_vehicles and there:
        objects += _unique(_parked(carla, world, left_out), left_out)
    if scenario.boxes.traffic_lights:
        objects += _unique(_lights(carla, world, left_out), left_out)
    return objects


def without_duplicates(
    objects: Sequence[SeenObject],
    centres: Sequence[Triple],
    taken: Sequence[Triple],
    left_out: Counter[str],
) -> list[SeenObject]:
    """Objects of the map without those that are actors, whose centres are `taken`."""
    kept = []
    for seen, centre in zip(objects, centres, strict=True):
        if any(math.dist(centre, other) <= SAME_M for other in taken):
            left_out["duplicate"] += 1
        else:
            kept.append(seen)
    return kept


def _unique(objects: Iterable[SeenObject], left_out: Counter[str]) -> list[SeenObject]:
    kept: list[SeenObject] = []
    for seen in objects:
        taken = [other.box.location for other in kept]
        centre = seen.box.location
        kept += without_duplicates([seen], [centre], taken, left_out)
    return kept


def _parked(carla: Carla, world: World, left_out: Counter[str]) -> Iterator[SeenObject]:
    for label, class_name in _PARKED.items():
        if not hasattr(carla.CityObjectLabel, label):
            continue  # before 0.9.14, the library has one label for all vehicles
        objects = world.get_environment_objects(getattr(carla.CityObjectLabel, label))
        for thing in objects:
            # The box is in the world's frame: the object's transform is not for it.
            box = checked_parked(local_box(thing.bounding_box), class_name)
            if box is None:
                left_out["impossible_box"] += 1
                continue
            named = ObjectIdentity(
                id=f"env-{thing.id}",
                source="environment",
                class_name=class_name,
                more={"name": thing.name},
            )
            yield SeenObject(named, box)


def _lights(carla: Carla, world: World, left_out: Counter[str]) -> Iterator[SeenObject]:
    heads: list[tuple[str, str, Box]] = []
    for light in world.get_actors().filter("traffic.traffic_light*"):
        if is_dormant(light):
            left_out["dormant"] += 1
            continue
        if not isinstance(light, TrafficLight):
            raise CaptureError(
                f"{light.type_id} is not a traffic light with boxes of its heads"
            )
        try:
            # Not its bounding_box: that is the volume on the road where cars obey it.
            boxes = enumerate(light.get_light_boxes())
            heads += [(f"light-{light.id}-{i}", "light", box) for i, box in boxes]
        except RuntimeError:
            # Some maps do not list their lights; the level still has the lights' boxes.
            boxes = enumerate(world.get_level_bbs(carla.CityObjectLabel.TrafficLight))
            heads = [(f"level-{i}", "level", box) for i, box in boxes]
            break
    for name, source, raw in heads:
        box = checked_light(local_box(raw))
        if box is None:
            left_out["impossible_box"] += 1
            continue
        # The simulator's tags of lights are stale in 0.9.16, so none are stored.
        yield SeenObject(ObjectIdentity(name, source, "traffic_light"), box)
