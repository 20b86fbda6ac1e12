"""Captures that carlasimu's own seven files describe, on the fake simulator."""

from typing import Any

import carla

from tests.support.fake_carla.simulator import at
from tests.support.shared_data import shared
from unghost.capture.carlasimu import convert_carlasimu


def small_scenario(frames: int) -> dict[str, Any]:
    """The scenario of its files, with few and small frames."""
    files = shared("oracles/carlasimu_yaml")
    converted, _ = convert_carlasimu(files)
    scenario: dict[str, Any] = converted
    camera = {**scenario["camera"], "width": 64, "height": 36}
    return {**scenario, "frames": frames, "interval_s": 0.1, "camera": camera}


def test_scenario_of_carlasimus_own_files_is_recorded(stage):
    simulator = stage.simulator
    simulator.spawn_points += [at(140, y) for y in range(0, 200, 4)]

    done = stage.capture(**small_scenario(frames=2))

    assert (done.frames, stage.left_behind()) == (2, {})
    kinds = {name for name in simulator.spawned if name.startswith("vehicle.")}
    assert {"vehicle.carlamotors.european_hgv", "vehicle.mercedes.sprinter"} <= kinds
    # What its `safe` leaves out, and what has two wheels.
    assert kinds.isdisjoint(
        f"vehicle.{name}"
        for name in ("carlamotors.carlacola", "carlamotors.firetruck", "bh.crossbike")
    )
    boxes = stage.frames()[0]["boxes"]
    assert {"car", "truck", "van", "traffic_light"} <= {box["class"] for box in boxes}
    # Beyond its max_distance of 50 m, which limits what it draws.
    assert {*(50 < box["distance"] < 200 for box in boxes)} == {False, True}


def test_attributes_and_lights_of_carlasimus_own_files_reach_the_simulator(stage):
    cameras, lights = [], []

    def look(server, _tick):
        cameras.append(
            {
                actor.type_id: actor.attributes
                for actor in server.actors.values()
                if actor.type_id.startswith("sensor.")
            }
        )
        vehicles = [a for a in server.actors.values() if a.kind in ("car", "bus")]
        lights.append({int(actor.light_state) for actor in vehicles})

    stage.simulator.faults.on_tick = look
    stage.capture(**small_scenario(frames=1))

    rgb = cameras[-1]["sensor.camera.rgb"]
    assert {*cameras[-1]} == {
        "sensor.camera.rgb",
        "sensor.camera.semantic_segmentation",
    }
    attributes = ("bloom_intensity", "fstop", "lens_x_size")
    assert [rgb[name] for name in attributes] == ["0.675", "1.4", "0.08"]
    # The ego vehicle's, too.
    assert lights[-1] == {int(carla.VehicleLightState.Fog)}
