"""`unghost capture` in a process of its own, sending its frames to a live service."""

import json
import os
import signal
import sys
import time
from collections import Counter

import pytest
import yaml

from tests.support.api import BY_TAGS
from tests.support.command_line import CommandLine
from tests.support.fake_carla.scenarios import SMALL
from tests.support.processes import start
from tests.support.servers import RunningServer
from tests.support.waiting import until
from unghost import Client

pytestmark = pytest.mark.long

ALL_SENSORS = {"instances": True, "depth": True, "semantic_lidar": True, "radar": True}
WAIT_S = 120


class CaptureLine(CommandLine):
    """Runs `unghost` with a fake simulator.

    `left` is the state of the simulator when the command has ended.
    """

    @property
    def left(self):
        return json.loads((self.folder / "state.json").read_text())

    def program(self, *words):
        state = self.folder / "state.json"
        return ["tests.support.fake_carla.program", str(state), *map(str, words)]

    def start(self, *words):
        path = os.pathsep.join(p for p in sys.path if p)
        environ = {**self.environ, "PYTHONPATH": path}
        return start(self.program(*words), self.folder, environ)

    def scenario(self, **changes):
        path = self.folder / "street.yaml"
        path.write_text(yaml.safe_dump({**SMALL, **changes}))
        return path


@pytest.fixture
def line(tmp_path):
    return CaptureLine(tmp_path, {})


def wait_for_exit(process):
    out, err = process.communicate(timeout=WAIT_S)
    return process.returncode, out, err


def test_100_captured_frames_are_pushed_to_a_live_service(
    tmp_path, server: RunningServer
):
    line = CaptureLine(
        tmp_path, {"UNGHOST_SERVER": server.url, "UNGHOST_TOKEN": server.token}
    )
    scenario = line.scenario(frames=100, interval_s=0.05, sensors=ALL_SENSORS)

    with Client(server.url, server.token) as client:
        client.create_dataset("captured-street", config=BY_TAGS)
    command = ("capture", scenario, "--push", "captured-street", "--output", "out")
    code, out, err = wait_for_exit(line.start(*command))

    assert code == 0, err
    assert "100 frames\t100 new\t0 ticks missed" in out
    assert line.left["actors"] == ["traffic.traffic_light"]
    assert not line.left["synchronous"]
    with Client(server.url, server.token) as client:
        stats = client.stats("captured-street")
        manifest = (tmp_path / "out" / "manifest.jsonl").read_text()
        first = json.loads(manifest.splitlines()[0])
        stored = client.frame_by_key("captured-street", first["key"])
        # In each frame seven of ten boxes are kept. A wall hides a car and a walker,
        # and one car is behind the camera.
        assert (stats.kept, stats.rejected, stats.unmeasured) == (700, 300, 0)
        again = line("push", "out", "--dataset", "captured-street")
        assert (again.code, again.out.split("\t")[:2]) == (
            0,
            ["0 stored", "100 already_there"],
        )
        for kind in ("lidar", "radar", "depth", "instances"):
            content = client.frame_file(stored.id, kind)
            assert content == (tmp_path / "out" / first[kind]).read_bytes()


TOWNS = [*(f"Town{number:02}" for number in range(1, 8)), "Town10HD"]


def test_campaign_killed_twice_has_every_frame_of_every_map_once(
    tmp_path, server: RunningServer
):
    line = CaptureLine(
        tmp_path, {"UNGHOST_SERVER": server.url, "UNGHOST_TOKEN": server.token}
    )
    weather = {"presets": ["ClearNoon", "WetSunset"], "frames_per_preset": 10}
    scenario = line.scenario(maps=TOWNS, frames=20, interval_s=0.05, weather=weather)
    command = ("capture", scenario, "--push", "campaign", "--output", "out")
    manifest = tmp_path / "out" / "manifest.jsonl"

    def count():
        return manifest.read_text().count("\n") if manifest.exists() else 0

    for least in (25, 90):
        process = line.start(*command)
        while count() < least:
            assert process.poll() is None, "it ended too early"
            time.sleep(0.02)
        process.kill()
        process.communicate()
    code, out, err = wait_for_exit(line.start(*command))

    assert code == 0, err
    frames = [json.loads(line) for line in manifest.read_text().splitlines()]
    assert Counter(frame["map"] for frame in frames) == dict.fromkeys(TOWNS, 20)
    assert len({frame["key"] for frame in frames}) == len(frames)
    assert list(dict.fromkeys(frame["map"] for frame in frames)) == TOWNS
    counts = [line.split("\t") for line in out.splitlines() if "count\t" in line]
    assert {row[2]: row[3] for row in counts if row[1] == "map"} == dict.fromkeys(
        TOWNS, "20"
    )
    assert {row[2]: row[3] for row in counts if row[1] == "weather"} == {
        "ClearNoon": "80",
        "WetSunset": "80",
    }
    with Client(server.url, server.token) as client:
        stored = [frame.key for frame in client.frames("campaign")]
        by_map = client.stats("campaign").by_map
        assert {name: of.frames for name, of in by_map.items()} == dict.fromkeys(
            TOWNS, 20
        )
        assert sum(of.boxes for of in by_map.values()) == sum(
            len(frame["boxes"]) for frame in frames
        )
    assert sorted(stored) == sorted(frame["key"] for frame in frames)


def test_ctrl_c_exits_with_130_and_the_capture_can_be_resumed(line):
    scenario = line.scenario(frames=2000, interval_s=0.05)
    process = line.start("capture", scenario, "--output", "out")
    manifest = line.folder / "out" / "manifest.jsonl"
    until(manifest.exists, "nothing was recorded")

    process.send_signal(signal.SIGINT)
    code, _, err = wait_for_exit(process)

    assert code == 130, err
    assert "the same command continues" in err
    assert line.left["actors"] == ["traffic.traffic_light"]
    assert line.left["managers"] == [False]
    there = len(manifest.read_text().splitlines())
    line.scenario(frames=there + 2, interval_s=0.05)
    code, out, err = wait_for_exit(line.start("capture", scenario, "--output", "out"))
    assert code == 0, err
    assert f"{there + 2} frames\t2 new" in out
