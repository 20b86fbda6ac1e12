"""A server only for the hostile tests, as their requests also delete data."""

from collections.abc import Iterator

import pytest

from tests.support.api import Api
from tests.support.hostile.openapi_cases import populate
from tests.support.servers import running_server

SETTINGS = {"UNGHOST_MAX_OPEN_RUNS": "1000", "UNGHOST_LOG_LEVEL": "warning"}


@pytest.fixture(scope="session")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """An admin's client of that server, which has the dataset of `populate`."""
    folder = tmp_path_factory.mktemp("hostile") / "data"
    with running_server(folder, SETTINGS) as server:
        opened = Api.at(server.url, server.headers)
        with opened.http:
            populate(opened)
            yield opened
