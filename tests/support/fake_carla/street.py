"""A small street in the fake world whose correct verdicts are known."""

import carla

from tests.support.fake_carla.library import EnvironmentObject
from tests.support.fake_carla.scene import Solid
from tests.support.fake_carla.simulator import Simulator, at

BUILDING, CAR, LIGHT = 3, 14, 7
SEEN = [at(15, -3), at(24, 5)]
BEHIND_WALL = at(35, -17)
BEHIND_CAMERA = at(-20, 0)
WALKER_SEEN = carla.Location(12, 4, 0.93)
WALKER_HIDDEN = carla.Location(30, -14, 0.93)


def street(version: str = "0.9.16", client_version: str | None = None) -> Simulator:
    """Ego at the origin; a wall hides one car and one walker; one car is behind."""
    simulator = Simulator(version, client_version)
    simulator.spawn_points = [at(0, 0), *SEEN, BEHIND_WALL, BEHIND_CAMERA]
    simulator.sidewalk = [WALKER_SEEN, WALKER_HIDDEN]
    simulator.solids.append(Solid(at(20.5, -14), (0, 0, 3), (0.5, 6, 3), BUILDING, 0))
    _park(simulator)
    _light(simulator)
    return simulator


def box(x, y, z, half, yaw=0.0):
    """A `carla.BoundingBox` in the world."""
    made = carla.BoundingBox(carla.Location(x, y, z), carla.Vector3D(*half))
    made.rotation = carla.Rotation(yaw=yaw)
    return made


def _park(simulator):
    """Add boxes of a parked car, of a mirrored one, and of a mere part of a car."""
    label = carla.CityObjectLabel.Car
    boxes = [
        box(14, 9, 0.75, (2.4, 1.0, 0.75)),
        box(26, 11, 0.75, (-2.4, 1.0, 0.75), yaw=10),
        box(14, 9, 0.4, (0.3, 0.3, 0.2)),
    ]
    for number, volume in enumerate(boxes, 1):
        # As in CARLA, the object also has a transform, which does not apply to its box.
        made = EnvironmentObject(
            2**40 + number, f"Car_{number}", label, at(99, 99), volume
        )
        simulator.environment.append(made)
        half = (abs(volume.extent.x), volume.extent.y, volume.extent.z)
        pose = carla.Transform(volume.location, volume.rotation)
        simulator.solids.append(Solid(pose, (0, 0, 0), half, CAR, 0))


def _light(simulator):
    """Add a traffic light with a head, a slim head, and a pedestrian's button."""
    light = simulator.add("traffic.traffic_light", {}, at(22, 9))
    light.semantic_tags = [5, 18]
    light.heads = [
        box(22, 8, 4.5, (0.2, 0.2, 0.5)),
        box(22, 6, 4.5, (0.05, 0.2, 0.5)),
        box(22, 9, 1.0, (0.1, 0.1, 0.1)),
    ]
    simulator.level_boxes = list(light.heads)
    for head in light.heads:
        pose = carla.Transform(head.location, head.rotation)
        half = (head.extent.x, head.extent.y, head.extent.z)
        simulator.solids.append(Solid(pose, (0, 0, 0), half, LIGHT, 0))
