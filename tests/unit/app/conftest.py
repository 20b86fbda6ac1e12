"""A fixture for each test module: services with a real database and a data folder."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.services import Services, running_services


@pytest.fixture(scope="module")
def services(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Services]:
    with running_services(tmp_path_factory.mktemp("services")) as running:
        yield running
