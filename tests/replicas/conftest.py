"""Two servers on two ports that share one PostgreSQL database and one data folder."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import count

import pytest

from tests.support import frames as scene
from tests.support.api import Api
from tests.support.databases import migrated_postgres
from tests.support.servers import RunningServer, running_server

_numbers = count(1)


@dataclass(frozen=True)
class Replica:
    """One of the two servers, and an API client of it with the rights of an admin."""

    server: RunningServer
    api: Api


@dataclass(frozen=True)
class Replicas:
    """Both servers, and the address of the database that they share."""

    first: Replica
    second: Replica
    database_url: str

    @property
    def both(self) -> tuple[Replica, Replica]:
        return self.first, self.second

    def make_dataset(self, frames: int = 1) -> str:
        """Make a dataset, uploading its frames to the two servers in turn.

        Each frame has a visible car and a ghost, a box without an object.
        """
        name = self.first.api.dataset()
        for number in range(frames):
            api = self.both[number % 2].api
            api.upload_frame(
                name, f"{number:03}", {**scene.annotation(), "number": number}
            )
        return name


@pytest.fixture(scope="module")
def replicas(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Replicas]:
    """Two running servers, of one empty database and one empty folder."""
    data = tmp_path_factory.mktemp("shared") / "data"
    with migrated_postgres() as url, ExitStack() as opened:
        settings = {"UNGHOST_DATABASE_URL": url, "UNGHOST_WORKERS": "1"}
        settings["UNGHOST_HOOK_HOSTS"] = "127.0.0.1"
        pair = []
        for _ in range(2):
            server = opened.enter_context(running_server(data, settings))
            api = Api.at(server.url, server.headers)
            opened.enter_context(api.http)
            pair.append(Replica(server, api))
        yield Replicas(pair[0], pair[1], url)


@pytest.fixture
def make_reviewer(replicas: Replicas) -> Iterator[Callable[[], tuple[Api, Api]]]:
    """Makes a reviewer: a client of each server, which are closed after the test."""
    with ExitStack() as opened:

        def make() -> tuple[Api, Api]:
            first = replicas.first.api.person()
            token = {"Authorization": first.http.headers["authorization"]}
            second = Api.at(replicas.second.server.url, token)
            for client in (first, second):
                opened.enter_context(client.http)
            return first, second

        yield make
