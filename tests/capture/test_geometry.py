"""Geometry as it is stored agrees with what CARLA's real library computes."""

import carla
import numpy as np
import pytest

from filter_core.annotation.frame import frame_boxes_2d
from filter_core.annotation.parsing import parse_annotation
from filter_core.geometry.box3d import boxes3d_vertices
from filter_core.geometry.pose import Transform
from unghost.capture.objects import ObjectIdentity, SeenObject, local_box
from unghost.capture.rig import pose_of
from unghost.capture.scenario import Mount
from unghost.capture.simulator import as_transform
from unghost.capture.traffic import light_state
from unghost.capture.weather import as_numbers, parameters

CAR = ObjectIdentity("7", "actor", "car")
POSES = [
    carla.Transform(carla.Location(*place), carla.Rotation(*turn))
    for place, turn in [
        ((0, 0, 0), (0, 0, 0)),
        ((12.5, -3.25, 0.1), (2, 37, -1)),
        ((-140, 88, 5), (-9, -178.5, 12)),
    ]
]


def given_box():
    box = carla.BoundingBox(
        carla.Location(0.1, -0.05, 0.8), carla.Vector3D(2.4, 1, 0.7)
    )
    box.rotation = carla.Rotation(yaw=4)
    return box


@pytest.mark.parametrize("pose", POSES, ids=str)
@pytest.mark.parametrize("is_of_actor", [True, False], ids=["actor", "map"])
def test_corners_of_a_box_match_the_carla_library(pose, is_of_actor):
    box = given_box()
    if is_of_actor:
        real = box.get_world_vertices(pose)
        seen = SeenObject(CAR, local_box(box), as_transform(pose))
    else:
        box.location, box.rotation = pose.location, pose.rotation
        real = box.get_world_vertices(carla.Transform())
        seen = SeenObject(CAR, local_box(box))

    corners = boxes3d_vertices([seen.row])[0]

    np.testing.assert_allclose(corners, [[v.x, v.y, v.z] for v in real], atol=2e-4)


@pytest.mark.parametrize("pose", POSES, ids=str)
def test_projection_of_annotations_matches_the_matrices_of_the_library(pose):
    ahead = carla.Transform(pose.transform(carla.Location(15, 2, 0)), pose.rotation)
    seen = SeenObject(CAR, local_box(given_box()), as_transform(ahead))
    camera = {"width": 800, "height": 600, "fov": 90}
    annotation = {
        "camera": {**camera, "transform": as_transform(pose).as_dict()},
        "boxes": [seen.as_annotation(15.0, (50,))],
    }

    read = frame_boxes_2d(parse_annotation(annotation), (800, 600))

    to_camera = np.array(pose.get_inverse_matrix())
    world = [[v.x, v.y, v.z, 1] for v in given_box().get_world_vertices(ahead)]
    x, y, z, _ = to_camera @ np.array(world).T
    u, v = 400 + 400 * y / x, 300 - 400 * z / x
    expected = [u.min(), v.min(), u.max(), v.max()]
    np.testing.assert_allclose(read.amodal_xyxy[0], expected, atol=0.05)


def test_mount_weather_and_lights_are_those_of_the_library():
    mount = Mount(x=1.5, y=-0.4, z=2.4, pitch=-5, yaw=30, roll=1)

    pose = as_transform(pose_of(carla, mount))

    assert pose == Transform((1.5, -0.4, 2.4), (-5, 30, 1))
    for preset in (
        carla.WeatherParameters.HardRainNoon,
        carla.WeatherParameters.Default,
    ):
        assert parameters(carla, as_numbers(preset)) == preset
    state = light_state(carla, ["LowBeam", "Fog"])

    assert state == carla.VehicleLightState(
        carla.VehicleLightState.LowBeam | carla.VehicleLightState.Fog
    )
