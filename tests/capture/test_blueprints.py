"""How a scenario chooses blueprints, and how their attributes are set for CARLA."""

import json

import pytest

from unghost.capture.simulator import ScenarioError

SHORT_SCENARIO = {"frames": 1, "camera": {"width": 48, "height": 32}, "walkers": {}}


def spawned(stage, **vehicles):
    """The kinds of vehicles that a capture spawned, without the ego vehicle."""
    stage.capture(
        **SHORT_SCENARIO, vehicles={"count": 3, "filter": "vehicle.*", **vehicles}
    )
    return {kind for kind in stage.simulator.spawned[2:] if kind.startswith("vehicle.")}


@pytest.mark.parametrize(
    ("options", "kinds"),
    [
        ({"wheels": 2}, {"vehicle.bh.crossbike"}),
        ({"wheels": 4, "generation": 1}, {"vehicle.mitsubishi.fusorosa"}),
    ],
    ids=str,
)
def test_wheels_and_generation_filter_vehicle_blueprints(stage, options, kinds):
    assert spawned(stage, **options) == kinds


WRONG = [
    ({"lidar": {"attributes": {"range": "10 m"}}}, "range: expected a number"),
    ({"lidar": {"attributes": {"range": True}}}, "range: expected a number"),
    ({"radar": {"attributes": {"range": "1e999"}}}, "range: expected a number"),
    ({"lidar": {"attributes": {"channels": 32.5}}}, "channels: expected a whole numb"),
    ({"radar": {"attributes": {"points_per_second": "56k"}}}, "a whole number.*'56k'"),
]


@pytest.mark.parametrize(("sensors", "words"), WRONG, ids=str)
def test_invalid_sensor_attribute_value_is_refused(stage, sensors, words):
    with pytest.raises(ScenarioError, match=f"sensors.*attributes.*{words}"):
        stage.capture(**SHORT_SCENARIO, sensors=sensors)

    assert stage.left_behind() == {}


def test_corrected_scenario_is_accepted_in_the_same_folder(stage):
    with pytest.raises(ScenarioError, match=r"ego\.blueprint"):
        stage.capture(**SHORT_SCENARIO, ego={"blueprint": "vehicle.tesla.modl3"})

    done = stage.capture(**SHORT_SCENARIO, ego={"blueprint": "vehicle.tesla.model3"})

    assert done.frames == 1
    about = json.loads((stage.folder / "capture.json").read_text())
    assert about["scenario"]["ego"]["blueprint"] == "vehicle.tesla.model3"


def test_generation_filters_walkers_and_whole_numbers_are_passed_as_such(stage):
    seen: list[str] = []
    stage.simulator.faults.on_tick = lambda server, _: seen.extend(
        actor.attributes["channels"]
        for actor in server.actors.values()
        if "lidar" in actor.type_id
    )
    walkers = {"walkers": {"standing": 1, "generation": 1}}
    sensors = {"lidar": {"attributes": {"channels": 16.0}}}

    done = stage.capture(**{**SHORT_SCENARIO, **walkers}, sensors=sensors)

    assert (done.walkers, set(seen)) == (1, {"16"})
