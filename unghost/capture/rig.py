"""The sensors on the ego vehicle, and their measurements of one tick.

All cameras have the same pose, so that their images agree pixel by pixel. Each sensor
puts its measurements into a queue of its own, from a thread of CARLA's library.
`collect` takes the measurements of one tick from all queues, or none: measurements of
different ticks are never mixed.
"""

from __future__ import annotations

import queue
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeAlias, TypeVar

from unghost.capture.blueprints import find_blueprint, set_attributes
from unghost.capture.scenario import (
    AttributeValue,
    CameraSensor,
    Mount,
    RangeSensor,
    Scenario,
)
from unghost.capture.session import CaptureSession
from unghost.capture.simulator import (
    Actor,
    Blueprint,
    CaptureError,
    Carla,
    Measurement,
    Pose,
    Sensor,
)

T = TypeVar("T")

BLUEPRINTS: Final[Mapping[str, str]] = {
    "rgb": "sensor.camera.rgb",
    "segmentation": "sensor.camera.semantic_segmentation",
    "instances": "sensor.camera.instance_segmentation",
    "depth": "sensor.camera.depth",
    "lidar": "sensor.lidar.ray_cast",
    "semantic_lidar": "sensor.lidar.ray_cast_semantic",
    "radar": "sensor.other.radar",
}
"""CARLA's sensor for each key of a scenario's `sensors`."""
_TURNING: Final = ("lidar", "semantic_lidar")
"""By default one turn per tick: with fewer, a measurement is a part of the circle."""
CAMERAS: Final = ("rgb", "segmentation", "instances", "depth")
"""The sensors that deliver images; the others deliver points."""
_LOOK_EVERY_S: Final = 0.2
"""The interval of checks for a stop request while waiting for a sensor."""
MOST_MISSED: Final = 20
"""Ticks in a row without a complete frame that end a capture."""
NO_DATA: Final = "sent nothing in time"
FROM_LATER: Final = "sent a later tick"

MountedSensor: TypeAlias = tuple[str, Blueprint, Mount]
"""A sensor to be spawned: its name, its blueprint and its mount."""


@dataclass(eq=False)
class RunningSensor:
    """A sensor that delivers into a queue."""

    name: str
    actor: Actor
    inbox: queue.Queue[Measurement] = field(default_factory=queue.Queue)


def recorded_sensors(scenario: Scenario) -> dict[str, CameraSensor | RangeSensor]:
    """The sensors that a scenario records, by name, in one order."""
    chosen = ((name, getattr(scenario.sensors, name)) for name in BLUEPRINTS)
    return {name: sensor for name, sensor in chosen if sensor is not None}


def main_camera(scenario: Scenario) -> str:
    """The camera whose pose is the frame's."""
    return "rgb" if scenario.sensors.rgb is not None else "segmentation"


def prepare_rig(session: CaptureSession) -> list[MountedSensor]:
    """Blueprints with all attributes set; `ScenarioError` names a wrong key."""
    camera, mounted = session.scenario.camera, []
    for name, sensor in recorded_sensors(session.scenario).items():
        at, mount = f"sensors.{name}", camera.mount
        blueprint = find_blueprint(session.world, BLUEPRINTS[name], at)
        shared: dict[str, AttributeValue] = {"sensor_tick": 0.0}
        if isinstance(sensor, RangeSensor):
            mount = sensor.mount
            if name in _TURNING:
                shared["rotation_frequency"] = 1 / session.scenario.delta_s
        else:
            shared["image_size_x"], shared["image_size_y"] = camera.width, camera.height
            shared["fov"] = camera.fov
            set_attributes(blueprint, camera.lens, "camera.lens")
        set_attributes(blueprint, shared, at)
        set_attributes(blueprint, sensor.attributes, f"{at}.attributes")
        mounted.append((name, blueprint, mount))
    return mounted


def start_rig(
    session: CaptureSession, mounted: Sequence[MountedSensor], ego: Actor
) -> list[RunningSensor]:
    """Spawn the sensors and let them deliver."""
    carla = session.carla
    running = []
    for name, blueprint, mount in mounted:
        actor = session.world.spawn_actor(
            blueprint, pose_of(carla, mount), ego, carla.AttachmentType.Rigid
        )
        sensor = RunningSensor(name, session.own(actor))
        if not isinstance(actor, Sensor):
            raise CaptureError(f"{blueprint.id} is not a sensor")
        session.at_end(f"stop the sensor {name}", actor.stop)
        # Called in a thread of the library: it must do nothing but put.
        actor.listen(sensor.inbox.put)
        running.append(sensor)
    return running


def pose_of(carla: Carla, mount: Mount) -> Pose:
    """A `carla.Transform` of a mount."""
    location = carla.Location(mount.x, mount.y, mount.z)
    return carla.Transform(location, carla.Rotation(mount.pitch, mount.yaw, mount.roll))


@dataclass(frozen=True)
class Missed:
    """Why a tick is incomplete: a word for programs, and the sensor."""

    reason: str
    sensor: str = ""

    def __str__(self) -> str:
        return f"{self.sensor} {self.reason}" if self.sensor else self.reason


def first_complete(try_tick: Callable[[], T | Missed], missed: Counter[str]) -> T:
    """What comes of the first tick that all sensors measured; counts those before it.

    Raises `CaptureError` if there is none among many.
    """
    reasons: Counter[str] = Counter()
    while reasons.total() < MOST_MISSED:
        outcome = try_tick()
        if not isinstance(outcome, Missed):
            return outcome
        reasons[str(outcome)] += 1
        missed[str(outcome)] += 1
    reason, count = reasons.most_common(1)[0]
    raise CaptureError(
        f"no complete frame in {MOST_MISSED} ticks, {count} times because {reason}"
    )


def collect(
    sensors: Sequence[RunningSensor],
    frame: int,
    wait_s: float,
    *,
    check: Callable[[], None],
) -> dict[str, Measurement] | Missed:
    """The measurements of all sensors at one tick, or why they are incomplete.

    They are by the sensors' names. Measurements of earlier ticks are discarded. One of
    a later tick means that the measurement of this tick was lost. `frame` is the tick,
    as `carla.World.tick` counts; all sensors share `wait_s` seconds. `check` is called
    while waiting, and may raise.
    """
    deadline = time.monotonic() + wait_s
    taken: dict[str, Measurement] = {}
    for sensor in sensors:
        measurement = _take(sensor, frame, deadline, check)
        if isinstance(measurement, Missed):
            return measurement
        taken[sensor.name] = measurement
    return taken


def _take(
    sensor: RunningSensor, frame: int, deadline: float, check: Callable[[], None]
) -> Measurement | Missed:
    while True:
        check()
        left = max(0.0, deadline - time.monotonic())
        wait = min(left, _LOOK_EVERY_S)
        try:
            measurement = (
                sensor.inbox.get(timeout=wait) if left else sensor.inbox.get_nowait()
            )
        except queue.Empty:
            if left > wait:
                continue
            return Missed(NO_DATA, sensor.name)
        if measurement.frame == frame:
            return measurement
        if measurement.frame > frame:
            return Missed(FROM_LATER, sensor.name)


def drain(sensors: Sequence[RunningSensor]) -> None:
    """Discard what has arrived: measurements of ticks that are not recorded."""
    for sensor in sensors:
        while True:
            try:
                sensor.inbox.get_nowait()
            except queue.Empty:
                break
