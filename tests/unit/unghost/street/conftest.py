"""Fixture: the first frames of the demo's drive, rendered once for all tests."""

import pytest

from tests.support.decoded_frame import DecodedFrame
from unghost.street.street import StreetScene

FRAMES = 12


@pytest.fixture(scope="session")
def demo_frames():
    """The first twelve frames of the demo; the three towns take turns."""
    return [DecodedFrame(frame) for frame in StreetScene(0).frames(FRAMES)]
