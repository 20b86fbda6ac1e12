"""A service at work: what the static rules say of its modules is looked at, too."""

from __future__ import annotations

import pytest

from tests.pins.walk import walked
from tests.support.at_work import Acts, watched
from tests.support.live import live


@pytest.fixture(scope="session")
def acts(tmp_path_factory: pytest.TempPathFactory) -> Acts:
    """What modules did with the database while every route was asked."""
    folder = tmp_path_factory.mktemp("at-work") / "data"
    with (
        live(folder) as service,
        service.admin() as http,
        watched(service.app.state.database) as found,
    ):
        walked(http)
    return found
