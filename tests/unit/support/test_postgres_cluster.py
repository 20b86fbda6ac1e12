"""The program that runs a command with a PostgreSQL server, and then stops it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

from tests.support.databases import SERVER_VARIABLE, is_reachable
from tests.support.postgres_cluster import Cluster, own_cluster
from tests.support.sources import CHECKOUT

PRINT_URL = f'echo "${SERVER_VARIABLE}"; '


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    with own_cluster() as cluster:
        yield cluster


@pytest.fixture
def stopped_server_url(cluster: Cluster) -> Iterator[str]:
    """The address of a server that is stopped during the test."""
    cluster.stop()
    yield cluster.url
    cluster.start()


def run_with_server(server: str, script: str) -> subprocess.Popen[str]:
    """Run a shell script with this server if it answers, or else with a new one."""
    module = "tests.support.postgres_cluster"
    return subprocess.Popen(
        [sys.executable, "-m", module, "sh", "-c", script],
        cwd=CHECKOUT,
        env={**os.environ, SERVER_VARIABLE: server},
        stdout=subprocess.PIPE,
        text=True,
    )


def test_running_server_is_used_and_not_stopped(cluster: Cluster):
    with run_with_server(cluster.url, PRINT_URL + "exit 7") as process:
        printed, _ = process.communicate()

    assert printed.strip() == cluster.url
    assert process.returncode == 7
    assert is_reachable(cluster.url)


@pytest.mark.parametrize(
    "number", [signal.SIGTERM, pytest.param(signal.SIGHUP, marks=pytest.mark.long)]
)
def test_temporary_server_runs_until_the_command_ends(stopped_server_url: str, number):
    with run_with_server(stopped_server_url, PRINT_URL + "exec sleep 60") as process:
        assert process.stdout
        printed = process.stdout.readline().strip()
        assert printed != stopped_server_url
        assert is_reachable(printed)
        process.send_signal(number)

    assert process.returncode != 0
    assert not is_reachable(printed)
