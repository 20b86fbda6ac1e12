"""What every test shares: reproducible examples, a data folder, a real server."""

from __future__ import annotations

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
from tests.support.s3_server import KEYS, S3Server, s3_server
from tests.support.servers import RunningServer, StartServer, running_server

# Few, because every run tries others; `make test-long` tries more.
settings.register_profile(
    "machine",
    deadline=None,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow],
    max_examples=int(os.environ.get("PROPERTY_EXAMPLES", "20")),
)
settings.register_profile("ci", settings.get_profile("machine"), derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "machine")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Started in the background: what the tests start is to be interrupted all the same.
    signal.signal(signal.SIGINT, signal.default_int_handler)

StartApi = Callable[..., tuple[RunningServer, Api]]


@pytest.fixture(scope="session", autouse=True)
def _no_settings_from_outside() -> Iterator[None]:
    """A developer's own UNGHOST_* variables never change the outcome of a test."""
    with pytest.MonkeyPatch.context() as patch:
        for name in [key for key in os.environ if key.startswith("UNGHOST_")]:
            patch.delenv(name)
        yield


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What is about SQLite's own files has no meaning where there are none."""
    for item in items:
        marker = item.get_closest_marker("sqlite_files")
        if marker is not None and databases.CHOSEN:
            (reason,) = marker.args
            item.add_marker(pytest.mark.skip(reason=f"about SQLite: {reason}"))


def pytest_collection_finish() -> None:
    """What has been imported stays: the collector need not look at it again."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def _no_databases_left() -> Iterator[None]:
    """Databases on a server go with the tests."""
    yield
    databases.drop_all()


@pytest.fixture(scope="module", autouse=True)
def _few_databases_at_a_time() -> Iterator[None]:
    """Hundreds of them would fill the disk of a server."""
    yield
    if databases.CHOSEN:
        databases.drop_unused()


@pytest.fixture(scope="session")
def s3() -> Iterator[S3Server]:
    """One server that speaks S3 for all tests; each makes its own buckets."""
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


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    """One server for all tests that only add to it; name your datasets apart."""
    with running_server(tmp_path_factory.mktemp("server") / "data") as running:
        yield running


@pytest.fixture
def start_server(data_dir: Path) -> Iterator[StartServer]:
    """Starts a server of the test's own: `start_server(UNGHOST_MAX_PARTS="3")`.

    Called again, it serves the same data folder; all are ended with the test.
    """
    with ExitStack() as started:

        def start(**settings: str) -> RunningServer:
            return started.enter_context(running_server(data_dir, settings))

        yield start


@pytest.fixture
def start_api(start_server: StartServer) -> Iterator[StartApi]:
    """`start_server`, and a client of it that is an admin."""
    with ExitStack() as opened:

        def start(**settings: str) -> tuple[RunningServer, Api]:
            server = start_server(**settings)
            api = Api.at(server.url, server.headers)
            opened.enter_context(api.http)
            return server, api

        yield start
