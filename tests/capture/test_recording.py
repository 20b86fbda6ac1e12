"""What a capture writes: frames, images, points, boxes and their attributes.

The filter reads the folder and keeps visible objects and rejects hidden ones.
"""

from itertools import pairwise
from typing import Any

import carla
import cv2
import numpy as np
import pytest

from filter_core import FilterConfig
from filter_core.evidence.depth import read_depth
from filter_core.evidence.instances import read_instances
from filter_core.evidence.lidar import read_points
from filter_core.formats.registry import read_source
from filter_core.local import filter_source
from tests.support.fake_carla.scenarios import scenario

FAR = {"attributes": {"range": 50}}
ALL_SENSORS: dict[str, Any] = {"instances": True, "depth": True, "radar": True}
ALL_SENSORS |= {"lidar": FAR, "semantic_lidar": FAR}


@pytest.fixture(scope="module")
def recorded(make_shared_stage):
    """A stage on which four frames were recorded with all sensors, and the outcome."""
    stage = make_shared_stage()
    return stage, stage.capture(sensors=ALL_SENSORS, frames=4)


def keys(count, **changes):
    """The keys that the first `count` frames of the changed scenario get."""
    take = f"Town10HD/{scenario(**changes).digest[:8]}"
    return [f"{take}/{number:06d}" for number in range(count)]


def verdicts(stage, **config):
    """The paper's verdict on each box of the first frame, by the box's id."""
    by_tags = FilterConfig(profile="paper", **config)
    outcomes = filter_source(read_source(stage.folder), by_tags, workers=1)
    first = next(iter(outcomes))
    assert first.decisions is not None
    return {box["id"]: box["verdict"] for box in first.decisions}


def read_image(stage, name):
    """An image file of the recorded folder, as an array of pixels."""
    read = cv2.imread(str(stage.folder / name), cv2.IMREAD_UNCHANGED)
    assert read is not None
    return read


def actor_ids_by_position(stage):
    """The ids of the first frame's actors, by their position (x, y)."""
    boxes = stage.frames()[0]["boxes"]
    placed = [box for box in boxes if "transform" in box["box3d"]]
    return {
        (box["box3d"]["transform"]["x"], box["box3d"]["transform"]["y"]): box["id"]
        for box in placed
    }


@pytest.mark.parametrize("evidence", ["semantic", "depth", "instance"])
def test_ghosts_are_rejected_and_visible_objects_are_kept(recorded, evidence):
    stage, _ = recorded

    said, at = verdicts(stage, evidence=evidence), actor_ids_by_position(stage)

    assert {place: said[pixel] for place, pixel in at.items()} == {
        (15, -3): "kept",
        (24, 5): "kept",
        (35, -17): "rejected",
        (-20, 0): "rejected",
        (12, 4): "kept",
        (30, -14): "rejected",
    }
    assert stage.left_behind() == {}


def test_every_frame_has_a_key_and_its_files(recorded):
    stage, done = recorded

    frames = stage.frames()
    assert (done.frames, done.added, done.missed.total()) == (4, 4, 0)
    assert [frame["key"] for frame in frames] == keys(4, sensors=ALL_SENSORS)
    ticks = [frame["extra"]["capture"]["frame"] for frame in frames]
    assert {b - a for a, b in pairwise(ticks)} == {2}
    for frame in frames:
        for kind in ("image", "segmentation", "instances", "depth", "lidar", "radar"):
            assert (stage.folder / frame[kind]).stat().st_size > 0


def test_images_of_every_kind_are_stored_losslessly(recorded):
    stage, _ = recorded

    frame = stage.frames()[0]
    shown = read_image(stage, frame["image"])
    tags = read_image(stage, frame["segmentation"])
    depth = read_depth((stage.folder / frame["depth"]).read_bytes())
    ids = read_instances((stage.folder / frame["instances"]).read_bytes())
    sky, road = (0, 80), (95, 80)
    assert shown[sky].tolist() == [180, 130, 70]  # as BGR
    assert tags.shape == (96, 160)
    assert set(np.unique(tags)) == {1, 3, 7, 11, 12, 14}
    metres = depth.metres((slice(None), slice(None)))
    assert metres[sky] == pytest.approx(1000)
    # The camera is 2.4 m above the road. The centre of the last row is half a pixel
    # less than half the image below the horizon, which gives the distance.
    assert metres[road] == pytest.approx(2.4 * 80 / 47.5, abs=1e-3)
    seen = {int(number) for number in np.unique(ids.ids[tags == 14])}
    at = actor_ids_by_position(stage)
    assert {int(at[15, -3]), int(at[24, 5])} <= seen


