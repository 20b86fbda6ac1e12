"""A running cluster for the tests of a module, and one of a test's own."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.api import Api
from tests.support.cluster import Cluster, Node, cluster
from tests.support.databases import DATABASE_URL, migrated_postgres
from tests.support.servers import RunningServer


@dataclass
class RunningCluster:
    """A running cluster: its nodes, its server, and an API client of an admin."""

    cluster: Cluster
    scheduler: Node
    workers: list[Node]
    server: RunningServer
    api: Api


@pytest.fixture(scope="module")
def running_cluster(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[RunningCluster]:
    with (
        migrated_postgres() as url,  # with SQLite, there is only one server
        cluster(tmp_path_factory.mktemp("cluster")) as made,
    ):
        made.settings[DATABASE_URL] = url
        scheduler = made.scheduler()
        # The server comes first: it creates the database, which a worker needs.
        with made.server() as (server, api):
            workers = [made.worker(joined=False) for _ in range(2)]
            for worker in workers:
                worker.wait_for_log("joined the scheduler")
            yield RunningCluster(made, scheduler, workers, server, api)


@pytest.fixture
def made(tmp_path: Path) -> Iterator[Cluster]:
    """A cluster of a test's own, of which nothing is started yet."""
    with cluster(tmp_path) as made:
        yield made
