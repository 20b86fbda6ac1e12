"""Faults during a capture: late or lost measurements, vanished actors, errors, stops.

Every frame that is written is right, the others are counted, and the simulator is
left as it was before.
"""

from itertools import pairwise

import pytest

from tests.support.fake_carla.simulator import at
from unghost.capture.simulator import CaptureError


def ticks(stage):
    """The ticks that were recorded, counted from the first tick of the world."""
    return [frame["extra"]["capture"]["frame"] - 1000 for frame in stage.frames()]


# The first recorded tick: after one in which walkers get their controllers, and ten of
# warm-up. From there on every second tick is recorded.
FIRST_TICK = 12
SMALL_CAMERA = {"width": 48, "height": 32}
SHORT_SCENARIO = {"frames": 3, "interval_s": 0.1, "camera": SMALL_CAMERA}


def test_without_faults_the_planned_ticks_are_recorded(stage):
    done = stage.capture(**SHORT_SCENARIO)

    assert ticks(stage) == [FIRST_TICK, FIRST_TICK + 2, FIRST_TICK + 4]
    assert done.missed.total() == 0
    # Adjacent ticks are stored by older versions only.
    assert not {"before", "after"} & set(stage.frames()[0]["extra"]["capture"])


@pytest.mark.parametrize(
    ("fault", "kind", "sensor"),
    [("lost", "semantic_segmentation", "segmentation"), ("late", "rgb", "rgb")],
)
def test_tick_with_a_lost_or_late_measurement_is_skipped_and_counted(
    stage, fault, kind, sensor
):
    stage.simulator.speed = 40.0
    setattr(stage.simulator.faults, fault, {(kind, FIRST_TICK)})

    done = stage.capture(**SHORT_SCENARIO, sensor_wait_s=2)

    assert ticks(stage) == [FIRST_TICK + 1, FIRST_TICK + 3, FIRST_TICK + 5]
    assert done.missed == {f"{sensor} sent nothing in time": 1}
    assert stage.frames()[0]["extra"]["capture"]["missed_before"] == 1
    assert stage.left_behind() == {}


def test_silent_sensor_ends_the_capture_with_an_error_that_names_it(stage):
    stage.simulator.faults.lost = {("rgb", tick) for tick in range(200)}

    with pytest.raises(CaptureError, match=r"no complete frame in 20 ticks.*rgb sent"):
        stage.capture(camera=SMALL_CAMERA, sensor_wait_s=0.02)

    assert stage.left_behind() == {}


def test_measurement_of_a_later_tick_is_not_recorded(stage):
    def renumber(server, tick):
        sensor = next((a for a in server.actors.values() if "rgb" in a.type_id), None)
        if tick == FIRST_TICK and sensor is not None:
            deliver = sensor.receive

            def receive(shot):
                if shot.frame == 1000 + FIRST_TICK:
                    shot.frame += 3
                deliver(shot)

            sensor.receive = receive

    stage.simulator.faults.on_tick = renumber

    done = stage.capture(**SHORT_SCENARIO)

    assert done.missed == {"rgb sent a later tick": 1}
    assert ticks(stage)[0] == FIRST_TICK + 1


@pytest.mark.parametrize(
    ("version", "used", "x"), [("0.9.15", "snapshot", 1.5), ("0.9.16", "image", 2.5)]
)
def test_both_poses_are_stored_and_the_used_pose_depends_on_version(
    make_stage, version, used, x
):
    stage = make_stage(version)
    stage.simulator.faults.pose_shift = 1.0

    done = stage.capture(**SHORT_SCENARIO)

    frame = stage.frames()[0]
    poses = frame["extra"]["capture"]["poses"]
    assert (poses["image"]["x"], poses["snapshot"]["x"]) == (2.5, 1.5)
    assert poses["used"] == used
    assert frame["camera"]["transform"]["x"] == x
    assert done.poses_differ == 3
    assert [note for note in stage.notes if "another camera pose" in note]


def test_version_with_lagging_images_also_stores_adjacent_ticks(make_stage):
    stage = make_stage("0.9.15")
    stage.simulator.speed = 20.0

    stage.capture(**SHORT_SCENARIO, ego={"spawn_point": 0})

    story = stage.frames()[0]["extra"]["capture"]
    xs = [story["before"]["camera"]["x"], story["poses"]["snapshot"]["x"]]
    xs.append(story["after"]["camera"]["x"])
    assert [b - a for a, b in pairwise(xs)] == pytest.approx([1, 1])
    assert set(story["before"]["actors"]) == set(story["after"]["actors"])
    assert len(story["before"]["actors"]) == 6
    assert ticks(stage) == [FIRST_TICK, FIRST_TICK + 2, FIRST_TICK + 4]