def test_lidar_and_radar_points_are_stored_as_measured(recorded):
    stage, _ = recorded

    frame = stage.frames()[0]
    xyz, tags = read_points((stage.folder / frame["lidar"]).read_bytes())
    plain = frame["extra"]["files"]["lidar_intensity"]
    radar = (stage.folder / frame["radar"]).read_bytes()
    assert len(xyz) == len(tags) > 100
    assert np.linalg.norm(xyz, axis=1).max() <= 50.001
    assert {1, 14} <= set(tags.tolist())
    assert b"property float intensity" in (stage.folder / plain).read_bytes()
    header, body = radar.split(b"end_header\n")
    assert b"element vertex 3" in header
    x, y, z, velocity, *_ = np.frombuffer(body, "<f4").reshape(3, 7)[1]
    assert (velocity, z) == (0, 0)
    assert np.hypot(x, y) == pytest.approx(25)
    assert np.arctan2(y, x) == pytest.approx(-0.2)


def test_attributes_of_actors_and_boxes_of_the_map_are_stored_once(stage):
    done = stage.capture()

    boxes = {box["id"]: box for box in stage.frames()[0]["boxes"]}
    car = boxes[actor_ids_by_position(stage)[15, -3]]
    assert car["type_id"] == "vehicle.tesla.model3"
    assert (car["class"], car["base_type"]) == ("car", "car")
    assert car["extra"]["semantic_tags"] == [14]
    assert (car["extra"]["source"], car["extra"]["band"]) == ("actor", 50)
    assert car["instance_id"] == int(car["id"])
    walker = boxes[actor_ids_by_position(stage)[12, 4]]
    assert walker["extra"]["flags"] == ["capsule", "widened"]
    assert walker["extra"]["box_given"]["extent"]["x"] == pytest.approx(0.188)
    assert walker["box3d"]["extent"]["x"] == pytest.approx(0.338)
    lights = [box for name, box in boxes.items() if name.startswith("light-")]
    assert all("semantic_tags" not in box["extra"] for box in lights)
    said = {name: v for name, v in verdicts(stage).items() if "-" in name}

    parked = {f"env-{2**40 + n}": "kept" for n in (1, 2)}
    lit = {name: "kept" for name in said if name.startswith("light-")}
    assert len(lit) == 2
    assert said == parked | lit
    assert done.left_out == {"impossible_box": 2}


@pytest.mark.parametrize("is_repaired", [True, False])
def test_two_wheeler_without_width_gets_the_default_size_or_is_left_out(
    stage, is_repaired
):
    done = stage.capture(
        vehicles={"count": 1, "filter": "vehicle.bh.*"},
        walkers={},
        boxes={"repair_two_wheelers": is_repaired, "parked_vehicles": False},
        frames=1,
    )

    boxes = [b for b in stage.frames()[0]["boxes"] if b["class"] == "bicycle"]
    # One that is left out in any case is a pedestrian's button.
    assert done.left_out["impossible_box"] == (1 if is_repaired else 2)
    assert len(boxes) == is_repaired
    for box in boxes:
        assert box["extra"]["flags"] == ["default_size"]
        assert box["box3d"]["extent"] == {"x": 0.82, "y": 0.3, "z": 0.85}
        assert box["box3d"]["location"] == {"x": 0, "y": 0, "z": 0.85}
        assert box["extra"]["box_given"]["location"]["y"] == 40


def test_object_in_map_and_actors_is_recorded_once(stage):
    for thing in stage.simulator.environment[:1]:
        thing.bounding_box.location = carla.Location(24, 5, 0.75)

    done = stage.capture(frames=1)

    ids = [box["id"] for box in stage.frames()[0]["boxes"]]
    assert f"env-{2**40 + 1}" not in ids
    assert done.left_out["duplicate"] == 1


