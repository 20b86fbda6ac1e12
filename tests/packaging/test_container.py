"""The container's Dockerfile and compose file are read and their steps checked.

No container engine is needed: the start command runs as an ordinary process.
"""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from tests.support.dockerfile import Stage, parse_dockerfile
from tests.support.foreign_folder import ForeignFolder
from tests.support.installation import Installation
from tests.support.servers import start_anew, stop, wait_for_link
from tests.support.sources import CHECKOUT
from tests.support.waiting import until

STAGES = parse_dockerfile((CHECKOUT / "Dockerfile").read_text("utf-8"))
IMAGE = STAGES[-1]
NOBODY = 65534
# Runs a command as a user other than root, who may read every file and no more: the
# Python that runs the tests may be in a folder that only root can read.
AS_NOBODY = [
    "setpriv",
    f"--reuid={NOBODY}",
    f"--regid={NOBODY}",
    "--clear-groups",
    "--inh-caps=-all,+dac_read_search",
    "--ambient-caps=-all,+dac_read_search",
]


@pytest.fixture
def folder_of_the_service_user() -> Iterator[Path]:
    """A folder that belongs to the user that the service runs as."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if os.geteuid() == 0:
            os.chown(folder, NOBODY, NOBODY)
        yield folder


def health_check(stage: Stage) -> list[str]:
    """The words of the command that HEALTHCHECK runs."""
    words: list[str] = json.loads(re.sub(r"^.*?CMD ", "", stage.last("HEALTHCHECK")))
    return words


def test_the_image_installs_what_the_first_stage_built_and_does_not_run_as_root():
    built = shlex.split(STAGES[0].last("RUN"))
    assert built[:4] == ["python", "-m", "pip", "wheel"]
    assert built[-3:] == ["--wheel-dir", "/wheels", "."]
    assert "--no-deps /wheels/*.whl" in IMAGE.all("RUN")[0]
    assert IMAGE.last("USER") not in {"root", "0"}
    assert IMAGE.all("VOLUME") == ["/data"]

    lines = (CHECKOUT / ".dockerignore").read_text("utf-8").split()
    allowed = {line[1:] for line in lines if line.startswith("!")}
    assert lines[0] == "*"
    assert {"app", "filter_core", "unghost", "static", "migrations"} <= allowed
    assert all((CHECKOUT / name).exists() for name in allowed)


def test_compose_publishes_the_service_on_loopback_only():
    compose = yaml.safe_load((CHECKOUT / "docker-compose.yml").read_text("utf-8"))
    service = compose["services"]["unghost"]
    assert service["healthcheck"]["test"] == ["CMD", *health_check(IMAGE)]
    assert service["ports"] == ["127.0.0.1:8000:8000"]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["volumes"] == ["unghost-data:/data"]


def test_health_check_runs_no_python_file_of_the_data_folder(tmp_path):
    foreign = ForeignFolder.below(tmp_path)
    _, *words = at("http://127.0.0.1:9", health_check(IMAGE))  # nobody answers there

    ended = subprocess.run(
        [sys.executable, *words], cwd=foreign.path, capture_output=True, check=False
    )

    assert b"Connection refused" in ended.stderr
    assert foreign.names_run() == set()


def test_start_command_serves_as_a_non_root_user(
    installation: Installation, folder_of_the_service_user: Path
):
    name, *arguments = IMAGE.command
    command = [str(installation.command(name)), *arguments]
    drop = AS_NOBODY if os.geteuid() == 0 else []
    data, log = folder_of_the_service_user / "data", folder_of_the_service_user / "log"
    environment = local_environment(IMAGE.environment, folder_of_the_service_user)

    process = start_anew([*drop, *command], data, log, environment)
    try:
        url = wait_for_link(process, log).partition("/#")[0]
        python, *words = at(url, health_check(IMAGE))
        # On a busy machine the server may not be ready for a moment.
        until(lambda: subprocess.call([installation.python, *words]) == 0)
    finally:
        stop(process)

    assert python == "python"
    assert url.startswith("http://127.0.0.1:")
    assert process.returncode in (0, -signal.SIGTERM), log.read_text("utf-8")


def local_environment(environment: dict[str, str], folder: Path) -> dict[str, str]:
    """The image's environment, with our data folder, and any free port."""
    moved = {
        name: value.replace("/data", str(folder / "data"), 1)
        for name, value in environment.items()
    }
    return {**moved, "UNGHOST_PORT": "0", "UNGHOST_HOST": "127.0.0.1"}


def at(url: str, command: list[str]) -> list[str]:
    """The health check's command, for a server at another address."""
    return [word.replace("http://127.0.0.1:8000", url) for word in command]
