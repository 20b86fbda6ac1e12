"""`--config` and UNGHOST_CONFIG: the first configuration of every new dataset."""

from pathlib import Path

from tests.support import plain_http
from tests.support.command_line import CommandLine
from tests.support.servers import running_server


def test_new_dataset_gets_the_configuration_of_the_service(tmp_path: Path):
    file = tmp_path / "filter.yaml"
    file.write_text("threshold_small_box: 25\nclasses: {bus: {size_big_box: 90}}\n")

    with running_server(tmp_path / "data", {"UNGHOST_CONFIG": str(file)}) as server:
        base = f"{server.url}/api/v1"
        with plain_http.Client(base_url=base, headers=server.headers) as api:
            api.post("/datasets", json={"name": "town"}).raise_for_status()
            config = api.get("/datasets/town/config").json()["config"]

    assert config["threshold_small_box"] == 25
    assert config["classes"] == {"bus": {"size_big_box": 90}}


def test_serve_with_an_invalid_configuration_fails_with_one_line(tmp_path: Path):
    file = tmp_path / "filter.yaml"
    file.write_text("threshold_smal_box: 25\n")
    command = ("serve", "--data", "data", "--port", "0", "--config", file)

    ended = CommandLine(tmp_path, {})(*command)

    assert ended.code == 1
    assert ended.err.splitlines() == [
        f"unghost: the configuration cannot be used: {file}: unknown key "
        "'threshold_smal_box'; the nearest valid key is 'threshold_small_box'"
    ]
