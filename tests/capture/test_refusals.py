"""What does not fit is refused with a message before anything is spawned or written.

That is: scenarios that this simulator cannot play, and folders of something else.
"""

import pytest

from unghost.capture.simulator import CaptureError

SHORT_SCENARIO = {"frames": 3, "camera": {"width": 48, "height": 32}}


WRONG = [
    ({"maps": ["Town01", "Town8"]}, "maps: .*no 'Town8'; the nearest is 'Town0"),
    ({"map": "Town10HDD"}, "map: .*the nearest is 'Town10HD'"),
    (
        {"ego": {"blueprint": "vehicle.tesla.modl3"}},
        "ego.blueprint: .*'vehicle.tesla.m",
    ),
    ({"ego": {"spawn_point": 9}}, "ego.spawn_point: Town10HD has 0 to 4, found 9"),
    ({"vehicles": {"count": 1, "filter": "vehicle.x.*"}}, "vehicles.filter: no bluep"),
    (
        {"vehicles": {"count": 1, "filter": "vehicle.bh.*", "wheels": 4}},
        "vehicles.wheels: no blueprint has 4 wheels",
    ),
    (
        {"vehicles": {"count": 1, "filter": "vehicle.tesla.*", "generation": 1}},
        "vehicles.generation: ",
    ),
    (
        {"sensors": {"rgb": {"attributes": {"gama": 2}}}},
        "sensors.rgb.attributes.gama: .*the nearest is 'gamma'",
    ),
    ({"sensors": {"lidar": {"attributes": {"rnge": 2}}}}, "nearest is 'range'"),
    ({"camera": {"lens": {"lens_kk": 2}}}, "camera.lens.lens_kk: .*'lens_k'"),
]


@pytest.mark.parametrize(("changes", "words"), WRONG, ids=lambda v: str(v)[:40])
def test_invalid_scenario_is_refused_before_spawning_actors(stage, changes, words):
    before = len(stage.simulator.spawned)

    with pytest.raises(CaptureError, match=words):
        stage.capture(**changes)

    assert len(stage.simulator.spawned) == before
    assert stage.left_behind() == {}


def test_only_vehicles_that_found_a_spawn_point_are_counted(stage):
    done = stage.capture(vehicles={"count": 50}, frames=1)

    assert done.vehicles == 4


def test_damaged_manifest_is_refused_and_unchanged(stage):
    stage.capture(**SHORT_SCENARIO)
    path = stage.folder / "manifest.jsonl"
    damaged = b'{"key": 1\n' + path.read_bytes()
    path.write_bytes(damaged)

    with pytest.raises(CaptureError, match=r"manifest\.jsonl is damaged"):
        stage.capture(**SHORT_SCENARIO)

    assert path.read_bytes() == damaged
    assert stage.left_behind() == {}


@pytest.mark.parametrize(
    ("ego", "words"),
    [
        ({"autopilot": True}, "not a vehicle: it cannot drive"),
        ({"autopilot": False, "lights": ["Fog"]}, "not a vehicle: it has no lights"),
    ],
)
def test_vehicle_options_are_refused_for_other_blueprints(stage, ego, words):
    walker = {"blueprint": "walker.pedestrian.0001", "spawn_point": 0}

    with pytest.raises(CaptureError, match=words):
        stage.capture(**SHORT_SCENARIO, ego={**walker, **ego})

    assert stage.left_behind() == {}
