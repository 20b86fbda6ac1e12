"""Fixtures for each test module: services with a real database and a data folder."""

from collections.abc import Iterator

import pytest

from tests.support.databases import empty_postgres
from tests.support.services import Services, running_services


@pytest.fixture(scope="module")
def services(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Services]:
    with running_services(tmp_path_factory.mktemp("services")) as running:
        yield running


@pytest.fixture(scope="module")
def postgres_services(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Services]:
    """Services on PostgreSQL, whichever database the other tests use."""
    folder = tmp_path_factory.mktemp("postgres")
    with empty_postgres() as url, running_services(folder, database_url=url) as running:
        yield running