def test_traffic_lights_missing_from_the_map_come_from_the_level(stage):
    stage.simulator.faults.no_light_boxes = True

    stage.capture(frames=1)

    boxes = [b for b in stage.frames()[0]["boxes"] if b["class"] == "traffic_light"]
    assert [box["extra"]["source"] for box in boxes] == ["level", "level"]
    assert boxes[1]["extra"]["flags"] == ["thickened"]


def lights_of_vehicles(server):
    """The state of the lights of each vehicle of the simulator."""
    return [
        actor.get_light_state()
        for actor in server.actors.values()
        if actor.type_id.startswith("vehicle.")
    ]


def test_weather_lights_layers_and_classes_follow_the_scenario(stage):
    seen = []
    stage.simulator.faults.on_tick = lambda server, _: seen.append(
        (list(server.layers_off), lights_of_vehicles(server))
    )

    stage.capture(
        frames=3,
        map_layers={"ParkedVehicles": False},
        weather={
            "preset": "HardRainNoon",
            "sweep": {"fog_density": {"first": 0, "last": 50}},
        },
        ego={"spawn_point": 0, "lights": ["LowBeam"]},
        classes={"vehicle.tesla.model3": "taxi"},
    )

    frames = stage.frames()
    assert [frame["weather"]["fog_density"] for frame in frames] == [0, 25, 50]
    assert {frame["weather"]["precipitation"] for frame in frames} == {100}
    assert {layers[0] for layers, _ in seen} == {"ParkedVehicles"}
    assert all(carla.VehicleLightState.LowBeam in lights for _, lights in seen)
    classes = {box["class"] for box in frames[0]["boxes"]}
    assert {"taxi", "walker"} <= classes
    assert stage.left_behind() == {}


def test_walkers_stand_walk_and_run_as_configured(stage):
    seen = {}

    def look(server, _tick):
        for actor in server.actors.values():
            if actor.type_id.startswith("controller."):
                seen[actor.id] = (actor.walking, actor.speed)

    stage.simulator.sidewalk += [carla.Location(8, 9, 1), carla.Location(9, -9, 1)]
    stage.simulator.faults.on_tick = look

    done = stage.capture(frames=1, walkers={"standing": 1, "walking": 2, "running": 1})

    assert done.walkers == 4
    assert sorted(seen.values()) == [(True, 1.4), (True, 1.4), (True, 3.0)]
    assert stage.left_behind() == {}


def test_lidar_rotates_once_per_tick_unless_configured_otherwise(stage):
    turns = {}

    def look(server, _tick):
        for actor in server.actors.values():
            if "lidar" in actor.type_id:
                turns[actor.type_id] = float(actor.attributes["rotation_frequency"])

    stage.simulator.faults.on_tick = look
    slow = {"attributes": {"rotation_frequency": 5}}

    stage.capture(frames=1, sensors={"semantic_lidar": True, "lidar": slow})

    assert turns == {"sensor.lidar.ray_cast_semantic": 20, "sensor.lidar.ray_cast": 5}


def test_resumed_capture_does_not_repeat_its_traffic(stage):
    people = {"standing": 1, "seed": 40}
    recorded = []
    for frames in (1, 2):
        stage.capture(frames=frames, walkers=people)
        boxes = [b for b in stage.frames()[-1]["boxes"] if b["class"] == "car"]
        poses = [b["box3d"].get("transform") for b in boxes]
        recorded.append((poses, stage.simulator.pedestrian_seed))

    (first, seed), (later, later_seed) = recorded
    assert first != later
    assert (seed, later_seed) == (40, 41)


@pytest.mark.parametrize("layer", ["ParkedVehicles", "All"])
def test_parked_cars_of_a_removed_map_layer_get_no_boxes(stage, layer):
    stage.capture(frames=1, map_layers={layer: False})

    ids = [box["id"] for box in stage.frames()[0]["boxes"]]
    assert [box_id for box_id in ids if box_id.startswith("env-")] == []


def test_interrupted_capture_resumes_after_the_last_complete_frame(stage):
    stage.capture(frames=2)
    with (stage.folder / "manifest.jsonl").open("ab") as file:
        file.write(b'{"key": "Town10HD/000002", "ima')

    done = stage.capture(frames=4)

    assert (done.frames, done.added) == (4, 2)
    assert [frame["key"] for frame in stage.frames()] == keys(4)
    again = stage.capture(frames=4)
    assert (again.frames, again.added) == (4, 0)
    assert stage.left_behind() == {}
