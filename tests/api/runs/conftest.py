"""A dataset of one frame, with which runs take little time."""

from __future__ import annotations

import pytest

from tests.support.api import Api


@pytest.fixture
def dataset(api: Api) -> str:
    """A dataset of one frame, "a", with a car and a ghost."""
    return api.dataset_of_one_frame()
