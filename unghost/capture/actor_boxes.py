"""Boxes of what was spawned: vehicles, walkers, and parked cars that are props."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from filter_core.classes import class_of
from unghost.capture.box_checks import (
    LocalBox,
    checked_prop,
    checked_vehicle,
    checked_walker,
)
from unghost.capture.objects import Named, SeenObject, local_box
from unghost.capture.poses import as_transform, version_numbers
from unghost.capture.scenario import Scenario
from unghost.capture.simulator import Actor, Snapshot, World

_PARKED_MESHES = "/ParkedVehicles/"
_HAS_ACTOR_INSTANCES = (0, 9, 16)
"""From here on the instance camera shows actors' ids, as 16 bits."""


@dataclass(frozen=True)
class _Known:
    named: Named
    box: LocalBox | None


class ActorBoxes:
    """Boxes of actors; what the simulator is asked about an actor is asked once."""

    def __init__(self, world: World, scenario: Scenario, version: str) -> None:
        self._world, self._scenario = world, scenario
        self._with_instances = version_numbers(version) >= _HAS_ACTOR_INSTANCES
        self._known: dict[int, _Known] = {}

    @property
    def known_ids(self) -> frozenset[int]:
        """The actors that were looked at."""
        return frozenset(self._known)

    def seen(
        self, snapshot: Snapshot, ego_id: int, left_out: Counter[str]
    ) -> list[SeenObject]:
        """The actors of a tick that have a box; others are counted by the reason."""
        found = []
        for actor in self._actors():
            if int(actor.id) == ego_id:
                continue
            one = self._seen(actor, snapshot, left_out)
            if one is not None:
                found.append(one)
        return found

    def _actors(self) -> Iterator[Actor]:
        actors, wanted = self._world.get_actors(), self._scenario.boxes
        if wanted.vehicles:
            yield from actors.filter("vehicle.*")
        if wanted.walkers:
            yield from actors.filter("walker.pedestrian.*")
        if wanted.parked_vehicles:
            for prop in actors.filter("static.prop.mesh"):
                if _PARKED_MESHES in dict(prop.attributes).get("mesh_path", ""):
                    yield prop

    def _seen(
        self, actor: Actor, snapshot: Snapshot, left_out: Counter[str]
    ) -> SeenObject | None:
        moment = snapshot.find(actor.id)
        if moment is None:
            left_out["not_in_snapshot"] += 1
            return None
        if getattr(actor, "is_dormant", False):
            left_out["dormant"] += 1
            return None
        known = self._known.get(int(actor.id))
        if known is None:
            known = self._look_at(actor)
            if known is None:
                left_out["no_answer"] += 1
                return None
            self._known[int(actor.id)] = known
        if known.box is None:
            left_out["impossible_box"] += 1
            return None
        return SeenObject(known.named, known.box, as_transform(moment.get_transform()))

    def _look_at(self, actor: Actor) -> _Known | None:
        try:
            # From 0.9.16 on this asks the simulator, and fails for one that is gone.
            box = local_box(actor.bounding_box)
            tags = tuple(int(tag) for tag in actor.semantic_tags)
            attributes = {str(k): str(v) for k, v in dict(actor.attributes).items()}
        except RuntimeError:
            return None
        type_id, number = str(actor.type_id), int(actor.id)
        base_type = attributes.get("base_type") or None
        is_prop = type_id.startswith("static.")
        class_name = "car" if is_prop else self._class(type_id, base_type)
        named = Named(
            id=str(number),
            source="actor",
            class_name=class_name,
            type_id=type_id,
            base_type=base_type,
            semantic_tags=tags,
            instance_id=number & 0xFFFF if self._with_instances else None,
            more={"mesh_path": attributes["mesh_path"]} if is_prop else {},
        )
        return _Known(named, self._checked(box, named))

    def _class(self, type_id: str, base_type: str | None) -> str | None:
        return self._scenario.classes.get(type_id) or class_of(type_id, base_type)

    def _checked(self, box: LocalBox, named: Named) -> LocalBox | None:
        rules, type_id = self._scenario.boxes, named.type_id or ""
        if type_id.startswith("static."):
            return checked_prop(box)
        if type_id.startswith("walker."):
            return checked_walker(box, rules.widen_walkers_m)
        kind = named.class_name or named.base_type or ""
        return checked_vehicle(box, kind, repair=rules.repair_two_wheelers)
