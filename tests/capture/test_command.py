"""The command `unghost capture`: dry runs, mistakes, exit codes and reports."""

import json
import signal
import socket
import sys

import pytest
import yaml
from typer.testing import CliRunner

from tests.support.fake_carla.scenarios import SMALL
from unghost.cli.program import app
from unghost.client.errors import NoResponse


def write_scenario(folder, **changes):
    path = folder / "street.yaml"
    path.write_text(yaml.safe_dump({**SMALL, **changes}))
    return path


def run(*words):
    return CliRunner().invoke(app, ["capture", *map(str, words)])


def test_dry_run_prints_the_plan_and_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scenario = write_scenario(
        tmp_path, map="Town05", sensors={"radar": True, "lidar": True}
    )

    done = run(scenario, "--dry-run", "--push", "street")

    rows = dict(line.split("\t") for line in done.stdout.splitlines())
    assert rows["map"] == "Town05"
    assert rows["vehicles"] == "4 of vehicle.tesla.*"
    assert rows["frames"] == "3, one every 2 ticks of 0.05 s: 0.3 s simulated"
    assert rows["sensor radar"] == "sensor.other.radar"
    assert (rows["output"], rows["push to"]) == ("capture-street", "street")
    assert [path.name for path in tmp_path.iterdir()] == ["street.yaml"]


def test_dry_run_prints_json_and_notes_that_the_interval_is_rounded(tmp_path):
    # Values of a sensor's attributes are checked by the simulator only.
    sensors = {"lidar": {"attributes": {"points_per_second": "many"}}}
    scenario = write_scenario(tmp_path, interval_s=0.12, sensors=sensors)

    done = run(scenario, "--dry-run", "--json")

    plan = json.loads(done.stdout)
    assert plan["ticks"] == 16
    assert plan["scenario"]["vehicles"]["count"] == 4
    assert set(plan["sensors"]) == {"rgb", "segmentation", "lidar"}
    assert "interval_s 0.12 is not a whole number of ticks" in done.stderr


def test_invalid_scenario_exits_with_1_and_a_message(bare_unghost, tmp_path):
    said = bare_unghost("capture", write_scenario(tmp_path, vehicls={}), "--dry-run")

    assert said.code == 1
    assert said.err == (
        "unghost: street.yaml: vehicls: unknown key; the nearest valid key is "
        "'vehicles'\n"
    )


def test_missing_simulator_exits_with_69(bare_unghost, tmp_path):
    with socket.socket() as taken:
        # Bound but not listening, so that no other program can listen on this port.
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        said = bare_unghost("capture", write_scenario(tmp_path, port=port, timeout_s=1))

    assert said.code == 69, said.err
    assert f"no simulator at 127.0.0.1:{port}" in said.err
    assert not (tmp_path / "capture-street").exists()
    # No host has a name that ends in ".invalid": it is reserved for this.
    said = bare_unghost("capture", write_scenario(tmp_path, host="simulator.invalid"))
    assert said.code == 69, said.err
    assert "no simulator at simulator.invalid:2000" in said.err


def test_unknown_blueprint_error_names_the_file_and_the_nearest_blueprint(
    as_carla, tmp_path
):
    scenario = write_scenario(tmp_path, ego={"blueprint": "vehicle.tesla.modl3"})

    done = run(scenario, "--output", tmp_path / "out")

    assert str(done.exception) == (
        "street.yaml: ego.blueprint: no blueprint 'vehicle.tesla.modl3'; the nearest "
        "is 'vehicle.tesla.model3'"
    )
    assert as_carla.left_behind() == {}


