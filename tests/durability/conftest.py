"""A data folder that was served and is left alone, and commands that work on it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.command_line import CommandLine
from tests.support.services import filled_folder


@pytest.fixture
def unghost(tmp_path: Path) -> CommandLine:
    """The command line, with the test's data folder as its own."""
    return CommandLine(tmp_path, {"UNGHOST_DATA": str(tmp_path / "data")})


@pytest.fixture
def filled(tmp_path: Path) -> Path:
    """A data folder of two frames with an image and a segmentation each."""
    return filled_folder(tmp_path / "data")
