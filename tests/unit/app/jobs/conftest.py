"""A fixture: a dataset with enough frames for several chunks."""

import pytest

from tests.support.chunks import FRAMES, put


@pytest.fixture
def street(services):
    street = services.dataset()
    for number in range(FRAMES):
        put(street, number)
    return street
