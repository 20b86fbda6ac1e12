"""An empty dataset, and one with three frames, made by a client of the real server."""

import hashlib

import pytest

from tests.support import frames
from unghost import Client


@pytest.fixture
def dataset(client: Client, request: pytest.FixtureRequest) -> str:
    """An empty dataset of the test's own."""
    digest = hashlib.sha256(request.node.nodeid.encode()).hexdigest()[:12]
    return client.create_dataset(f"contract-{digest}", classes=["car"]).name


@pytest.fixture
def filled_dataset(client: Client, dataset: str) -> str:
    """A dataset of three frames, each with a box to keep and one to reject."""
    for number in range(3):
        frames.put(client, dataset, f"run/{number:06}", number)
    return dataset
