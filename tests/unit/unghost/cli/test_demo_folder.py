"""The demo creates its data folder for its owner alone, before a server runs."""

from __future__ import annotations

import stat

import pytest

from unghost.cli.screen import Screen
from unghost.cli.serve import DemoOptions, rendered_street


@pytest.mark.long
def test_demo_data_folder_has_permissions_0700(tmp_path):
    data = tmp_path / "data"

    street = rendered_street(data, DemoOptions(frames=1), Screen())

    assert any(street.iterdir())
    assert stat.S_IMODE(data.stat().st_mode) == 0o700
