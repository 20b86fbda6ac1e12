"""The demo creates its data folder for its owner alone, before a server runs."""

import stat
from threading import Event

import pytest

from filter_core.formats.reading import MANIFEST_NAME
from unghost.cli.serve import DemoOptions, rendered_frames, street_folder
from unghost.street.street import TRUTH


@pytest.mark.long
def test_demo_renders_in_children_into_a_folder_with_permissions_0700(tmp_path):
    data, options = tmp_path / "data", DemoOptions(frames=4)
    street = street_folder(data, options)
    is_locked = Event()
    is_locked.set()

    frames = rendered_frames(data, options, is_locked)
    first = next(frames)
    assert not street.exists()
    lines = [first, *frames]

    assert stat.S_IMODE(data.stat().st_mode) == 0o700
    assert {path.name for path in street.iterdir()} >= {MANIFEST_NAME, TRUTH}
    again = list(rendered_frames(data, options, is_locked))
    assert [line["key"] for line in again] == [
        *("town-a/000000", "town-b/000000", "town-c/000000", "town-a/000001")
    ]
    by_key = {line["key"]: line["boxes"] for line in lines}
    assert by_key == {line["key"]: line["boxes"] for line in again}
