"""A real HTTP server on a free port that answers what a test tells it to."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.ports import reserved_port
from tests.support.scripted_server import QUICK, ScriptedServer
from unghost import Client


@pytest.fixture
def scripted() -> Iterator[ScriptedServer]:
    server = ScriptedServer()
    yield server
    server.close()


@pytest.fixture
def client(scripted: ScriptedServer) -> Iterator[Client]:
    with Client(scripted.url, "secret", retry=QUICK) as client:
        yield client


@pytest.fixture
def closed_port() -> Iterator[int]:
    """A port of this machine on which nobody listens."""
    with reserved_port() as port:
        yield port
