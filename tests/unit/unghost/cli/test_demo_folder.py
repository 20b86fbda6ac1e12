"""The demo creates its data folder for its owner alone, before a server runs."""

from __future__ import annotations

import stat

import pytest

from unghost.cli.screen import Screen
from unghost.cli.serve import DemoOptions, rendered_street


@pytest.mark.long
def test_the_folder_of_a_demo_is_for_its_owner_alone(tmp_path):
    data = tmp_path / "data"

    street = rendered_street(data, DemoOptions(frames=1), Screen())

    assert any(street.iterdir())
    assert stat.S_IMODE(data.stat().st_mode) == 0o700
