"""The ego vehicle, the others, and people on foot: chosen first, then spawned."""

from __future__ import annotations

import random
from collections.abc import Sequence
from fnmatch import fnmatchcase
from functools import reduce
from typing import Final

from unghost.capture.blueprints import (
    choose_blueprints,
    find_blueprint,
    randomise,
    set_attributes,
    with_wheels,
)
from unghost.capture.session import CaptureSession, StopRequest
from unghost.capture.simulator import (
    Actor,
    Blueprint,
    CaptureError,
    Carla,
    Pose,
    ScenarioError,
    Vehicle,
    WalkerController,
)

_SAFE_BASE_TYPES: Final = frozenset({"car"})
"""Vehicles that seldom cause accidents: what `vehicles.safe` lets through."""
_TRIES: Final = 5
"""Places on the sidewalk that are tried for one walker."""


class Traffic:
    """The traffic of a scenario: the blueprints that it selects, then the actors."""

    def __init__(self, session: CaptureSession) -> None:
        """Choose the blueprints; nothing is spawned.

        Raises `ScenarioError` if there are no such blueprints or no such spawn point,
        and `CaptureError` if the map has no spawn points.
        """
        self._session = session
        world, scenario = session.world, session.scenario
        self._ego = find_blueprint(world, scenario.ego.blueprint, "ego.blueprint")
        # The map's own, in its order, by which the scenario names one.
        self._points = list(world.get_map().get_spawn_points())
        if not self._points:
            raise CaptureError("map: it has no spawn points for vehicles")
        place = scenario.ego.spawn_point
        if place is not None and place >= len(self._points):
            raise ScenarioError(
                f"ego.spawn_point: {session.map_name} has 0 to "
                f"{len(self._points) - 1}, found {place}"
            )
        if self._ego.has_attribute("role_name"):
            set_attributes(self._ego, {"role_name": scenario.ego.role_name}, "ego")
        people = scenario.walkers
        # Of vehicles and walkers there may be no blueprints.
        self._walkers: list[Blueprint] = []
        self._controller: Blueprint | None = None
        if people.count:
            self._walkers = choose_blueprints(
                world, people.filter, people.generation, "walkers"
            )
            self._controller = find_blueprint(world, "controller.ai.walker", "walkers")
        self._vehicles = _vehicles(session)

    def spawn(self, stop: StopRequest) -> tuple[Actor, int, int]:
        """The ego vehicle, and how many other vehicles and walkers found a free place.

        The same seed tries the same places.
        """
        session = self._session
        dice = random.Random(session.seed)
        manager = session.client.get_trafficmanager(_port(session))
        manager.set_random_device_seed(session.seed)
        points = list(self._points)
        dice.shuffle(points)
        ego = self._spawn_ego(points)
        vehicles = self._spawn_vehicles(points, dice, stop)
        return ego, vehicles, self._spawn_walkers(dice, stop)

    def _spawn_ego(self, points: list[Pose]) -> Actor:
        session, plan = self._session, self._session.scenario.ego
        chosen = plan.spawn_point
        places = points if chosen is None else [self._points[chosen]]
        for place in places:
            ego = session.world.try_spawn_actor(self._ego, place)
            if ego is not None:
                session.own(ego)
                if plan.autopilot:
                    _drive(session, ego)
                _light(session, ego, plan.lights)
                return ego
        where = "spawn point" if chosen is None else f"spawn point {chosen}"
        raise CaptureError(f"ego: no free {where} for {plan.blueprint}")

    def _spawn_vehicles(
        self, points: list[Pose], dice: random.Random, stop: StopRequest
    ) -> int:
        session = self._session
        plan, count = session.scenario.vehicles, 0
        for place in points:
            stop.check()
            if count == plan.count:
                break
            blueprint = dice.choice(self._vehicles)
            randomise(blueprint, dice)
            vehicle = session.world.try_spawn_actor(blueprint, place)
            if vehicle is None:
                continue
            session.own(vehicle)
            _drive(session, vehicle)
            _light(session, vehicle, plan.lights)
            if plan.automatic_lights:
                manager = session.client.get_trafficmanager(_port(session))
                manager.update_vehicle_lights(vehicle, True)
            count += 1
        return count

    def _spawn_walkers(self, dice: random.Random, stop: StopRequest) -> int:
        session = self._session
        plan, world = session.scenario.walkers, session.world
        if not plan.count:
            return 0
        seed = session.seed
        if plan.seed is not None:
            # Its seed changes in the same way as the scenario's.
            seed = plan.seed + session.seed - session.scenario.seed
        world.set_pedestrians_seed(seed)
        world.set_pedestrians_cross_factor(plan.cross_percent / 100)
        gaits = (*[0] * plan.standing, *[1] * plan.walking, *[2] * plan.running)
        count, walking = 0, []
        for gait in gaits:
            stop.check()
            walker = _spawn_walker(session, dice.choice(self._walkers))
            if walker is None:
                continue
            count += 1
            leader = self._controller if gait else None
            controller = (
                None
                if leader is None  # one without attributes is false
                else _spawn_controller(session, leader, walker)
            )
            if controller is not None:
                walking.append((controller, _speed(walker, gait)))
        # Controllers find their walkers only after a tick.
        session.tick()
        for controller, speed in walking:
            stop.check()
            session.at_end("stop a walker", controller.stop)
            controller.start()
            destination = session.world.get_random_location_from_navigation()
            if destination is not None:
                controller.go_to_location(destination)
            controller.set_max_speed(speed)
        return count


