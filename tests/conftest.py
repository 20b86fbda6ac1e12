"""Fixtures and settings for all tests: Hypothesis, data folders, databases, servers."""

import gc
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests.support import databases
from tests.support.api import Api
from tests.support.command_line import CommandLine
from tests.support.s3_server import KEYS, S3Server, s3_server
from tests.support.servers import RunningServer, StartServer, running_server

# Few examples each time, since every run tries other ones; `make test-long` tries more.
settings.register_profile(
    "machine",
    deadline=None,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow],
    max_examples=int(os.environ.get("PROPERTY_EXAMPLES", "12")),
)
settings.register_profile("ci", settings.get_profile("machine"), derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "machine")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell starts programs in the background with SIGINT ignored, and their children
    # inherit that. Some tests interrupt the programs that they start.
    signal.signal(signal.SIGINT, signal.default_int_handler)

NEW_OBJECTS = 20_000
"""So many make a garbage collection worth its time; Python's default is 700."""

StartApi = Callable[..., tuple[RunningServer, Api]]


@pytest.fixture(scope="session", autouse=True)
def _no_settings_from_outside() -> Iterator[None]:
    """Remove UNGHOST_* variables of the environment, which would change the tests."""
    with pytest.MonkeyPatch.context() as patch:
        for name in [key for key in os.environ if key.startswith("UNGHOST_")]:
            patch.delenv(name)
        yield


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip tests marked `sqlite_files` when the tests run on another database."""
    for item in items:
        marker = item.get_closest_marker("sqlite_files")
        if marker is not None and databases.CHOSEN:
            (reason,) = marker.args
            item.add_marker(pytest.mark.skip(reason=f"about SQLite: {reason}"))


def pytest_collection_finish() -> None:
    """Collect garbage rarely, and not among what has been imported, to save time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(NEW_OBJECTS, 10, 10)


@pytest.fixture(scope="session", autouse=True)
def _no_databases_left() -> Iterator[None]:
    """Drop all databases of the tests from the database server at the end."""
    yield
    databases.drop_all()


@pytest.fixture(scope="module", autouse=True)
def _few_databases_at_a_time() -> Iterator[None]:
    """Drop unused databases after each module: hundreds would fill a server's disk."""
    yield
    if databases.CHOSEN:
        databases.drop_unused()


@pytest.fixture(scope="session")
def s3() -> Iterator[S3Server]:
    """One S3 server for all tests; each test makes its own buckets."""
    with pytest.MonkeyPatch.context() as patch, s3_server() as running:
        for name in [key for key in os.environ if key.startswith("AWS_")]:
            patch.delenv(name)
        for name, value in KEYS.items():
            patch.setenv(name, value)
        yield running


@pytest.fixture
def data_dir(tmp_path: Path) -> Path:
    """An empty data folder."""
    folder = tmp_path / "data"
    folder.mkdir()
    return folder


@pytest.fixture
def bare_unghost(tmp_path: Path) -> CommandLine:
    """The command line in an empty folder, without a setting: it knows no server."""
    return CommandLine(tmp_path, {})


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    """One server for all tests that only add datasets, with names of their own."""
    folder = tmp_path_factory.mktemp("server") / "data"
    with running_server(folder, {"UNGHOST_HOOK_HOSTS": "127.0.0.1"}) as running:
        yield running


@pytest.fixture
def start_server(data_dir: Path) -> Iterator[StartServer]:
    """Starts a server for this test alone: `start_server(UNGHOST_MAX_PARTS="3")`.

    A second call starts another server on the same data folder. All of them are stopped
    after the test.
    """
    with ExitStack() as started:

        def start(**settings: str) -> RunningServer:
            return started.enter_context(running_server(data_dir, settings))

        yield start


@pytest.fixture
def start_api(start_server: StartServer) -> Iterator[StartApi]:
    """Starts a server as `start_server` does; gives it and a client of an admin."""
    with ExitStack() as opened:

        def start(**settings: str) -> tuple[RunningServer, Api]:
            server = start_server(**settings)
            api = Api.at(server.url, server.headers)
            opened.enter_context(api.http)
            return server, api

        yield start
