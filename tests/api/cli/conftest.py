"""The command line with a server that these tests share."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.command_line import CommandLine
from tests.support.servers import RunningServer


@pytest.fixture
def unghost(server: RunningServer, tmp_path: Path) -> CommandLine:
    """The command line in an empty folder, with the server's address and a token."""
    settings = {"UNGHOST_SERVER": server.url, "UNGHOST_TOKEN": server.token}
    return CommandLine(tmp_path, settings)