def _vehicles(session: CaptureSession) -> list[Blueprint]:
    plan = session.scenario.vehicles
    if not plan.count:
        return []
    generation = plan.generation
    blueprints = choose_blueprints(session.world, plan.filter, generation, "vehicles")
    blueprints = with_wheels(blueprints, plan.wheels, "vehicles")
    if plan.safe:
        typed = (each for each in blueprints if each.has_attribute("base_type"))
        blueprints = [
            each
            for each in typed
            if each.get_attribute("base_type").as_str() in _SAFE_BASE_TYPES
        ]
        if not blueprints:
            raise ScenarioError("vehicles.safe: no blueprint that is left is a car")
    for pattern in plan.exclude:
        blueprints = [each for each in blueprints if not fnmatchcase(each.id, pattern)]
    if not blueprints:
        raise ScenarioError("vehicles.exclude: it leaves no blueprint")
    return blueprints


def _port(session: CaptureSession) -> int:
    return session.scenario.traffic_manager.port


def _drive(session: CaptureSession, actor: Actor) -> None:
    if not isinstance(actor, Vehicle):
        raise CaptureError(f"{actor.type_id} is not a vehicle: it cannot drive")
    actor.set_autopilot(True, _port(session))


def _light(session: CaptureSession, actor: Actor, names: Sequence[str]) -> None:
    if not names:
        return
    if not isinstance(actor, Vehicle):
        raise CaptureError(f"{actor.type_id} is not a vehicle: it has no lights")
    actor.set_light_state(light_state(session.carla, names))


def light_state(carla: Carla, names: Sequence[str]) -> object:
    """`carla.VehicleLightState` with these lights on."""
    flags = carla.VehicleLightState
    bits = reduce(lambda state, name: state | int(getattr(flags, name)), names, 0)
    return flags(bits)


def _spawn_walker(session: CaptureSession, blueprint: Blueprint) -> Actor | None:
    if blueprint.has_attribute("is_invincible"):
        blueprint.set_attribute("is_invincible", "false")
    for _ in range(_TRIES):
        location = session.world.get_random_location_from_navigation()
        if location is None:
            continue
        place = session.carla.Transform(location)
        walker = session.world.try_spawn_actor(blueprint, place)
        if walker is not None:
            return session.own(walker)
    return None


def _spawn_controller(
    session: CaptureSession, blueprint: Blueprint, walker: Actor
) -> WalkerController | None:
    place = session.carla.Transform()
    actor = session.world.try_spawn_actor(blueprint, place, walker)
    if actor is None:
        return None
    session.own(actor)
    if not isinstance(actor, WalkerController):
        raise CaptureError(f"{actor.type_id} cannot lead a walker")
    return actor


def _speed(walker: Actor, gait: int) -> float:
    """The walker's own speed: its blueprint recommends standing, walking, running."""
    usual = (0.0, 1.4, 3.0)[gait]
    text = dict(walker.attributes).get("speed", "")
    try:
        own = float(text)
    except ValueError:
        return usual
    return own if gait == 1 and own > 0 else usual