def test_vanished_actor_loses_only_its_own_box(stage):
    def vanish(server, tick):
        if tick == FIRST_TICK + 1:
            cars = [a for a in server.actors.values() if "tesla" in a.type_id]
            server.remove(cars[0].id)

    stage.simulator.faults.on_tick = vanish

    done = stage.capture(**SHORT_SCENARIO)

    counts = [len(frame["boxes"]) for frame in stage.frames()]
    assert counts == [10, 9, 9]
    assert done.missed.total() == 0
    assert stage.left_behind() == {}


@pytest.mark.parametrize(
    ("fault", "reason"), [("boxless", "no_answer"), ("unsnapped", "not_in_snapshot")]
)
def test_actor_without_box_or_snapshot_is_left_out_and_counted(stage, fault, reason):
    def appear(server, tick):
        if tick == FIRST_TICK:
            late = server.add("vehicle.late", {"base_type": "car"}, at(50, 0))
            getattr(server.faults, fault).add(late.id)

    stage.simulator.faults.on_tick = appear

    done = stage.capture(**SHORT_SCENARIO)

    assert done.left_out[reason] == 3
    assert [len(frame["boxes"]) for frame in stage.frames()] == [10, 10, 10]


def test_dormant_actors_have_no_box(stage):
    def sleep(server, tick):
        if tick == FIRST_TICK:
            cars = [a for a in server.actors.values() if "tesla" in a.type_id]
            cars[0].is_dormant = True

    stage.simulator.faults.on_tick = sleep

    done = stage.capture(**SHORT_SCENARIO)

    assert done.left_out["dormant"] == 3


def test_ticks_of_another_client_are_not_recorded(stage):
    stage.simulator.faults.foreign_ticks = {FIRST_TICK}

    done = stage.capture(**SHORT_SCENARIO)

    # Missed are the tick that the other client made, and the one after it, since the
    # time between the two recorded ticks would be too long.
    assert done.missed == {"another client ticked the world": 2}
    assert done.frames == 3
    assert stage.left_behind() == {}


def test_constantly_ticking_client_ends_the_capture(stage):
    stage.simulator.faults.foreign_ticks = set(range(500))

    with pytest.raises(CaptureError, match="another client ticked the world"):
        stage.capture(**SHORT_SCENARIO)

    assert stage.left_behind() == {}


@pytest.mark.parametrize("tick", [1, 5, FIRST_TICK, FIRST_TICK + 3])
@pytest.mark.parametrize("error", [RuntimeError, KeyError], ids=lambda e: e.__name__)
def test_error_during_capture_restores_the_simulator(stage, tick, error):
    def fail(_server, now):
        if now == tick:
            raise error("time-out of 30000ms while waiting for the simulator")

    stage.simulator.faults.on_tick = fail

    expected = CaptureError if error is RuntimeError else KeyError
    with pytest.raises(expected, match="time-out"):
        stage.capture(
            **SHORT_SCENARIO, map_layers={"Props": False}, weather={"preset": "WetNoon"}
        )

    assert stage.left_behind() == {}


def test_failed_cleanup_step_does_not_prevent_the_others(stage, monkeypatch):
    def fail(_actor_id):
        raise RuntimeError("no answer")

    monkeypatch.setattr(stage.simulator, "remove", fail)

    stage.capture(**SHORT_SCENARIO)

    assert set(stage.left_behind()) == {"actors"}
    assert [note for note in stage.notes if "cannot destroy" in note]


def test_version_mismatch_is_reported_and_both_versions_are_stored(make_stage):
    stage = make_stage("0.9.15", client_version="0.9.16")

    stage.capture(**SHORT_SCENARIO)

    assert "CARLA 0.9.15, the client library 0.9.16" in stage.notes[0]
    frame = stage.frames()[0]
    assert frame["carla_version"] == "0.9.15"
    assert frame["extra"]["capture"]["client_version"] == "0.9.16"


def test_already_synchronous_world_is_reported_and_stays_synchronous(make_stage):
    stage = make_stage()
    stage.simulator.settings.synchronous_mode = True

    stage.capture(**SHORT_SCENARIO)

    assert "in synchronous mode already" in stage.notes[0]
    assert stage.simulator.settings.synchronous_mode


def test_parked_props_of_large_maps_are_straightened(stage):
    attributes = {"mesh_path": "/Game/Carla/Static/Car/4Wheeled/ParkedVehicles/Mini"}
    made = stage.simulator.add("vehicle.parked", attributes, at(60, 3, yaw=40))
    made.type_id = "static.prop.mesh"
    stage.capture(**SHORT_SCENARIO)

    box = next(b for b in stage.frames()[0]["boxes"] if b["id"] == str(made.id))
    assert box["class"] == "car"
    assert box["extra"]["flags"] == ["straightened", "default_size"]
    assert box["box3d"]["transform"]["yaw"] == pytest.approx(40, abs=1e-4)
