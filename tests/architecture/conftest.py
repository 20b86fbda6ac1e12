"""What the service's modules do with the database while it runs.

The rules are checked against this record as well as against the source code.
"""

import pytest

from tests.pins.walk import walked
from tests.support.database_access import DatabaseAccess, record_access
from tests.support.live import live


@pytest.fixture(scope="session")
def recorded_access(tmp_path_factory: pytest.TempPathFactory) -> DatabaseAccess:
    """What each module did with the database during a walk over the API."""
    folder = tmp_path_factory.mktemp("at-work") / "data"
    with (
        live(folder) as service,
        service.admin() as http,
        record_access(service.app.state.database) as accesses,
    ):
        walked(http)
    return accesses
