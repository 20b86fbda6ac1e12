"""Clean boxes while a simulation runs, in a script of one's own."""

import re
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import unghost
from tests.support.fake_carla.library import as_library
from tests.support.fake_carla.simulator import at
from tests.support.fake_carla.street import BEHIND_WALL, SEEN, WALKER_HIDDEN
from unghost import LiveOptions
from unghost.capture.simulator import CaptureError

PAGE = Path(__file__).parents[2] / "docs" / "live.md"
SENSORS = {
    "rgb": "rgb",
    "segmentation": "semantic_segmentation",
    "depth": "depth",
    "instances": "instance_segmentation",
}


@pytest.fixture
def script(as_carla):
    """A script's own world, with an ego vehicle and three actors, and its sensors."""
    carla = as_library(as_carla.simulator)
    world: Any = carla.Client("127.0.0.1", 2000).get_world()
    settings = world.get_settings()
    settings.synchronous_mode = True
    world.apply_settings(settings)
    library = world.get_blueprint_library()
    ego = world.spawn_actor(library.find("vehicle.tesla.model3"), at(0, 0))
    for place in (SEEN[0], BEHIND_WALL):
        world.spawn_actor(library.find("vehicle.tesla.model3"), place)
    walker = next(iter(library.filter("walker.pedestrian.*")))
    world.spawn_actor(walker, at(WALKER_HIDDEN.x, WALKER_HIDDEN.y))
    sensors = {}
    for name, kind in SENSORS.items():
        blueprint = library.find(f"sensor.camera.{kind}")
        blueprint.set_attribute("image_size_x", "160")
        blueprint.set_attribute("image_size_y", "96")
        mount = carla.Transform(carla.Location(1.5, 0, 2.4), carla.Rotation(0, 0, 0))
        sensors[name] = world.spawn_actor(blueprint, mount, ego)
    return as_carla.simulator, world, sensors


def verdicts(frame):
    actors = (box for box in frame.decisions if "-" not in box["id"])
    return [actor["verdict"] for actor in actors]


@pytest.mark.parametrize("names", [["rgb", "segmentation"], list(SENSORS)])
def test_each_tick_of_a_synchronous_world_comes_with_clean_boxes(script, names):
    simulator, world, sensors = script
    chosen = {name: sensors[name] for name in names}

    with unghost.live(world, sensors=chosen) as live:
        frames = [next(live) for _ in range(3)]

    assert [frame.tick for frame in frames] == [frames[0].tick + n for n in range(3)]
    for frame in frames:
        # A wall hides a car and a walker.
        assert verdicts(frame) == ["kept", "rejected", "rejected"]
        assert {box["verdict"] for box in frame.boxes} == {"kept"}
        assert all(box["explanation"] for box in frame.decisions)
        assert frame.image is not None
        assert frame.image.shape == (96, 160, 3)
    assert (live.dropped, live.missed.total()) == (0, 0)
    assert not any(sensor.is_listening() for sensor in chosen.values())
    assert simulator.listeners == {}
    assert world.get_settings().synchronous_mode


def test_callback_gets_every_tick_and_its_error_is_raised_by_close(script):
    _, world, sensors = script
    seen: list[unghost.LiveFrame] = []

    with unghost.live(world, sensors=sensors, on_frame=seen.append) as live:
        ticks = [world.tick() for _ in range(5)]
        while len(seen) < 5 and live.missed.total() == 0:
            time.sleep(0.01)

    assert [frame.tick for frame in seen] == ticks
    with pytest.raises(StopIteration):
        next(live)

    def refuse(frame):
        raise ValueError(f"tick {frame.tick}")

    live = unghost.live(world, sensors=sensors, on_frame=refuse)
    tick = world.tick()
    while live.waiting:
        time.sleep(0.01)
    with pytest.raises(ValueError, match=f"tick {tick}"):
        live.close()


@pytest.mark.parametrize(("drop", "dropped"), [("nothing", 0), ("oldest", 9)])
def test_ticks_of_an_asynchronous_world_wait_or_are_dropped(script, drop, dropped):
    simulator, world, sensors = script
    settings = world.get_settings()
    settings.synchronous_mode = False
    world.apply_settings(settings)

    options = LiveOptions(drop=drop)
    with unghost.live(world, sensors=sensors, options=options) as live:
        free_running = threading.Thread(
            target=lambda: [simulator.tick() for _ in range(10)]
        )
        free_running.start()
        free_running.join()
        first = next(live)

    assert live.dropped == dropped
    assert first.tick == simulator.frame - 9 + dropped
    assert verdicts(first) == ["kept", "rejected", "rejected"]


def test_simulation_that_stands_still_and_lost_images_are_reported(script):
    simulator, world, sensors = script
    simulator.faults.lost = {("rgb", simulator.ticks + 1)}

    with unghost.live(world, sensors=sensors, options=LiveOptions(wait_s=0.2)) as live:
        next(live)
        assert live.missed == {"rgb sent nothing in time": 1}
    waiting = LiveOptions(ticks=False, wait_s=0.2)
    with (
        unghost.live(world, sensors=sensors, options=waiting) as live,
        pytest.raises(CaptureError, match=r"did not tick in 0\.2 s"),
    ):
        next(live)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ({"rbg": "rgb"}, "unknown name 'rbg'; the nearest is 'rgb'"),
        ({"depth": "depth"}, "expected rgb or segmentation, found neither"),
        ({"rgb": "depth"}, "expected sensor.camera.rgb as rgb, found sensor.camera.d"),
    ],
)
def test_wrong_sensors_are_refused(script, names, said):
    _, world, sensors = script

    with pytest.raises(CaptureError, match=said):
        unghost.live(
            world, sensors={name: sensors[kind] for name, kind in names.items()}
        )


def test_the_ten_lines_of_the_page_run(script):
    _, world, sensors = script
    code = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)[0]
    names = {"world": world, "camera": sensors["rgb"], "tags": sensors["segmentation"]}
    shown: list[np.ndarray] = []

    exec(code, {**names, "show": shown.append, "is_over": lambda: len(shown) == 2})

    assert len(code.splitlines()) <= 12
    assert len(shown) == 2
    assert shown[0].any()