def test_unreachable_service_fails_before_recording(as_carla, tmp_path, monkeypatch):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        monkeypatch.setenv(
            "UNGHOST_SERVER", f"http://127.0.0.1:{taken.getsockname()[1]}"
        )
        monkeypatch.setenv("UNGHOST_TOKEN", "ugt_of_nobody")
        done = run(
            write_scenario(tmp_path),
            "-o",
            tmp_path / "out",
            "--push",
            "street",
            "--retry-for",
            0,
        )

    assert isinstance(done.exception, NoResponse)
    assert as_carla.simulator.spawned == ["traffic.traffic_light"]
    assert not (tmp_path / "out").exists()


def test_carlasimu_files_are_converted_to_a_scenario(tmp_path):
    (tmp_path / "weather.yaml").write_text("sitting: {fog_density: 3}")

    done = run("--from-carlasimu", tmp_path)

    assert done.exit_code == 0
    assert yaml.safe_load(done.stdout) == {
        "weather": {"parameters": {"fog_density": 3}}
    }


@pytest.mark.parametrize(
    "words",
    [("street.yaml",), ("--dry-run",), ("--push", "x"), ("-o", "y"), ("--token", "t")],
    ids=" ".join,
)
def test_options_of_a_recording_beside_from_carlasimu_exit_with_2(
    tmp_path, monkeypatch, words
):
    monkeypatch.chdir(tmp_path)
    write_scenario(tmp_path)
    (tmp_path / "weather.yaml").write_text("sitting: {fog_density: 3}")

    done = run("--from-carlasimu", tmp_path, *words)

    assert done.exit_code == 2
    assert "--from-carlasimu only prints a scenario: leave out" in " ".join(
        done.output.replace("│", " ").split()
    )


def test_interrupted_capture_does_not_say_that_all_was_restored(as_carla, tmp_path):
    def crash(server, now):
        if now == 12:
            signal.raise_signal(signal.SIGINT)
            server.faults.gone = True

    as_carla.simulator.faults.on_tick = crash
    scenario = write_scenario(tmp_path, camera={"width": 48, "height": 32})

    done = run(scenario, "--output", tmp_path / "out")

    assert "its settings were not restored" in done.stderr
    assert "settings of the simulator were restored" not in done.stderr


def test_capture_prints_a_json_summary(as_carla, tmp_path):
    scenario = write_scenario(tmp_path, frames=2, camera={"width": 48, "height": 32})

    done = run(scenario, "--output", tmp_path / "out", "--json")

    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert (told["frames"], told["added"], told["missed"]) == (2, 2, {})
    assert told["left_out"] == {"impossible_box": 2}
    about = json.loads((tmp_path / "out" / "capture.json").read_text())
    assert about["last"]["frames"] == 2
    assert about["carla_version"] == "0.9.16"
    assert as_carla.left_behind() == {}


def test_captured_folder_can_be_filtered_directly(bare_unghost, stage, tmp_path):
    stage.capture(frames=2)
    config = tmp_path / "filter.yaml"
    config.write_text("profile: paper")
    output = ("--output", "decisions.jsonl", "--json")

    said = bare_unghost("filter", stage.folder, "--config", config, *output)

    assert said.code == 0, said.err
    told = said.records[0]
    assert (told["decided"], told["failed"]) == (2, 0)
    assert (told["kept"], told["rejected"], told["unmeasured"]) == (14, 6, 0)


def test_missed_ticks_and_objects_are_reported(as_carla, tmp_path):
    as_carla.simulator.faults.foreign_ticks = {12}
    scenario = write_scenario(tmp_path, frames=1, camera={"width": 48, "height": 32})

    done = run(scenario, "--output", tmp_path / "out")

    assert "1 frames\t1 new\t2 ticks missed" in done.stdout
    assert "ticks not recorded: 2: another client ticked the world" in done.stderr
    assert "objects without a box: 2: impossible box" in done.stderr


def test_missing_carla_library_shows_the_install_command(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "carla", None)

    done = run(write_scenario(tmp_path))

    assert done.exit_code == 1
    assert "pip install 'unghost[carla]'" in str(done.exception)
    assert run().exit_code == 2  # without a scenario
