"""A dataset of one frame, with which runs take little time."""

import pytest

from tests.support.api import BY_TAGS, Api


@pytest.fixture
def dataset(api: Api) -> str:
    """A dataset of one frame, "a", with a car and a ghost, decided by tags."""
    return api.dataset_of_one_frame(config=BY_TAGS)
