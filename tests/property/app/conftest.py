"""One database for all examples: each of them makes its own dataset."""

from collections.abc import Iterator

import pytest

from tests.support.services import Services, running_services


@pytest.fixture(scope="session")
def services(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Services]:
    with running_services(tmp_path_factory.mktemp("services")) as running:
        yield running
