"""Fixtures: a scripted HTTP server, a client of it, and a port without a server."""

from collections.abc import Iterator

import pytest

from tests.support.ports import reserved_port
from tests.support.scripted_server import QUICK_RETRIES, ScriptedServer
from unghost import Client


@pytest.fixture
def scripted() -> Iterator[ScriptedServer]:
    server = ScriptedServer()
    yield server
    server.close()


@pytest.fixture
def client(scripted: ScriptedServer) -> Iterator[Client]:
    with Client(scripted.url, "secret", retry=QUICK_RETRIES) as client:
        yield client


@pytest.fixture
def closed_port() -> Iterator[int]:
    """A port of this machine on which no program listens."""
    with reserved_port() as port:
        yield port
