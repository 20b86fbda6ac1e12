"""Changes the state of a simulator for a capture, and restores it at the end.

`open_session` switches the scenario's map to synchronous mode. When its block ends,
also after an error, it undoes each change that can be undone; docs/capture.md lists
those that cannot. Signals (SIGINT, SIGTERM, SIGHUP) do not end the process at once:
within `listening_for_stop` they only make a request, which the capture checks between
two steps and after the simulator's state is restored.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from types import FrameType
from typing import Final

from filter_core.values import nearest
from unghost.capture.scenario import Scenario, short_name
from unghost.capture.simulator import (
    Actor,
    Carla,
    Client,
    GlassWorld,
    ScenarioError,
    World,
    WorldSnapshot,
)

Note = Callable[[str], None]
"""Prints a warning that does not end the capture."""
_BATCH: Final = 100
"""Actors that are destroyed by one call."""
_SIGNALS: Final = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
    if hasattr(signal, name)
)
_HANG_UP: Final = getattr(signal, "SIGHUP", None)


@contextmanager
def open_session(
    carla: Carla, client: Client, scenario: Scenario, note: Note
) -> Iterator[CaptureSession]:
    """The scenario's map in synchronous mode, until the block ends.

    Afterwards the settings are those of before, the traffic manager is asynchronous
    again, and every actor that was spawned is gone: after an error and Ctrl-C too. What
    could not be restored is reported with `note`. Use it within `listening_for_stop`:
    otherwise a signal could interrupt the restoring.

    Raises `ScenarioError`: the map is unknown; names the nearest.
    """
    before = client.get_world().get_settings()
    if before.synchronous_mode:
        note("the world is in synchronous mode already; maybe another client ticks it")
    world = client.get_world()
    there = short_name(world.get_map().name)
    if scenario.map is not None and there != short_name(scenario.map):
        require_maps(client, scenario)
        world = client.load_world(scenario.map)
    session = CaptureSession(
        carla=carla,
        client=client,
        world=world,
        scenario=scenario,
        note=note,
        server_version=client.get_server_version(),
        client_version=client.get_client_version(),
        map_name=short_name(world.get_map().name),
        seed=scenario.seed,
    )
    try:
        session.at_end("restore the settings", lambda: world.apply_settings(before))
        _set_up_world(session)
        session.at_end("destroy the actors", session.destroy_actors)
        yield session
    finally:
        session.put_back()


@dataclass(eq=False, kw_only=True)
class Scene:
    """A world whose boxes are annotated.

    `scenario` says which sensors there are, and which objects get boxes; `map_name` has
    no folders: ``Town10HD``.
    """

    carla: Carla
    world: World
    scenario: Scenario
    server_version: str
    client_version: str
    map_name: str


@dataclass(eq=False, kw_only=True)
class CaptureSession(Scene):
    """The simulator during one capture, and the changes to be undone.

    `seed` is the scenario's plus the number of frames that are recorded already, so
    that a continued capture does not show the same traffic again; `frame` is the
    world's last tick.
    """

    client: Client
    note: Note
    seed: int = 0
    frame: int = 0
    _undo: list[tuple[str, Callable[[], object]]] = field(default_factory=list)
    _actors: list[int] = field(default_factory=list)

    def own(self, actor: Actor) -> Actor:
        """An actor that this capture spawned and will destroy."""
        self._actors.append(actor.id)
        return actor

    def at_end(self, what: str, step: Callable[[], object]) -> None:
        """Add a function that is called when the capture ends, the last one first."""
        self._undo.append((what, step))

    def tick(self) -> WorldSnapshot | None:
        """The world one tick later; None if somebody else ticked it, too."""
        before = self.frame
        self.frame = self.world.tick(self.scenario.timeout_s)
        snapshot = self.world.get_snapshot()
        alone = before in (0, self.frame - 1) and snapshot.frame == self.frame
        return snapshot if alone else None

    def put_back(self) -> None:
        """Undo all changes; if a step fails, the others are still done.

        If the simulator is gone, it stops, because each step would wait for a time-out.
        """
        while self._undo:
            what, step = self._undo.pop()
            try:
                step()
            except Exception as error:
                self._say(f"cannot {what}: {error}")
                if not self._answers():
                    self._say(
                        "the simulator does not respond: its settings were not restored"
                    )
                    return

    def _answers(self) -> bool:
        try:
            self.world.get_settings()
        except RuntimeError:
            return False
        return True

    def _say(self, text: str) -> None:
        # The terminal may have been closed; the world is restored all the same.
        with suppress(OSError):
            self.note(text)

    def destroy_actors(self) -> None:
        """Destroy all that was spawned, the youngest first: sensors, then vehicles."""
        destroy = self.carla.command.DestroyActor
        while self._actors:
            batch = [destroy(self._actors.pop()) for _ in self._actors[-_BATCH:]]
            for answer in self.client.apply_batch_sync(batch, False):
                # An actor may be gone already, for example after a reload of the map.
                if answer.error and "not found" not in answer.error:
                    self._say(f"an actor could not be destroyed: {answer.error}")


def require_maps(client: Client, scenario: Scenario) -> None:
    """Check that the simulator has the map of a scenario, or all its maps.

    Raises `ScenarioError`: it lacks one; names the nearest.
    """
    there = [short_name(name) for name in client.get_available_maps()]
    key = "maps" if scenario.maps else "map"
    for name in scenario.maps or filter(None, [scenario.map]):
        if short_name(name) not in there:
            raise ScenarioError(
                f"{key}: the simulator has no {name!r}; the nearest is "
                f"{nearest(name, there)!r}"
            )


def _set_up_world(session: CaptureSession) -> None:
    scenario, carla = session.scenario, session.carla
    settings = session.world.get_settings()
    settings.synchronous_mode = True
    settings.fixed_delta_seconds = scenario.delta_s
    settings.no_rendering_mode = False
    session.world.apply_settings(settings, scenario.timeout_s)
    plan = scenario.traffic_manager
    manager = session.client.get_trafficmanager(plan.port)
    session.at_end(
        "make the traffic manager asynchronous",
        lambda: manager.set_synchronous_mode(False),
    )
    manager.set_synchronous_mode(True)
    manager.set_global_distance_to_leading_vehicle(plan.distance_to_leading_vehicle)
    manager.global_percentage_speed_difference(plan.slower_than_limit_percent)
    manager.set_respawn_dormant_vehicles(plan.respawn_dormant)
    manager.set_hybrid_physics_mode(plan.hybrid_physics)
    if plan.hybrid_physics:
        manager.set_hybrid_physics_radius(plan.hybrid_radius)
    world = session.world
    for name, is_on in scenario.map_layers.items():
        layer = getattr(carla.MapLayer, name)
        if is_on:
            world.load_map_layer(layer)
        else:
            again = partial(world.load_map_layer, layer)
            session.at_end(f"load the map layer {name} again", again)
            world.unload_map_layer(layer)
    see_through = scenario.see_through_glass
    if see_through is None:
        return
    if isinstance(world, GlassWorld):
        world.set_annotations_traverse_translucency(see_through)
    else:
        session.note("see_through_glass: only CARLA 0.9.16 supports it; not changed")


class StopRequest:
    """Whether a signal asked the capture to stop."""

    def __init__(self) -> None:
        self.asked = False

    def check(self) -> None:
        """Raise KeyboardInterrupt if a stop was requested; called between two steps."""
        if self.asked:
            raise KeyboardInterrupt

    def take(self, _number: int, _frame: FrameType | None) -> None:
        """Handle a signal: the next `check` raises."""
        self.asked = True


@contextmanager
def listening_for_stop() -> Iterator[StopRequest]:
    """Turn signals into a request to stop, so that they interrupt no step.

    Then every spawned actor is noted, and all of them are destroyed at the end. In
    another thread than the main one, which gets no signals, nothing is changed.
    """
    request = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield request
        return
    # Under `nohup`, the capture must continue when the terminal is closed.
    kept = signal.SIG_IGN if _HANG_UP is None else signal.getsignal(_HANG_UP)
    before = [
        (each, signal.signal(each, request.take))
        for each in _SIGNALS
        if each != _HANG_UP or kept is not signal.SIG_IGN
    ]
    try:
        yield request
    finally:
        for each, handler in before:
            signal.signal(each, handler)
