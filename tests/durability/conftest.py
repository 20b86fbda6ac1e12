"""Fixtures: a filled data folder that no service uses, and the command line."""

from pathlib import Path

import pytest

from tests.support.command_line import CommandLine
from tests.support.services import filled_folder


@pytest.fixture
def unghost(tmp_path: Path) -> CommandLine:
    """Runs `unghost` commands with the test's data folder in UNGHOST_DATA."""
    return CommandLine(tmp_path, {"UNGHOST_DATA": str(tmp_path / "data")})


@pytest.fixture
def filled(tmp_path: Path) -> Path:
    """A data folder of two frames with an image and a segmentation each."""
    return filled_folder(tmp_path / "data")
