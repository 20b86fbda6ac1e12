"""A client of the real server, an empty dataset, and one with three frames."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

import pytest

from tests.support import frames
from tests.support.servers import RunningServer
from unghost import Client


@pytest.fixture
def client(server: RunningServer) -> Iterator[Client]:
    with Client(server.url, server.token) as client:
        yield client


@pytest.fixture
def dataset(client: Client, request: pytest.FixtureRequest) -> str:
    """An empty dataset of the test's own."""
    digest = hashlib.sha256(request.node.nodeid.encode()).hexdigest()[:12]
    return client.create_dataset(f"contract-{digest}", classes=["car"]).name


@pytest.fixture
def filled(client: Client, dataset: str) -> str:
    """A dataset of three frames, each with a box to keep and one to reject."""
    for number in range(3):
        frames.put(client, dataset, f"run/{number:06}", number)
    return dataset
